"""Nodes that are killed in a real-time run are started again, and the run goes on."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from contextlib import contextmanager

import pytest
from live_support import RunningDemo, polar
from restarts import SOON_S, late_or_off, optimistic, restarts_of, table_of

from polar_nav_core.engine.saved import unpack
from polar_nav_tools.bags import open_bag

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.slow, pytest.mark.timeout(300)]

FOLLOWER = '/follower/follower_node'
RECORDER = '/recorder_node'
GROWN = 100_000
"""Bytes of a file that has some seconds of a run."""
PATIENCE_S = 300.0
GOES_ON = 'navigation goes on from a state of'
NAVIGATES = 'follower_node]: navigating, '


def until(true, run):
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert run.process.poll() is None, run.stderr
        assert time.monotonic() < deadline, run.stderr
        time.sleep(0.1)


@contextmanager
def launched(folder, domain, *arguments):
    """`./polar launch` under way, in a domain where no other graph is."""
    env = {**os.environ, 'ROS_DOMAIN_ID': domain['ROS_DOMAIN_ID']}
    run = RunningDemo(folder, *arguments, command='launch', env=env)
    try:
        until(lambda: NAVIGATES in run.stderr, run)
        yield run
    finally:
        run.end()


def state_file(run):
    """File with the follower's state, which is replaced every second."""
    return run.bag.with_name('bag.run') / 'follower.state'


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


def fused(run):
    """Fixes that the follower had fused when it saved its state."""
    return unpack(state_file(run).read_bytes()).fixes[1]


def live_on(run, seen, fixes):
    """Let the follower navigate, from a place on stderr on, until it has fused more fixes."""
    until(lambda: NAVIGATES in run.stderr[seen:] and state_file(run).exists(), run)
    enough = fused(run) + fixes
    until(lambda: fused(run) >= enough, run)


def restart(run, number, fixes):
    """Kill the follower for the so-manieth time, and let it navigate and fuse some fixes."""
    if number == 1:
        live_on(run, 0, fixes)
    seen = len(run.stderr)
    kill(run, FOLLOWER, number)
    live_on(run, seen, fixes)


@pytest.mark.timeout(900)
def test_killed_nodes_are_started_again(tmp_path, own_domain):
    with launched(tmp_path, own_domain, '--duration', '900') as run:
        for number in (1, 2):
            restart(run, number, fixes=3)
        for name in ('/leader/leader_node', '/acoustic_link_node'):
            kill(run, name, 1)
        live_on(run, 0, 1)
        kill(run, RECORDER, 1)
        next_file = run.bag / 'bag_1.mcap'
        until(lambda: next_file.is_file() and next_file.stat().st_size > GROWN, run)
        said = end_well(run, ok=False)
        assert said['files'] == ['bag_0.mcap', 'bag_1.mcap']
        assert len(said['problems']) == 2, said['problems']
        assert 'bag_0.mcap: the recording was not finished' in said['problems'][0]
        assert 'bag_1.mcap: goes on' in said['problems'][1]
        found = restarts_of(open_bag(run.bag))
        assert len(found) == 2
        # After a few fixes of 1 m it is some metres off, and states so.
        assert all(max(r.stamps_s, r.published_s) < SOON_S for r in found), table_of(found)
        assert all(r.nees['position'] < 21.1 for r in found), table_of(found)  # 99.99 %
        assert lives(run) == 3


@pytest.mark.long
@pytest.mark.timeout(14400)
def test_fifty_restarts_of_the_follower(tmp_path, own_domain):
    """Each first estimate within 5 s and 1 m + 2 % of the way; no mean NEES above its band.

    The first life settles the filter; what it knows goes on from life to life.
    """
    draw = random.Random(9971)
    with launched(tmp_path, own_domain, '--duration', '20000') as run:
        live_on(run, 0, fixes=60)
        for number in range(1, 51):
            restart(run, number, fixes=draw.randint(12, 24))
        end_well(run)
        found = restarts_of(open_bag(run.bag))
        sys.stdout.write(f'{table_of(found)}\n')
        assert len(found) == 50
        assert not late_or_off(found)
        assert not optimistic(found)
        assert lives(run) == 51
