"""Supervisor: fake nodes (small scripts) end, die, hang and print; nothing is left behind."""

import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import pytest

import polar_nav_tools.live.supervisor as supervisor_module
from polar_nav_tools.graph import processes
from polar_nav_tools.graph.processes import composed, separate
from polar_nav_tools.graph.spec import NodeSpec, Stage
from polar_nav_tools.live.supervisor import RunStatus, Supervisor

pytestmark = pytest.mark.slow

PATIENT = """
    import signal, sys, time
    def main():
        stopped = []
        signal.signal(signal.SIGINT, lambda *_: stopped.append(1))
        print('up', flush=True)
        while not stopped:
            time.sleep(0.01)
        print('down', time.monotonic_ns(), flush=True)
        return 0
"""
TRUTH = """
    import time
    def main():
        for i in range(3):
            print(f'progress {i}.0 2.0', flush=True)
            time.sleep(0.05)
        return 0
"""
ENDLESS = """
    import signal, time
    def main():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            time.sleep(60)
        except KeyboardInterrupt:
            return 0
"""
DYING = """
    import time
    from pathlib import Path
    def main():
        log = Path(__file__).parents[1] / 'run' / 'logs' / 'vehicle.recorder.log'
        while 'up' not in log.read_text():
            time.sleep(0.01)
        for i in range(50):
            print('line', i)
        raise ValueError('the tank is empty')
"""
DEAF = """
    import signal, time
    def main():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        print('deaf', flush=True)
        time.sleep(60)
"""


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """Make a node specification out of the text of a module."""
    folder = tmp_path / 'fakes'
    folder.mkdir()
    monkeypatch.setenv('PYTHONPATH', f'{folder}{os.pathsep}{os.environ.get("PYTHONPATH", "")}')

    def make(name: str, text: str, stage: Stage = Stage.SENSOR) -> NodeSpec:
        (folder / f'fake_{name}.py').write_text(textwrap.dedent(text))
        return NodeSpec('fakes', name, f'fake_{name}', 'vehicle', stage, {'rate': 1.0})

    return make


def run(tmp_path, *specs, processes=separate, **kwargs):
    supervisor = Supervisor(processes(specs), tmp_path / 'run', dict(os.environ), **kwargs)
    outcome = supervisor.run()
    for pid in supervisor.pids().values():
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    return outcome


def down_ns(tmp_path: Path, name: str) -> int:
    last = (tmp_path / 'run' / 'logs' / f'vehicle.{name}.log').read_text().splitlines()[-1]
    assert last.startswith('down'), last
    return int(last.split()[1])


def test_completed_run_ends_upstream_first_and_recorder_last(tmp_path, fake):
    progress = []
    outcome = run(
        tmp_path,
        fake('recorder', PATIENT, Stage.RECORDER),
        fake('truth', TRUTH, Stage.TRUTH),
        fake('follower', PATIENT, Stage.FOLLOWER),
        fake('sensor', PATIENT, Stage.SENSOR),
        on_progress=lambda now, total: progress.append((now, total)),
    )
    assert outcome.status is RunStatus.COMPLETED
    assert progress == [(0.0, 2.0), (1.0, 2.0), (2.0, 2.0)]
    order = [down_ns(tmp_path, name) for name in ('sensor', 'follower', 'recorder')]
    assert order == sorted(order)
    assert 'progress' not in (tmp_path / 'run' / 'logs' / 'vehicle.truth.log').read_text()


READY = """
    import signal, time
    def main():
        stopped = []
        signal.signal(signal.SIGINT, lambda *_: stopped.append(1))
        time.sleep(0.5)
        print('ready /vehicle/slow', flush=True)
        print('up at', time.monotonic_ns(), flush=True)
        while not stopped:
            time.sleep(0.01)
"""
FIRST = """
    import time
    def main():
        print('began', time.monotonic_ns(), flush=True)
"""


def test_in_real_time_the_truth_starts_when_the_others_are_ready(tmp_path, fake):
    truth, slow = fake('truth', FIRST, Stage.TRUTH), fake('slow', READY)
    outcome = run(tmp_path, truth, slow, truth_last=True)
    assert outcome.status is RunStatus.COMPLETED
    logs = tmp_path / 'run' / 'logs'
    began = (logs / 'vehicle.truth.log').read_text().split()
    ready = (logs / 'vehicle.slow.log').read_text().split()
    assert int(ready[-1]) < int(began[-1])


def test_a_node_that_dies_before_it_is_ready_fails_the_run(tmp_path, fake):
    broken = 'def main():\n    return 4\n'
    specs = fake('truth', FIRST, Stage.TRUTH), fake('broken', broken)
    outcome = run(tmp_path, *specs, truth_last=True)
    assert 'node /vehicle/broken exited with status 4' in outcome.sentence


AGAIN = """
    import os, signal, time
    from pathlib import Path
    def main():
        stopped = []
        signal.signal(signal.SIGINT, lambda *_: stopped.append(1))
        lives = Path(__file__).with_name('lives')
        with lives.open('a') as file:
            file.write('.')
        if len(lives.read_text()) < 3:
            os.kill(os.getpid(), signal.SIGKILL)
        while not stopped:
            time.sleep(0.01)
        return 0
"""
PATIENT_TRUTH = """
    import time
    from pathlib import Path
    def main():
        lives = Path(__file__).with_name('lives')
        while not lives.exists() or len(lives.read_text()) < 3:
            time.sleep(0.01)
"""


def test_a_node_that_respawns_is_started_again_and_named(tmp_path, fake):
    said = []
    outcome = run(
        tmp_path,
        fake('truth', PATIENT_TRUTH, Stage.TRUTH),
        replace(fake('again', AGAIN, Stage.FOLLOWER), respawns=True),
        on_problem=said.append,
        respawn_delay_s=0.05,
    )
    assert outcome.status is RunStatus.COMPLETED
    assert said == ['node /vehicle/again was killed by SIGKILL: it is started again'] * 2


def test_a_node_that_dies_between_two_looks_is_started_again(tmp_path, fake, monkeypatch):
    """Of those who look for the dead, the one who ends the run is here the first to see each."""
    respawn, seen = supervisor_module.Supervisor._respawn, []

    def a_look_later(self):
        if not seen and any(
            c.spec.respawns and c.process.poll() is not None for c in self._children
        ):
            seen.append(0)
            return
        seen.clear()
        respawn(self)

    monkeypatch.setattr(supervisor_module.Supervisor, '_respawn', a_look_later)
    outcome = run(
        tmp_path,
        fake('truth', PATIENT_TRUTH, Stage.TRUTH),
        replace(fake('again', AGAIN, Stage.FOLLOWER), respawns=True),
        respawn_delay_s=0.05,
    )
    assert outcome.status is RunStatus.COMPLETED


def test_a_node_that_dies_again_and_again_fails_the_run(tmp_path, fake, monkeypatch):
    monkeypatch.setattr(supervisor_module, 'MOST_RESPAWNS', 1)
    outcome = run(
        tmp_path,
        fake('truth', ENDLESS, Stage.TRUTH),
        replace(fake('again', AGAIN, Stage.FOLLOWER), respawns=True),
        respawn_delay_s=0.05,
    )
    assert outcome.status is RunStatus.FAILED
    assert 'node /vehicle/again was killed by SIGKILL' in outcome.sentence


@pytest.mark.parametrize(('end', 'again'), [('sys.exit(1)', False), ('os.abort()', True)])
def test_a_recorder_that_gives_up_is_not_started_again(tmp_path, fake, monkeypatch, end, again):
    monkeypatch.setattr(supervisor_module, 'MOST_RESPAWNS', 2)
    said = []
    code = f'import os, sys\ndef main():\n    {end}\n'
    outcome = run(
        tmp_path,
        fake('truth', ENDLESS, Stage.TRUTH),
        replace(fake('recorder', code, Stage.RECORDER), respawns=True),
        on_problem=said.append,
        respawn_delay_s=0.0,
    )
    assert outcome.status is RunStatus.FAILED
    assert '/vehicle/recorder' in outcome.sentence
    assert len(said) == (supervisor_module.MOST_RESPAWNS if again else 0)


def test_parameters_are_written_for_each_node(tmp_path, fake):
    run(tmp_path, fake('truth', TRUTH, Stage.TRUTH))
    text = (tmp_path / 'run' / 'params' / 'vehicle.truth.yaml').read_text()
    assert text == '/vehicle/truth:\n  ros__parameters:\n    rate: 1.0\n'


def test_a_node_that_raises_is_named_with_its_last_lines(tmp_path, fake):
    lines = []
    outcome = run(
        tmp_path,
        fake('truth', ENDLESS, Stage.TRUTH),
        fake('dying', DYING),
        fake('recorder', PATIENT, Stage.RECORDER),
        on_line=lambda name, line: lines.append((name, line)),
    )
    assert outcome.status is RunStatus.FAILED
    assert outcome.culprit is not None
    assert outcome.culprit.name == '/vehicle/dying'
    assert outcome.culprit.returncode == 1
    assert outcome.culprit.last_lines[-1] == 'ValueError: the tank is empty'
    assert 'line 49' in outcome.culprit.last_lines
    assert len(outcome.culprit.last_lines) <= 30
    assert 'node /vehicle/dying exited with status 1' in outcome.sentence
    assert ('/vehicle/dying', 'line 0') in lines
    assert down_ns(tmp_path, 'recorder') > 0


def test_a_node_that_ends_early_with_status_0_fails_the_run_too(tmp_path, fake):
    early = 'def main():\n    return 0\n'
    outcome = run(tmp_path, fake('truth', ENDLESS, Stage.TRUTH), fake('early', early))
    assert outcome.status is RunStatus.FAILED
    assert 'node /vehicle/early exited with status 0' in outcome.sentence


def test_a_killed_node_is_blamed_by_signal_and_deaf_ones_are_killed_in_time(tmp_path, fake):
    suicide = 'import os, time\ndef main():\n    time.sleep(0.5)\n    os.kill(os.getpid(), 9)\n'
    started = time.monotonic()
    outcome = run(
        tmp_path, fake('truth', DEAF, Stage.TRUTH), fake('deaf', DEAF), fake('victim', suicide)
    )
    assert outcome.status is RunStatus.FAILED
    assert 'node /vehicle/victim was killed by SIGKILL' in outcome.sentence
    assert time.monotonic() - started < 8.0
    # Each wrote where it hung.
    log = (tmp_path / 'run' / 'logs' / 'vehicle.deaf.log').read_text()
    assert re.search(r'fake_deaf\.py", line \d+ in main', log), log


def test_a_node_that_fails_while_it_is_ended_fails_the_run(tmp_path, fake):
    sour = PATIENT.replace('return 0', 'return 3')
    outcome = run(tmp_path, fake('truth', TRUTH, Stage.TRUTH), fake('sour', sour))
    assert outcome.status is RunStatus.FAILED
    assert outcome.sentence == 'node /vehicle/sour exited with status 3 while it was ended'


TOGETHER = """
    import os, signal, sys
    def main():
        print('arguments', *sys.argv[1:], flush=True)
        {end}
"""


@pytest.mark.parametrize(
    ('end', 'sentence'),
    [
        ("print('failed sensor'); return 1", 'node /vehicle/sensor exited with status 1'),
        ("print('failed other'); return 1", 'process /vehicle (sensor, follower) exited with'),
        (
            'os.kill(os.getpid(), signal.SIGKILL)',
            'process /vehicle (sensor, follower) was killed by SIGKILL',
        ),
    ],
)
def test_of_nodes_in_one_process_the_one_that_failed_is_named(
    tmp_path, fake, monkeypatch, end, sentence
):
    monkeypatch.setattr(processes, 'COMPOSED', 'fake_together')
    fake('together', TOGETHER.replace('{end}', end))
    truth = NodeSpec('fakes', 'truth', fake('truth', ENDLESS).module, '', Stage.TRUTH)
    outcome = run(
        tmp_path,
        truth,
        fake('follower', PATIENT, Stage.FOLLOWER),
        fake('sensor', PATIENT, Stage.SENSOR),
        processes=composed,
    )
    assert outcome.status is RunStatus.FAILED
    assert outcome.sentence.startswith(sentence)
    assert outcome.culprit.log == 'vehicle.log'
    log = (tmp_path / 'run' / 'logs' / 'vehicle.log').read_text()
    files = [tmp_path / 'run' / 'params' / f'vehicle.{n}.yaml' for n in ('sensor', 'follower')]
    options = ' '.join(f'--params-file {file}' for file in files)
    expected = f'arguments fake_sensor fake_follower --ros-args -r __ns:=/vehicle {options}'
    assert log.splitlines() == [expected]
    assert all('rate: 1.0' in file.read_text() for file in files)


def test_counts_of_nodes_in_one_process_are_those_of_each(tmp_path, fake, monkeypatch):
    monkeypatch.setattr(processes, 'COMPOSED', 'fake_together')
    counting = """print('counts /vehicle/sensor {"taken": 1}', flush=True); print('up'"""
    fake('together', PATIENT.replace("print('up'", counting))
    truth = NodeSpec('fakes', 'truth', fake('truth', TRUTH).module, '', Stage.TRUTH)
    outcome = run(
        tmp_path,
        truth,
        fake('sensor', PATIENT),
        fake('follower', PATIENT, Stage.FOLLOWER),
        processes=composed,
    )
    assert outcome.status is RunStatus.COMPLETED
    assert outcome.counts == {'/vehicle/sensor': {'taken': 1}}


HOST = """
    import os, sys
    from pathlib import Path
    from polar_nav_tools.graph.processes import separate
    from polar_nav_tools.graph.spec import NodeSpec, Stage
    from polar_nav_tools.live.supervisor import RunStatus, Supervisor
    specs = [NodeSpec('fakes', n, f'fake_{n}', 'vehicle', s) for n, s in
             (('truth', Stage.TRUTH), ('sensor', Stage.SENSOR), ('recorder', Stage.RECORDER))]
    supervisor = Supervisor(separate(specs), Path(sys.argv[1]), dict(os.environ),
                            on_line=lambda name, line: print(name, line, flush=True))
    outcome = supervisor.run()
    print(outcome.status.value, outcome.sentence, flush=True)
"""


def host(tmp_path, fake, sensor):
    fake('truth', ENDLESS, Stage.TRUTH)
    fake('sensor', sensor)
    fake('recorder', PATIENT, Stage.RECORDER)
    script = tmp_path / 'host.py'
    script.write_text(textwrap.dedent(HOST))
    process = subprocess.Popen(
        [sys.executable, script, tmp_path / 'run'], stdout=subprocess.PIPE, text=True
    )
    up = {process.stdout.readline().split()[0] for _ in range(2)}
    assert up == {'/vehicle/sensor', '/vehicle/recorder'}
    time.sleep(0.3)  # the truth prints nothing; let it set its handler
    return process


def running(tmp_path) -> list[str]:
    found = []
    for entry in Path('/proc').iterdir():
        try:
            command = (entry / 'cmdline').read_text()
        except (OSError, UnicodeDecodeError):
            continue
        if entry.name.isdigit() and 'fake_' in command and str(tmp_path) in command:
            found.append(command)
    return found


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_supervisor_is_an_orderly_end(tmp_path, fake, number):
    process = host(tmp_path, fake, PATIENT)
    process.send_signal(number)
    output, _ = process.communicate(timeout=10)
    assert f'interrupted ended by {number.name}' in output
    assert down_ns(tmp_path, 'sensor') < down_ns(tmp_path, 'recorder')
    assert running(tmp_path) == []


def test_a_second_ctrl_c_does_not_wait(tmp_path, fake):
    process = host(tmp_path, fake, DEAF)
    process.send_signal(signal.SIGINT)
    time.sleep(1.0)
    assert process.poll() is None  # waits for the deaf one
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=5)
    assert 'interrupted' in output
    assert running(tmp_path) == []


def test_nothing_outlives_a_killed_supervisor(tmp_path, fake):
    process = host(
        tmp_path,
        fake,
        ENDLESS.replace('time.sleep(60)', 'print("up", flush=True); time.sleep(60)'),
    )
    assert len(running(tmp_path)) == 3
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 5.0
    while running(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert running(tmp_path) == []
