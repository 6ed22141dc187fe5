"""The file of a saved state: replaced as a whole, and never a reason not to start."""

import dataclasses
import os
import signal
import subprocess
import sys

import pytest

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ImuSample
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.saved import pack
from polar_nav_ros.state_store import StateStore, _read, _write

pytest.importorskip('rclpy')

import numpy as np

START_NS = 10**18


class Log:
    """Collects what is logged."""

    def __init__(self):
        self.lines = []
        self.info = self.warning = self.error = self.lines.append


@pytest.fixture(scope='module')
def engine():
    engine = Engine(EngineParams())
    for k in range(3):
        sample = ImuSample(START_NS + k * 10**7, k, np.zeros(3), np.array([0.0, 0.0, 9.8]))
        list(engine.process(sample))
    return engine


def store(path, vehicle='auv'):
    return StateStore(path, 5.0, 60.0, Log(), vehicle)


def test_a_state_is_saved_once_a_period_and_found_again(engine, tmp_path):
    path = tmp_path / 'folder' / 'state'
    first = store(path)
    assert 'first start' in first._logger.lines[0]
    assert first.take(engine.params, START_NS) is None
    for k in range(12):
        first.save_if_due(engine, START_NS + k * 10**9)
        assert path.exists() == (k >= 5)
    again = store(path)
    found = again.take(engine.params, START_NS + 7 * 10**9)
    assert found is not None
    assert found.stamp_ns == START_NS + 2 * 10**7
    assert again.status == 'restored, 7.0 s old'
    assert again.take(engine.params, START_NS) is None


@pytest.mark.parametrize(
    ('after_s', 'words'), [(61.0, '61.0 s old, state_max_age_s is 60 s'), (-1.0, 'newer')]
)
def test_a_state_of_another_time_is_left(engine, tmp_path, after_s, words):
    path = tmp_path / 'state'
    store(path).save(engine)
    again = store(path)
    stamp_ns = START_NS + 2 * 10**7 + round(after_s * 1e9)
    assert again.take(engine.params, stamp_ns) is None
    assert words in again._logger.lines[-1]


def test_a_state_of_another_filter_is_left(engine, tmp_path):
    path = tmp_path / 'state'
    store(path).save(engine)
    again = store(path)
    params = dataclasses.replace(engine.params, mode='station', initialize='service')
    assert again.take(params, START_NS + 10**9) is None
    assert 'of a filter sins' in again._logger.lines[-2]


def test_a_state_of_another_vehicle_is_kept_aside(engine, tmp_path):
    path = tmp_path / 'state'
    store(path, 'pair/leader').save(engine)
    again = store(path)
    assert again.take(engine.params, START_NS + 10**9) is None
    assert "of vehicle 'pair/leader', this one is 'auv'" in again._logger.lines[0]
    assert path.with_name('state.aside').exists()


def test_a_state_that_names_no_vehicle_is_taken(engine, tmp_path):
    """As a follower of an older version saves it."""
    path = tmp_path / 'state'
    path.write_bytes(pack(engine.saved()))
    assert store(path).take(engine.params, START_NS + 10**9) is not None


@pytest.mark.parametrize('content', [b'', b'rubbish' * 100, None])
def test_a_file_that_is_none_is_left(tmp_path, content):
    path = tmp_path / 'state'
    path.mkdir() if content is None else path.write_bytes(content)
    found = store(path)
    assert found.take(EngineParams(), 0) is None
    assert 'not restored' in found._logger.lines[0]
    if content is not None:
        assert path.with_name('state.aside').read_bytes() == content


def test_a_state_of_an_older_engine_is_kept_aside_and_it_is_a_first_start(engine, tmp_path):
    path = tmp_path / 'state'
    saved = engine.saved()
    values = {n: v for n, v in saved.values.items() if n not in ('turn', 'leader')}
    data = pack(dataclasses.replace(saved, values=values))
    data = data[:8] + (1).to_bytes(2, 'little') + data[10:]
    path.write_bytes(data)
    found = store(path)
    assert found.take(engine.params, START_NS + 10**9) is None
    assert 'format 1 and engine 3, this is format 7' in found._logger.lines[0]
    assert 'kept as state.aside, a first start' in found._logger.lines[1]
    found.save(engine)
    assert path.with_name('state.aside').read_bytes() == data
    assert store(path).take(engine.params, START_NS + 10**9) is not None


def test_a_pipe_does_not_hang(tmp_path):
    path = tmp_path / 'state'
    os.mkfifo(path)
    found = store(path)
    assert 'no regular file' in found._logger.lines[0]


def test_a_folder_that_cannot_be_written_is_logged_once(engine, tmp_path):
    (tmp_path / 'file').write_bytes(b'')
    broken = store(tmp_path / 'file' / 'state')
    broken.save(engine)
    broken.save(engine)
    assert sum('cannot be saved' in line for line in broken._logger.lines) == 1
    assert broken.status.startswith('not saved')
    assert broken.problem.endswith(broken.status)
    fine = store(tmp_path / 'state')
    fine.save(engine)
    assert fine.problem == ''


def test_killed_while_it_writes_leaves_the_older_one(engine, tmp_path):
    """A process ends by SIGKILL with half of the new state written."""
    path = tmp_path / 'state'
    _write(path, pack(engine.saved()))
    script = (
        'import os, signal, sys\n'
        'from pathlib import Path\n'
        'from polar_nav_ros import state_store\n'
        'os.fsync = lambda handle: os.kill(os.getpid(), signal.SIGKILL)\n'
        'state_store._write(Path(sys.argv[1]), b"new" * 100000)\n'
    )
    ended = subprocess.run([sys.executable, '-c', script, str(path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert _read(path) == pack(engine.saved())
    _write(path, b'newest')  # what the killed one left is no obstacle
    assert _read(path) == b'newest'
    assert [p.name for p in tmp_path.iterdir()] == ['state']
