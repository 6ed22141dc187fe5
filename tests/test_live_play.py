"""A recording played to a follower that navigates live, and what it makes of it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import yaml
from live_support import FOLLOWER, TOOL, Processes, interrupt, polar

from polar_nav_core.engine.verdicts import Verdict
from polar_nav_tools.bags import open_bag
from polar_nav_tools.replay.by_message import replay

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.slow, pytest.mark.timeout(300)]

REFERENCE = Path(__file__).parents[1] / 'bags' / 'reference_4'
NODE = '/follower/follower_node'
STATE, RECEIPT = '/follower/nav/state', '/follower/nav/receipt'
SECONDS = 12.0
OUTPUT_PERIODS_OF_THE_END = 10
"""Estimates of the last second: what was recorded after it is missing in the live run."""


@pytest.fixture
def start(tmp_path, own_domain):
    """Start a process; it is ended with the test."""
    processes = Processes(tmp_path, own_domain)
    yield processes
    processes.end()


def until(true, seconds=90.0):
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_follower_that_hears_a_recording_again_estimates_what_a_replay_does(
    tmp_path, start, own_domain
):
    recorded = open_bag(REFERENCE)
    params = {**recorded.node_params(NODE), 'lockstep': False}
    params = {name: value for name, value in params.items() if value != []}
    file = tmp_path / 'follower.yaml'
    file.write_text(yaml.safe_dump({NODE: {'ros__parameters': params}}))
    bag = tmp_path / 'again'
    recorder = start('recorder', *TOOL, 'record', '--out', bag)
    until(lambda: bag.is_dir())
    ros = ('--ros-args', '-r', '__ns:=/follower', '--params-file', file)
    follower = start('follower', *FOLLOWER, *ros)
    # The slower, the less depends on what else this computer does.
    options = ('--inputs', '--exclude', '/leader/*,/follower/truth', '--rate', '0.5')
    span = ('--duration', SECONDS, '--wait', NODE, '--wait-s', 120.0)
    done = polar('play', REFERENCE, *options, *span, timeout=280.0, env=own_domain)
    assert done.returncode == 0, done.stderr
    interrupt(follower)
    interrupt(recorder)

    verified = polar('verify', bag)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    again = open_bag(bag)
    late = [m for _, m in again.read(RECEIPT) if m.verdict == Verdict.TOO_LATE]
    if late:
        pytest.skip(f'the follower was held up: {len(late)} messages came too late for its window')
    same = {**again.node_params(NODE), 'lockstep': False}
    expected = replay(recorded, changes=same).of('nav/state')
    live = list(again.payloads(STATE))
    count = len(live) - OUTPUT_PERIODS_OF_THE_END
    assert count > 8.0 * SECONDS
    assert live[:count] == expected[:count]
