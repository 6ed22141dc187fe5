"""A cheap vehicle's drivers: mapped as they run, two lines filled in, a follower, who hears it."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from live_support import FOLLOWER, TOOL, Processes, interrupt, polar, written

from polar_nav_core.engine.verdicts import Verdict
from polar_nav_tools.bags import open_bag
from polar_nav_tools.experiments.cheap import recording, vehicle
from polar_nav_tools.foreign.definitions import BUNDLED
from polar_nav_tools.play import generate, schemas

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.slow, pytest.mark.timeout(900)]

HERE = Path(__file__).parent
SEED, SECONDS = 3, 40.0
LONG_ENOUGH = 300.0
"""Duration of a voyage that is ended when it was mapped [s]."""


@pytest.fixture(scope='module')
def driver_types(tmp_path_factory) -> Path:
    """Prefix of dvl_msgs, which is in no wheel: built from its definitions, as `play` does."""
    if generate.has_package('dvl_msgs'):
        pytest.skip('dvl_msgs is installed; this test is of a computer without')
    texts = {recording.DVL_TYPE: BUNDLED[recording.DVL_TYPE]}
    recipes = schemas.plan(texts, generate.has_package).recipes
    prefixes, failed = generate.provide(
        recipes, tmp_path_factory.mktemp('messages'), lambda _: None
    )
    if failed:
        pytest.skip(failed['dvl_msgs'])
    return prefixes['dvl_msgs']


@pytest.fixture
def start(tmp_path, own_domain, driver_types):
    """Start a process that knows the driver's types; it is ended with the test."""
    processes = Processes(tmp_path, own_domain, driver_types / 'environment.sh')
    yield processes
    processes.end()


def filled_in(text: str) -> str:
    """The mapping of `polar map --live` with the two lines that only a person knows."""
    for key, value in (('sigma', '2.5'), ('reference', 'true')):
        assert text.count(f' {key}: FILL_IN\n') == 1, text
        text = text.replace(f' {key}: FILL_IN\n', f' {key}: {value}\n')
    assert 'FILL_IN' not in text
    return text


def test_drivers_to_odometry_and_tf_over_another_middleware(tmp_path, start, own_domain):
    """Best effort in, mapped live; Odometry and /tf out, also heard by CycloneDDS; live is replay.

    Place, height, tilt and heading of the start are found by the node: nobody states them.
    """
    run = recording.readings(SEED, SECONDS)
    program = (sys.executable, HERE / 'cheap_drivers.py', SEED)
    mapped_drivers = start('mapped drivers', *program, LONG_ENOUGH)
    mapping = tmp_path / 'mapping.yaml'
    known = ('--imu', 'vn100', '--dvl', 'a50_standard', '--reference', 'bottom')
    into_file = ('bash', '-c', f'"$@" > {mapping}', 'bash')
    mapped = start('map', *into_file, *TOOL, 'map', '--live', '--seconds', '6', *known)
    assert mapped.wait(60.0) == 0, (tmp_path / 'map.log').read_text()
    mapped_drivers.kill()
    mapped_drivers.wait()
    mapping.write_text(filled_in(mapping.read_text(encoding='utf-8')), encoding='utf-8')
    bag = tmp_path / 'bag'
    recorder = start('recorder', *TOOL, 'record', '--out', bag)
    until_there(bag)
    # However long these take to start: the voyage begins when recorder and follower both listen.
    start('drivers', *program, SECONDS, 2)
    ros = ('--ros-args', '-r', '__ns:=/auv', '-p', f'sources:={mapping}')
    follower = start('follower', *FOLLOWER, *ros)
    listener = None
    if importlib.util.find_spec('cyclonedds') is not None:
        listener = subprocess.Popen(
            [sys.executable, HERE / 'cyclone_listener.py', '/auv', '200'],
            env=own_domain,
            stdout=subprocess.PIPE,
            text=True,
        )
    try:
        start.wait_for('drivers', 'published all', 300.0)
        until_recorded(bag / 'bag_0.mcap', run)
    finally:
        heard = None if listener is None else _heard(listener)
    interrupt(follower)
    interrupt(recorder)

    verified = polar('verify', bag, timeout=120.0)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    recorded = open_bag(bag)
    states = [m for _, m in recorded.read('/auv/nav/state')]
    assert len(states) > 80
    started = [m for _, m in recorded.read('/auv/nav/start')][-1].status[0].message
    assert 'heading measured by heading/data' in started
    receipts = [m for _, m in recorded.read('/auv/nav/receipt') if m.source == 'ugps/fix']
    assert sum(m.verdict == Verdict.FUSED for m in receipts) > 5
    latitude, longitude = (np.array([getattr(states[-1], n)]) for n in ('latitude', 'longitude'))
    where = vehicle.level_of(latitude, longitude)[0]
    assert abs(where - run.motion.position_n[-1, :2]).max() < 10.0
    frames = {
        (t.header.frame_id, t.child_frame_id)
        for _, m in recorded.read('/tf')
        for t in m.transforms
    }
    assert frames == {('auv/map', 'auv/odom'), ('auv/odom', 'auv/base_link')}
    if heard is None:
        pytest.skip('all but the last held; cyclonedds (requirements of the tests) is not here')
    assert heard['frame'] == 'auv/map'
    assert heard['child'] == 'auv/base_link'
    assert {tuple(f) for f in heard['frames']} == frames
    assert 0.0 < heard['variance'] < 1e4


def until_recorded(file: Path, run: recording.Readings) -> None:
    """Wait until a bag that is being written has the last message of each driver."""
    wanted = Counter(topic for topic, _, _ in recording.messages(run, 10**18))
    deadline = time.monotonic() + 60.0
    while missing := {t: n for t, n in wanted.items() if written(file, t) < n}:
        assert time.monotonic() < deadline, missing
        time.sleep(0.1)


def until_there(folder: Path) -> None:
    """Wait for a folder."""
    deadline = time.monotonic() + 60.0
    while not folder.is_dir():
        assert time.monotonic() < deadline, folder
        time.sleep(0.05)


def _heard(listener: subprocess.Popen[str]) -> dict:
    """What the subscriber of another middleware printed; it ends by itself."""
    deadline = time.monotonic() + 30.0
    while listener.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)
    if listener.poll() is None:
        os.kill(listener.pid, signal.SIGKILL)
    out, _ = listener.communicate()
    return json.loads(out)
