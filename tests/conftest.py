"""Fixtures of the live graph: one finished demo for all tests, one that is under way for each."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_support import DEMO_SECONDS, FinishedDemo, RunningDemo, polar

sys.path.insert(0, str(Path(__file__).parents[1] / 'polar_nav_tools' / 'test'))

from against_mcap import bags_also_read_by_mcap  # noqa: F401 - a fixture of every test

# A suite that a script starts in the background inherits an ignored SIGINT, and so would every
# program that is interrupted here.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def running_demo(tmp_path: Path) -> Iterator[RunningDemo]:
    """A demo that is under way and would go on for long."""
    demo = RunningDemo(tmp_path, '--duration', '200')
    try:
        demo.wait_for_progress(2, timeout=90.0)  # the first line only says that it started
        yield demo
    finally:
        demo.end()


@pytest.fixture(scope='session')
def finished_demo(tmp_path_factory: pytest.TempPathFactory) -> FinishedDemo:
    """The demo in short, run once for all tests."""
    bag = tmp_path_factory.mktemp('demo') / 'bag'
    process = polar('demo', '--duration', DEMO_SECONDS, '--json', '--bag', bag, timeout=300.0)
    assert process.returncode == 0, process.stderr
    return FinishedDemo(process, json.loads(process.stdout), bag)


@pytest.fixture(scope='session')
def own_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Environment in a ROS domain of this test session, on the loopback interface."""
    from polar_nav_tools.live.domain import busy_udp_ports, free_domain_id, last_port
    from polar_nav_tools.live.middleware import middleware_environment

    given = os.environ.get('ROS_DOMAIN_ID')
    domain = int(given or free_domain_id(os.getpid(), busy_udp_ports()))
    folder = tmp_path_factory.mktemp('middleware')
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        if not given:
            # Nobody takes it for a free one between two tests: graphs run beside this session.
            held.bind(('127.0.0.1', last_port(domain)))
        yield {
            **os.environ,
            'ROS_DOMAIN_ID': str(domain),
            **middleware_environment(folder, os.environ, network=False),
        }
