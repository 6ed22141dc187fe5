"""The nodes of each vehicle in one process: the same bytes, and the same ends, as one by one."""

from __future__ import annotations

import json
import os
import signal
import time

import pytest
from live_support import DEMO_SECONDS, RunningDemo, polar

from polar_nav_tools.bags import open_bag

pytestmark = [pytest.mark.live, pytest.mark.timeout(240)]

FOLLOWER = '/follower (imu_node, dvl_node, depth_node, follower_node)'
LIMIT_S = 10.0


@pytest.fixture(scope='module')
def composed_demo(tmp_path_factory):
    bag = tmp_path_factory.mktemp('composed') / 'bag'
    options = ('--composed', '--duration', DEMO_SECONDS, '--json', '--bag', bag)
    done = polar('demo', *options, timeout=300.0)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), bag


@pytest.fixture
def running(tmp_path):
    """A composed demo that is under way and would go on for long."""
    demo = RunningDemo(tmp_path, '--duration', '200', '--composed')
    try:
        demo.wait_for_progress(2, timeout=90.0)
        yield demo
    finally:
        demo.end()


def of_the_follower(demo):
    """Process id of the follower's nodes."""
    (pid,) = (pid for pid, command in demo.nodes().items() if '__ns:=/follower ' in command)
    return pid


def test_every_message_has_the_bytes_of_separate_processes(finished_demo, composed_demo):
    figures, bag = composed_demo
    assert figures['verify']['equal'] is True
    one, other = open_bag(bag), open_bag(finished_demo.bag)
    # These two are of processes and their time.
    topics = {name for name, t in one.topics.items() if t.count} - {'/diagnostics', '/run_info'}
    assert {'/follower/nav/state', '/follower/nav/receipt', '/leader/usbl/fix'} <= topics
    for topic in topics:
        assert list(one.payloads(topic)) == list(other.payloads(topic)), topic
    assert one.topics['/follower/nav/state'].count > 10 * (DEMO_SECONDS - 3.0)
    assert one.topics['/follower/nav/receipt'].count > 5
    without = {t: c for t, c in figures['counts'].items() if t in topics}
    assert without == {t: c for t, c in finished_demo.figures['counts'].items() if t in topics}


def test_nodes_parameters_and_logs_are_all_there(composed_demo):
    _, bag = composed_demo
    info = json.loads(polar('info', bag, '--json').stdout)
    assert len(info['nodes']) == 13
    assert info['run_info']['composed'] is True
    logs = {path.name for path in (bag / 'run' / 'logs').glob('*.log')}
    assert logs == {
        'truth_node.log',
        'acoustic_link_node.log',
        'recorder_node.log',
        'leader.log',
        'follower.log',
    }
    assert len(list((bag / 'run' / 'params').glob('*.yaml'))) == 13


def test_a_vehicle_of_mapped_sources_verifies(tmp_path):
    """What nav/inputs says of bytes that never left the process is true of those recorded."""
    options = ('--mission', 'ahrs', '--composed', '--duration', '20', '--json')
    done = polar('demo', *options, '--bag', tmp_path / 'bag', timeout=200.0)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)['verify']['equal'] is True


def test_a_killed_vehicle_is_named_in_time_and_the_bag_is_readable(running):
    assert len(running.nodes()) == 5
    os.kill(of_the_follower(running), signal.SIGKILL)
    killed = time.monotonic()
    running.process.communicate(timeout=60.0)
    assert time.monotonic() - killed < LIMIT_S
    assert running.process.returncode == 1
    assert f'process {FOLLOWER} was killed by SIGKILL' in running.stderr
    assert running.nodes() == {}
    assert json.loads(polar('info', running.bag, '--json').stdout)['ok'] is True


def test_a_frozen_vehicle_is_named_and_an_interrupted_run_verifies(running):
    pid = of_the_follower(running)
    os.kill(pid, signal.SIGSTOP)
    wait_for(running, f'process {FOLLOWER} has not answered for 10 s: it is stopped (SIGSTOP)')
    os.kill(pid, signal.SIGCONT)
    wait_for(running, f'process {FOLLOWER} answers again')
    running.process.send_signal(signal.SIGINT)
    running.process.communicate(timeout=60.0)
    assert running.process.returncode == 130, running.stderr
    assert running.nodes() == {}
    done = polar('verify', running.bag, '--json')
    assert done.returncode == 0, done.stderr


def wait_for(demo, sentence):
    deadline = time.monotonic() + 60.0
    while sentence not in demo.stderr:
        assert demo.process.poll() is None, demo.stderr
        assert time.monotonic() < deadline, demo.stderr
        time.sleep(0.1)


def test_nothing_is_left_when_the_tool_itself_is_killed(running):
    assert len(running.nodes()) == 5
    running.process.kill()
    running.process.communicate()
    deadline = time.monotonic() + LIMIT_S
    while running.nodes() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert running.nodes() == {}


def test_the_benchmark_compares_bytes_and_counts_processes():
    options = ('--seconds', '20', '--rounds', '1', '--json')
    done = polar('bench', 'graph', *options, timeout=200.0)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    rounds = {way: runs[0] for way, runs in said['rounds'].items()}
    assert (rounds['separate']['processes'], rounds['composed']['processes']) == (13, 5)
    assert said['ratios']['memory_mb']['median'] > 1.5
    assert all(value > 0.0 for run in rounds.values() for value in run.values())


def test_a_long_run_is_measured_by_process_and_its_split_bag_verified():
    options = ('--hours', '0.02', '--max-bag-size', '1', '--composed', '--json')
    done = polar('bench', 'endurance', *options, timeout=200.0)
    said = json.loads(done.stdout)
    assert done.returncode == (0 if said['ok'] else 1), done.stderr
    assert said['problems'] == []
    assert said['files'] > 3
    assert len(said['memory']) == 5
    assert all(20.0 < one['second_quarter_mb'] <= one['most_mb'] for one in said['memory'])
