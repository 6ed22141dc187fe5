"""A vehicle with an AHRS, live: the mission `ahrs`, whose follower is told a mapping file only.

Simulated drivers of standard messages (Imu, its orientation by a magnetometer, twist of a DVL,
FluidPressure, NavSatFix), no leader, no stated start; recorded, replayed, verified, scored.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from live_support import FinishedDemo, polar

from polar_nav_core.params import from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import load_truth
from polar_nav_tools.replay.recorded import load_inputs

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.timeout(600)]

SECONDS = 50.0


@pytest.fixture(scope='module')
def ahrs_demo(tmp_path_factory):
    bag = tmp_path_factory.mktemp('ahrs') / 'bag'
    arguments = ('demo', '--mission', 'ahrs', '--duration', SECONDS, '--json', '--bag', bag)
    process = polar(*arguments, timeout=400.0)
    assert process.returncode == 0, process.stderr
    return FinishedDemo(process, json.loads(process.stdout), bag)


def test_all_is_well_and_nothing_of_any_source_was_lost(ahrs_demo):
    figures = ahrs_demo.figures
    assert figures['complaints'] == []
    assert figures['counts_equal'] is True
    received = {topic: c['received'] for topic, c in figures['counts'].items() if c['received']}
    assert received == {
        '/auv/truth': 100 * SECONDS + 1,
        '/auv/imu/data_raw': 100 * SECONDS,
        '/auv/dvl/twist': 5 * SECONDS + 1,
        '/auv/depth/pressure': 10 * SECONDS + 1,
        '/auv/ahrs/imu': 10 * SECONDS + 1,
        '/auv/absolute/fix': SECONDS / 2 + 1,
    }
    assert not [topic for topic in figures['counts'] if topic.startswith('/leader')]


def test_the_replay_of_what_it_used_repeats_the_live_run_bit_for_bit(ahrs_demo):
    assert ahrs_demo.figures['verify']['equal'] is True
    done = polar('verify', ahrs_demo.bag, '--json')
    assert done.returncode == 0, done.stdout + done.stderr
    topics = json.loads(done.stdout)['topics']
    for name, digests in ahrs_demo.figures['verify']['sha256'].items():
        assert topics[name]['live_sha256'] == topics[name]['replay_sha256'] == digests['live']
    assert topics['nav/state']['live_messages'] > 350


def test_it_found_its_start_by_the_magnetic_heading_with_the_declination_of_the_place(ahrs_demo):
    said = (ahrs_demo.bag / 'run' / 'logs' / 'auv.follower_node.log').read_text()
    assert 'heading measured by heading/data (magnetic north)' in said
    bag = open_bag(ahrs_demo.bag)
    command = next(m for _, m in bag.read('/auv/nav/command'))
    start = command.initial_state
    truth = load_truth(bag, 'auv')
    stamp_ns = command.header.stamp.sec * 10**9 + command.header.stamp.nanosec
    x_G = truth.C_b_G[np.searchsorted(truth.stamp_ns, stamp_ns)][:, 0]
    off = math.remainder(start.grid_heading - math.atan2(x_G[0], x_G[1]), math.tau)
    # The sigma of the start is four times that of the heading (docs/start.md), and the
    # declination, 27 degrees west, is more than five of those.
    assert abs(off) < 3.0 * start.sigma_heading / 4.0 < math.radians(15.0)


def test_headings_go_on_to_be_measured_by_that_declination(ahrs_demo):
    """Taken for true headings, they turn the vehicle until its fixes are refused."""
    params = from_mapping(FollowerParams, load_inputs(ahrs_demo.bag).params)
    assert params.heading_reference == 'magnetic'
    right, wrong = (
        json.loads(polar('replay', ahrs_demo.bag, '--json', *changes).stdout)
        for changes in ((), ('--set', 'heading_reference=true'))
    )
    assert right['taken']['/auv/heading/data'] == 10 * SECONDS + 1
    assert right['health']['warnings'] == right['health']['errors'] == 0
    assert set(right['verdicts']) <= {'FUSED', 'NOT_READY', 'TOO_OLD'}
    assert wrong['health']['warnings'] > 0
    assert wrong['verdicts']['GATED'] > 0


def test_fixes_are_used_a_second_late_and_at_their_validity(ahrs_demo):
    receipts = [m for _, m in open_bag(ahrs_demo.bag).read('/auv/nav/receipt')]
    assert {m.source for m in receipts} == {'ugps'}
    half = {n: f['second_half'] for n, f in ahrs_demo.figures['algorithms'].items()}
    assert half['default']['mean_delay_s'] == pytest.approx(1.0)
    # One seed: 1.5 m per axis and fix, of which there are a dozen.
    assert half['default']['horizontal_rms_m'] < 1.5
    assert half['default']['horizontal_rms_m'] < half['conventional_akf']['horizontal_rms_m']
