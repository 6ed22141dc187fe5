"""The script `polar`: what it sets up, when, and what it survives.

A stand-in plays Python and notes what it is called for, so that a set-up takes a second. The real
thing is run by .ci/run on a fresh machine. Compiling early, beside the other steps, has its own
tests; in all others it fails, and the step for kernels does it.
"""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
STEPS = ('venv', 'requirements', 'messages', 'link', 'warm')

STAND_IN = r"""#!/bin/bash
note() {
  echo "begin $1" >>"$STAND_IN_LOG"
  [[ ${STAND_IN_SLOW:-} != "$1" ]] || sleep 2
  [[ " ${STAND_IN_BROKEN-early} " != *" $1 "* ]] || { echo "the $1 step broke here"; exit 1; }
  echo "$1" >>"$STAND_IN_LOG"
}
case "$*" in
  *'"python%d'*) echo "python${STAND_IN_VERSION:-3.11}" ;;
  *'"%d.%d'*) echo "${STAND_IN_VERSION:-3.11}" ;;
  --version) echo "Python ${STAND_IN_VERSION:-3.11}.0" ;;
  *ensurepip*) exit "${STAND_IN_NO_VENV:-0}" ;;
  -) exit "${STAND_IN_NO_HEADERS:-0}" ;;
  '-m venv '*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && note venv ;;
  '-m pip '*requirements.lock) note requirements ;;
  '-m pip '*polar_nav_msgs) note messages ;;
  '-m pip '*) note compiler ;;
  *environment.py\ link) note link ;;
  *core.warm) if [[ -n ${PYTHONPATH:-} ]]; then note early; else note warm; fi ;;
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

    def done(self) -> list[str]:
        """What was finished since the last question."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        self.log.unlink(missing_ok=True)
        return [line for line in lines if not line.startswith(('begin', 'compiler'))]

    def wait_for(self, line: str) -> None:
        limit = time.monotonic() + 20.0
        while not (self.log.exists() and line in self.log.read_text().splitlines()):
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
    for number in range(1, 6):
        assert f'[{number}/5]' in result.stderr


def test_later_calls_touch_nothing_and_say_nothing(tree):
    tree.run()
    tree.done()
    before = {p: p.stat().st_mtime_ns for p in tree.root.rglob('*')}
    result = tree.run('info')
    assert (result.returncode, result.stderr) == (7, '')
    assert tree.done() == []
    assert {p: p.stat().st_mtime_ns for p in tree.root.rglob('*')} == before


@pytest.mark.parametrize(
    ('changed', 'steps'),
    [
        ('polar_nav_msgs/msg/Fix.msg', ['messages']),
        ('polar_nav_msgs/msg/New.msg', ['messages']),
        ('polar_nav_sim/setup.py', ['link']),
        ('polar_nav_sim/setup.cfg', ['link']),
        ('polar_nav_core/polar_nav_core/kernels/frames/earth.py', ['warm']),
        ('polar_nav_core/polar_nav_core/warm.py', ['warm']),
        ('requirements.lock', ['requirements', 'messages', 'warm']),
    ],
)
def test_a_change_redoes_only_what_depends_on_it(tree, changed, steps):
    tree.run()
    tree.done()
    with (tree.root / changed).open('a') as file:
        file.write('# changed\n')
    assert tree.run().returncode == 7
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
    assert tree.done() == ['messages', 'link', 'warm']


# Half-installed requirements are thrown away; every other step is done again by itself.
AFTER = {
    'venv': list(STEPS),
    'requirements': list(STEPS),
    'messages': ['messages', 'link', 'warm'],
    'link': ['link', 'warm'],
    'warm': ['warm'],
}


@pytest.mark.slow
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
    tree.wait_for(f'begin {step}')
    assert tree.run().returncode == 7
    done = tree.done()
    # After a kill the orphaned step may still have come to its end, before the next call began.
    expected = AFTER[step]
    assert done[-len(expected) :] == expected
    tree.run()
    assert tree.done() == []


def test_interrupt_ends_the_step_at_once(tree):
    process = tree.start(STAND_IN_SLOW='requirements')
    tree.wait_for('begin requirements')
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert 'the next call completes it' in err
    time.sleep(2.2)
    assert tree.done() == ['venv']


def test_kernels_are_compiled_beside_the_other_steps(tree):
    """From when their compiler is installed; then the last step has nothing to do."""
    process = tree.start(STAND_IN_SLOW='messages', STAND_IN_BROKEN='')
    tree.wait_for('begin messages')
    tree.wait_for('early')
    process.communicate(timeout=20)
    assert process.returncode == 7
    done = tree.done()
    assert done.index('early') < done.index('messages')
    assert sorted(done) == sorted(('early', *STEPS[:-1]))
    tree.run(STAND_IN_BROKEN='')
    assert tree.done() == []


def test_what_kernels_are_compiled_with_is_pinned():
    """A name that is not would be left out, and all kernels wait for the last step."""
    (names,) = re.findall(r'\(pins_of (numba .*)\)', (ROOT / 'polar').read_text())
    lock = (ROOT / 'requirements.lock').read_text()
    assert [n for n in names.split() if f'\n{n}==' not in lock] == []


def test_the_step_for_kernels_waits_for_those_compiled_early(tree):
    result = tree.run(STAND_IN_SLOW='early', STAND_IN_BROKEN='')
    assert result.returncode == 7
    assert sorted(tree.done()) == sorted(('early', *STEPS[:-1]))


@pytest.mark.parametrize('how', ['INT', 'a step fails'])
def test_what_compiles_early_ends_with_the_set_up(tree, how):
    broken = 'messages' if how == 'a step fails' else ''
    process = tree.start(STAND_IN_SLOW='early', STAND_IN_BROKEN=broken)
    tree.wait_for('begin early')
    if how == 'INT':
        process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == (130 if how == 'INT' else 1)
    time.sleep(2.2)
    assert 'early' not in tree.done()
    assert tree.run(STAND_IN_BROKEN='').returncode == 7


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
