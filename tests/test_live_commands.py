"""`polar launch` and `polar record`: the graph in real time, and a recorder beside it."""

from __future__ import annotations

import json
import signal
import subprocess
import time

import pytest
from live_support import TOOL, polar, processes_with, written

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.timeout(400)]

STATE, IMU = '/follower/nav/state', '/follower/imu/data_raw'


@pytest.fixture
def launch(own_domain, tmp_path):
    """`polar launch` under way in real time, with a bag of its own."""
    bag = tmp_path / 'launched'
    log = tmp_path / 'launch.txt'
    with log.open('wb') as stderr:
        process = subprocess.Popen(
            [*TOOL, 'launch', '--duration', '200', '--bag', str(bag)],
            cwd=tmp_path,
            env=own_domain,
            stderr=stderr,
        )
    deadline = time.monotonic() + 90.0
    while ' of 200 s' not in log.read_text() or not (bag / 'launched_0.mcap').exists():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.1)
    yield process, bag, log
    if process.poll() is None:
        process.kill()
    process.communicate()


def test_launch_ends_well_on_ctrl_c_and_its_bag_verifies(launch):
    process, bag, log = launch
    file = bag / 'launched_0.mcap'
    deadline = time.monotonic() + 120.0
    while written(file, STATE) <= 10:
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60.0)
    assert process.returncode == 0, log.read_text()
    assert processes_with(f'{bag}.run/') == {}
    done = polar('verify', bag, '--json')
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)['topics']['nav/state']['live_messages'] > 10


@pytest.mark.usefixtures('launch')
def test_record_finds_the_topics_of_a_running_graph(own_domain, tmp_path):
    out = tmp_path / 'recorded'
    log = tmp_path / 'record.txt'
    with log.open('wb') as stderr:
        process = subprocess.Popen(
            [*TOOL, 'record', '--out', str(out)], env=own_domain, stderr=stderr
        )
    deadline = time.monotonic() + 60.0
    file = out / 'recorded_0.mcap'
    wanted = {STATE: 11, IMU: 101, '/run_info': 13}
    # Each node is found in its own time. What they say of themselves was published once, before
    # this recorder was there, and is kept for those who come late.
    while any(written(file, topic) < least for topic, least in wanted.items()):
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60.0)
    assert process.returncode == 0, log.read_text()
    info = polar('info', out, '--json')
    assert info.returncode == 0, info.stderr
    counts = {t['name']: t['count'] for t in json.loads(info.stdout)['topics']}
    assert all(counts[topic] >= least for topic, least in wanted.items()), counts


def test_bench_live_is_answered():
    """No figure is judged: they are of whatever else this computer does."""
    done = polar('bench', 'live', '--rate', '100', '--seconds', '1', '--json', timeout=300.0)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)['rates'][0]['answered'] > 0.0
