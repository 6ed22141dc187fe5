"""The script `polar`: what it sets up, when, and what it survives.

A stand-in plays Python and uv and notes what it is called for, so that a set-up takes a second.
The real thing is run by .ci/run on a fresh machine. Kernels are compiled in the background and
have tests of their own; the others leave them out of what they look at.
"""

import contextlib
import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from polar_nav_core import background

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
LOCK = f'.venv/{background.LOCK}'
STEPS = ('venv', 'requirements', 'wheels', 'messages', 'link')

STAND_IN = r"""#!/bin/bash
note() {
  echo "begin $1" >>"$STAND_IN_LOG"
  [[ ${STAND_IN_SLOW:-} != "$1" ]] || sleep 2
  if [[ " ${STAND_IN_BROKEN:-} " == *" $1 "* ]]; then echo "the $1 step broke here"; exit 1; fi
  echo "$1" >>"$STAND_IN_LOG"
}
if [[ $* == *' -r '* ]]; then # what is to be installed
  pins=$(cat "${@: -1}")
  case $pins in
    uv==*) what=uv ;;
    ros-*) what=generators ;;
    numba==*) what=compiler ;;
    *) what=requirements ;;
  esac
  case $pins in *uv==*) [[ $what == uv ]] || what='uv with all others' ;; esac
fi
case "$*" in
  *'"python%d'*) echo "python${STAND_IN_VERSION:-3.11}" ;;
  *'"%d.%d'*) echo "${STAND_IN_VERSION:-3.11}" ;;
  --version) echo "Python ${STAND_IN_VERSION:-3.11}.0" ;;
  *ensurepip*) exit "${STAND_IN_NO_VENV:-0}" ;;
  -) exit "${STAND_IN_NO_HEADERS:-0}" ;;
  '-m venv '*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && note venv ;;
  '-m pip wheel '*polar_nav_msgs) touch "$(dirname "$0")/../early/wheels/msgs.whl"; note wheels ;;
  '-m pip wheel '*) ;;
  '-m pip '*msgs.whl) note messages ;;
  '-m pip '*) note "$what" && [[ $what == uv ]] || echo 'by pip' >>"$STAND_IN_LOG" ;;
  *environment.py\ install*) note uv-works && note "$what" ;;
  *environment.py\ link) note link ;;
  *core.warm) note warm ;;
  *compileall*) note bytes ;;
  '-P -m polar_nav_tools.cli'*) shift 3; echo "tool"; printf '<%s>\n' "$@"; env; exit 7 ;;
  *) echo "stand-in: $*" >&2; exit 99 ;;
esac
"""


@dataclass
class Tree:
    """A tree as small as the script needs it, and the stand-in on the path."""

    root: Path
    bin: Path
    log: Path

    def environment(self, **more: str) -> dict[str, str]:
        base = {'PATH': f'{self.bin}:/usr/bin:/bin', 'HOME': str(self.root)}
        return {**base, 'STAND_IN_LOG': str(self.log), 'POLAR_PYTHON': 'stand-in', **more}

    def start(self, *arguments: str, **more: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [self.root / 'polar', *arguments],
            env=self.environment(**more),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def run(self, *arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments, **more)
        out, err = process.communicate(timeout=60)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def lines(self) -> list[str]:
        return self.log.read_text().splitlines() if self.log.exists() else []

    def done(self) -> list[str]:
        """Steps that were finished since the last question, in the order of a set-up."""
        self.wait_for_kernels()
        lines = self.lines()
        self.log.unlink(missing_ok=True)
        return sorted((line for line in lines if line in STEPS), key=STEPS.index)

    def compiled(self) -> int:
        """How often the kernels were compiled since the last question."""
        self.wait_for_kernels()
        lines = self.lines()
        self.log.unlink(missing_ok=True)
        return lines.count('warm')

    def wait_for_kernels(self) -> None:
        with contextlib.suppress(FileNotFoundError), (self.root / LOCK).open() as file:
            fcntl.flock(file, fcntl.LOCK_EX)

    def wait_for(self, line: str) -> None:
        limit = time.monotonic() + 20.0
        while line not in self.lines():
            assert time.monotonic() < limit, f'{line} did not come'
            time.sleep(0.02)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    root = tmp_path / 'a tree'
    for name in ('polar', 'requirements.lock'):
        root.mkdir(exist_ok=True)
        shutil.copy2(ROOT / name, root / name)
    texts = {
        'polar_nav_msgs/msg/Fix.msg': 'float64 range\n',
        'polar_nav_sim/setup.py': 'setup()\n',
        'polar_nav_sim/setup.cfg': '[metadata]\n',
        'polar_nav_tools/polar_nav_tools/development/environment.py': 'link()\n',
        'polar_nav_core/polar_nav_core/kernels/frames/earth.py': 'radius = 6378137.0\n',
        'polar_nav_core/polar_nav_core/warm.py': 'warm()\n',
    }
    for name, text in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    programs = tmp_path / 'bin'
    programs.mkdir()
    (programs / 'stand-in').write_text(STAND_IN)
    (programs / 'stand-in').chmod(0o755)
    return Tree(root, programs, tmp_path / 'log')


def test_first_call_does_every_step_and_runs_the_tool(tree):
    result = tree.run('score', 'a bag', '--json')
    assert result.returncode == 7, result.stderr
    assert result.stdout.startswith('tool\n<score>\n<a bag>\n<--json>\n')
    assert tree.done() == list(STEPS)
    for number in range(1, 5):
        assert f'[{number}/4]' in result.stderr


def test_later_calls_touch_nothing_and_say_nothing(tree):
    tree.run()
    tree.done()
    tree.run()
    before = {p: p.stat().st_mtime_ns for p in tree.root.rglob('*')}
    result = tree.run('info')
    assert (result.returncode, result.stderr) == (7, '')
    assert tree.done() == []
    assert {p: p.stat().st_mtime_ns for p in tree.root.rglob('*')} == before


def test_what_others_wait_for_is_installed_first(tree):
    tree.run()
    tree.wait_for_kernels()
    lines = [line for line in tree.lines() if not line.startswith('begin')]
    assert tuple(line for line in lines if line in INSTALLED) == INSTALLED
    assert lines.index('generators') < lines.index('wheels') < lines.index('messages')
    assert lines.index('compiler') < lines.index('warm') < lines.index('bytes')
    assert 'by pip' not in lines


INSTALLED = ('venv', 'uv', 'compiler', 'generators', 'requirements', 'messages', 'link')


@pytest.mark.parametrize(
    ('broken', 'said'),
    [('uv', 'uv is not to be had here'), ('uv-works', 'uv has not installed it')],
)
def test_pip_installs_what_uv_cannot(tree, broken, said):
    result = tree.run(STAND_IN_BROKEN=broken)
    assert result.returncode == 7
    assert result.stderr.count(said) == 1
    tree.wait_for_kernels()
    assert tree.lines().count('by pip') == 3
    assert tree.done() == list(STEPS)


@pytest.mark.parametrize(
    ('changed', 'steps', 'kernels'),
    [
        ('polar_nav_msgs/msg/Fix.msg', ['wheels', 'messages'], 0),
        ('polar_nav_msgs/msg/New.msg', ['wheels', 'messages'], 0),
        ('polar_nav_sim/setup.py', ['link'], 0),
        ('polar_nav_sim/setup.cfg', ['link'], 0),
        ('polar_nav_core/polar_nav_core/kernels/frames/earth.py', [], 1),
        ('polar_nav_core/polar_nav_core/warm.py', [], 1),
        ('requirements.lock', ['requirements', 'wheels', 'messages'], 1),
    ],
)
def test_a_change_redoes_only_what_depends_on_it(tree, changed, steps, kernels):
    tree.run()
    tree.done()
    with (tree.root / changed).open('a') as file:
        file.write('# changed\n')
    assert tree.run().returncode == 7
    tree.wait_for_kernels()
    assert tree.lines().count('warm') == kernels
    assert tree.done() == steps
    tree.run()
    assert tree.done() == []


def test_a_failed_step_shows_its_last_words_and_is_tried_again(tree):
    result = tree.run(STAND_IN_BROKEN='messages')
    assert result.returncode == 1
    assert 'the messages step broke here' in result.stderr
    assert 'setup.log' in result.stderr
    assert 'tool' not in result.stdout
    tree.done()
    assert tree.run().returncode == 7
    assert tree.done() == ['wheels', 'messages', 'link']


# Half-installed requirements are thrown away; every other step is done again by itself.
AFTER = {
    'venv': STEPS,
    'requirements': STEPS,
    'wheels': ('wheels', 'messages', 'link'),
    'messages': ('wheels', 'messages', 'link'),
    'link': ('link',),
}


@pytest.mark.parametrize('how', ['INT', 'TERM', 'KILL', 'power cut'])
@pytest.mark.parametrize('step', STEPS)
def test_an_interrupted_set_up_is_completed(tree, step, how):
    process = tree.start(STAND_IN_SLOW=step)
    tree.wait_for(f'begin {step}')
    if how == 'power cut':
        for child in Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text().split():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(int(child), signal.SIGKILL)  # a step leads a group of its own
        process.kill()
    else:
        process.send_signal(signal.Signals[f'SIG{how}'])
    process.communicate(timeout=20)
    assert process.returncode == (130 if how in ('INT', 'TERM') else -9)
    tree.log.unlink()
    assert tree.run().returncode == 7
    # After a kill the orphaned step may still have come to its end, before the next call began.
    assert set(tree.done()) >= set(AFTER[step])
    assert (tree.root / '.venv/.polar_setup').read_text().count('\nkernels ') == 1
    tree.run()
    assert tree.done() == []


@pytest.mark.parametrize('step', ['requirements', 'wheels'])
def test_interrupt_ends_the_step_at_once(tree, step):
    process = tree.start(STAND_IN_SLOW=step)
    tree.wait_for(f'begin {step}')
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert 'the next call completes it' in err
    time.sleep(2.2)
    assert step not in tree.done()


def test_messages_are_built_beside_the_packages(tree):
    process = tree.start(STAND_IN_SLOW='requirements')
    tree.wait_for('begin requirements')
    tree.wait_for('wheels')
    assert 'requirements' not in tree.lines()
    process.communicate(timeout=20)
    assert process.returncode == 7
    assert tree.done() == list(STEPS)


def test_messages_that_failed_beside_the_packages_are_built_in_their_step(tree):
    process = tree.start(STAND_IN_SLOW='requirements', STAND_IN_BROKEN='wheels')
    tree.wait_for('begin wheels')
    _, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert 'the wheels step broke here' in err
    assert tree.lines().count('begin wheels') == 2


def test_the_first_command_does_not_wait_for_kernels(tree):
    process = tree.run(STAND_IN_SLOW='warm')
    assert process.returncode == 7
    assert 'in the background' in process.stderr
    assert 'begin warm' in tree.lines()
    assert 'warm' not in tree.lines()
    assert tree.compiled() == 1
    result = tree.run()
    assert (tree.compiled(), result.stderr) == (0, '')


@pytest.mark.parametrize('changed', [False, True])
def test_a_second_call_shares_what_compiles_of_the_same_sources(tree, changed):
    tree.run(STAND_IN_SLOW='warm')
    tree.wait_for('begin warm')
    if changed:
        with (tree.root / 'polar_nav_core/polar_nav_core/warm.py').open('a') as file:
            file.write('# changed\n')
    tree.run()
    tree.wait_for_kernels()
    assert tree.lines().count('begin warm') == 1 + changed
    assert tree.compiled() == 1
    tree.run()
    assert tree.compiled() == 0


def test_commands_wait_for_kernels_and_not_for_bytecode(tree, monkeypatch):
    monkeypatch.setattr(sys, 'prefix', str(tree.root / '.venv'))
    monkeypatch.delenv(background.COMPILES, raising=False)
    tree.run(STAND_IN_SLOW='warm')
    tree.wait_for('begin warm')
    assert background.compiles()
    tree.wait_for_kernels()
    shutil.rmtree(tree.root / '.venv')
    tree.log.unlink()
    tree.run(STAND_IN_SLOW='bytes')
    tree.wait_for('begin bytes')
    assert not background.compiles()
    assert 'bytes' not in tree.lines()
    assert tree.run().stderr == ''  # nor does a second command


def test_kernels_that_failed_are_tried_again(tree):
    tree.run(STAND_IN_BROKEN='warm')
    assert tree.compiled() == 0
    assert 'the warm step broke' in (tree.root / '.venv' / background.LOG).read_text()
    tree.run()
    assert tree.compiled() == 1


def test_what_compiles_outlives_the_command_and_its_terminal(tree):
    tree.run(STAND_IN_SLOW='warm')
    tree.wait_for('begin warm')
    group, _ = (tree.root / LOCK).read_text().split()
    assert int(group) != os.getpgrp()
    os.killpg(int(group), signal.SIGHUP)
    assert tree.compiled() == 1


@pytest.mark.parametrize('how', ['INT', 'a step fails'])
def test_what_compiles_ends_with_a_set_up_that_does_not_end_well(tree, how):
    broken = 'link' if how == 'a step fails' else ''
    slow = 'warm' if broken else 'messages'
    process = tree.start(STAND_IN_SLOW=slow, STAND_IN_BROKEN=broken)
    tree.wait_for(f'begin {slow}')
    if how == 'INT':
        process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == (130 if how == 'INT' else 1)
    tree.wait_for_kernels()
    assert tree.run().returncode == 7


def test_kernels_and_messages_come_from_pinned_names():
    """A name that is not in the lock file would be left out, and what needs it would fail."""
    script = (ROOT / 'polar').read_text().replace('\\\n', '')
    lock = (ROOT / 'requirements.lock').read_text()
    lists = re.findall(r'^  install ((?:\S+ *)+)$', script, re.MULTILINE)
    names = [n.strip("'") for names in lists for n in names.split()]
    assert len(names) > 15
    assert [n for n in names if not re.search(f'^{n}==', lock, re.MULTILINE)] == []


def test_a_killed_set_up_leaves_nothing_that_waits_for_a_compiler(tree):
    """It would hold the lock, and the next call would wait for ever."""
    process = tree.start(STAND_IN_SLOW='compiler', STAND_IN_BROKEN='compiler')
    tree.wait_for('begin compiler')
    process.kill()
    process.communicate(timeout=20)
    assert tree.run().returncode == 7


def test_two_first_calls_at_once_share_one_set_up(tree):
    first = tree.start(STAND_IN_SLOW='requirements')
    tree.wait_for('begin requirements')
    second = tree.run()
    first.communicate(timeout=20)
    assert (first.returncode, second.returncode) == (7, 7)
    assert 'waiting' in second.stderr
    assert tree.done() == list(STEPS)


def test_an_environment_of_somebody_else_is_left_alone(tree):
    (tree.root / '.venv').mkdir()
    (tree.root / '.venv/precious').write_text('')
    result = tree.run()
    assert result.returncode == 1
    assert 'was not made by this script' in result.stderr
    assert (tree.root / '.venv/precious').exists()


def test_a_moved_tree_is_set_up_again(tree):
    tree.run()
    tree.done()
    tree.root = tree.root.rename(tree.root.with_name('moved'))
    result = tree.run()
    assert 'another folder' in result.stderr
    assert tree.done() == list(STEPS)


@pytest.mark.parametrize(
    ('lacks', 'named'),
    [
        ({'STAND_IN_NO_VENV': '1'}, 'apt install python3.11-venv'),
        ({'STAND_IN_NO_HEADERS': '1'}, 'apt install python3.11-dev'),
        ({'CXX': 'no-such-compiler'}, 'apt install g++'),
        (
            {'STAND_IN_NO_VENV': '1', 'STAND_IN_NO_HEADERS': '1', 'CC': 'no-such-compiler'},
            'apt install python3.11-venv python3.11-dev g++',
        ),
        ({'STAND_IN_VERSION': '3.10'}, 'not a Python 3.11 or 3.12 (stand-in is 3.10)'),
        ({'POLAR_PYTHON': ''}, 'apt install python3 python3-venv python3-dev g++'),
    ],
)
def test_what_is_missing_is_named_with_its_package(tree, lacks, named):
    if lacks.get('POLAR_PYTHON') == '':
        for name in ('bash', 'dirname', 'readlink', 'sha256sum', 'cut', 'find', 'sort', 'flock'):
            (tree.bin / name).symlink_to(str(shutil.which(name)))
        lacks = {**lacks, 'PATH': str(tree.bin)}
    result = tree.run(**lacks)
    assert result.returncode == 1
    assert named in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (tree.root / '.venv').exists()


def test_a_shim_that_fails_speaks_for_itself(tree):
    shim = tree.bin / 'python3.12'
    shim.write_text("#!/bin/sh\necho 'pyenv: python3.12: command not found' >&2\nexit 127\n")
    shim.chmod(0o755)
    result = tree.run(POLAR_PYTHON='python3.12')
    assert result.returncode == 1
    said = 'polar: POLAR_PYTHON=python3.12 does not run: pyenv: python3.12: command not found\n'
    assert result.stderr == said


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write everywhere')
def test_a_checkout_of_another_user_is_named(tree):
    tree.root.chmod(0o555)
    try:
        result = tree.run()
    finally:
        tree.root.chmod(0o755)
    assert result.returncode == 1
    assert 'may not write there' in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_another_ros_is_left_outside(tree, tmp_path):
    other = tmp_path / 'opt/ros/jazzy'
    (other / 'lib').mkdir(parents=True)
    (other / 'lib/librcl.so').touch()
    sourced = {
        'ROS_DISTRO': 'jazzy',
        'PYTHONPATH': f'{other}/lib/python3.12/site-packages',
        'AMENT_PREFIX_PATH': str(other),
        'CMAKE_PREFIX_PATH': str(other),
        'LD_LIBRARY_PATH': f'{other}/lib:/somewhere/ros_rcl.libs:/usr/local/cuda/lib64',
        '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1',
        'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp',
        'ROS_DOMAIN_ID': '41',
    }
    result = tree.run(**sourced)
    seen = dict(line.split('=', 1) for line in result.stdout.splitlines() if '=' in line)
    assert 'jazzy is not used' in result.stderr
    assert 'rmw_cyclonedds_cpp is left aside' in result.stderr
    assert seen['AMENT_PREFIX_PATH'] == seen['VIRTUAL_ENV'] == str(tree.root / '.venv')
    assert seen['LD_LIBRARY_PATH'] == '/usr/local/cuda/lib64'
    assert seen['ROS_DOMAIN_ID'] == '41'
    gone = set(sourced) - {'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'ROS_DOMAIN_ID'}
    assert not gone & set(seen)


def test_without_a_home_the_log_of_ros_has_a_place(tree):
    seen = tree.run(HOME='/nonexistent').stdout
    assert '\nROS_HOME=' in seen
    assert '\nROS_HOME=' not in tree.run().stdout


def test_shellcheck():
    if shutil.which('shellcheck') is None:
        pytest.skip('shellcheck is not installed')
    subprocess.run(['shellcheck', ROOT / 'polar', ROOT / '.ci/run'], check=True)
