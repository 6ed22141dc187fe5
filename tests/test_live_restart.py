"""Nodes that are killed in a real-time run are started again, and the run goes on."""

from __future__ import annotations

import json
import os
import random
import signal
import time

import pytest
from live_support import RunningDemo, polar

from polar_nav_tools.bags import open_bag

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.timeout(300)]

FOLLOWER = '/follower/follower_node'
RECORDER = '/recorder_node'
GROWN = 100_000
"""Bytes of a file that has some seconds of a run."""
PATIENCE_S = 120.0
GOES_ON = 'navigation goes on from a state of'
NAVIGATES = 'follower_node]: navigating, '


def until(true, run):
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert run.process.poll() is None, run.stderr
        assert time.monotonic() < deadline, run.stderr
        time.sleep(0.1)


@pytest.fixture
def launched(tmp_path):
    """`./polar launch` under way."""
    run = RunningDemo(tmp_path, '--duration', '900', command='launch')
    try:
        until(lambda: 'navigating' in run.stderr, run)
        yield run
    finally:
        run.end()


def kill(run, name, count):
    """Kill a node; return when it was started again, and has its state if it is the follower."""
    before = run.node_pid(name)
    os.kill(before, signal.SIGKILL)
    sentence = f'node {name} was killed by SIGKILL: it is started again'
    until(lambda: run.stderr.count(sentence) == count, run)
    until(lambda: any(name.rpartition('/')[2] in c for c in run.nodes().values()), run)
    if name == FOLLOWER:
        until(lambda: run.stderr.count(GOES_ON) == count, run)
    assert before not in run.nodes()


def times_ns(bag, topic):
    """Log times of a topic's messages."""
    return [time_ns for _, time_ns, _ in bag.messages([topic])]


def end_well(run, *, ok=True):
    """End it by Ctrl-C: everything in order, nothing left, a whole bag; its info as JSON."""
    run.process.send_signal(signal.SIGINT)
    run.process.communicate(timeout=60.0)
    assert run.nodes() == {}
    told = polar('info', run.bag, '--json')
    assert told.returncode == (0 if ok else 1), told.stderr
    return json.loads(told.stdout)


def lives(run):
    """Number of the follower's lives in the bag, each of which a replay equals bit for bit."""
    told = polar('verify', run.bag, '--json', timeout=600.0)
    said = json.loads(told.stdout)
    assert said['equal'] is True, told.stderr
    return len(said['lives_s'])


def test_killed_nodes_are_started_again(launched):
    until(lambda: (launched.bag.with_name('bag.run') / 'follower.state').exists(), launched)
    kill(launched, FOLLOWER, 1)
    for name in ('/leader/leader_node', '/acoustic_link_node'):
        kill(launched, name, 1)
    until(lambda: launched.stderr.count(NAVIGATES) == 2, launched)
    kill(launched, RECORDER, 1)
    next_file = launched.bag / 'bag_1.mcap'
    until(lambda: next_file.is_file() and next_file.stat().st_size > GROWN, launched)
    said = end_well(launched, ok=False)
    assert said['files'] == ['bag_0.mcap', 'bag_1.mcap']
    assert len(said['problems']) == 2, said['problems']
    assert 'bag_0.mcap: the recording was not finished' in said['problems'][0]
    assert 'bag_1.mcap: goes on' in said['problems'][1]
    bag = open_bag(launched.bag)
    (restored,) = times_ns(bag, '/follower/nav/restore')
    states = times_ns(bag, '/follower/nav/state')
    assert states[0] < restored < states[-1]
    assert lives(launched) == 2


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_fifty_restarts_of_the_follower(launched):
    until(lambda: (launched.bag.with_name('bag.run') / 'follower.state').exists(), launched)
    draw = random.Random(9971)
    for count in range(1, 51):
        kill(launched, FOLLOWER, count)
        time.sleep(draw.uniform(2.0, 6.0))  # the life of a follower, in the time of the run
    said = end_well(launched)
    counts = {t['name']: t['count'] for t in said['topics']}
    assert counts['/follower/nav/restore'] == 50
    assert lives(launched) == 51
