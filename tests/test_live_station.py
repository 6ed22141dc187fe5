"""A station in place of a leader, live: navigation by the vehicle's model, recorded and replayed.

Real nodes, DDS, bag, replay, verify, score, report.
"""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from live_support import FinishedDemo, polar

from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import estimates_from_cdr, receipts_from_cdr
from polar_nav_tools.bags.model import model_run_from_cdr
from polar_nav_tools.replay.arrays_from_bag import load_arrays
from polar_nav_tools.replay.by_array import replay_arrays
from polar_nav_tools.replay.by_message import replay

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.timeout(900)]

SECONDS = 120.0
NAMES = ('published', 'default')


@pytest.fixture(scope='module')
def station_demo(tmp_path_factory):
    bag = tmp_path_factory.mktemp('station') / 'bag'
    arguments = ('demo', '--mission', 'station', '--duration', SECONDS, '--json', '--bag', bag)
    process = polar(*arguments, timeout=600.0)
    assert process.returncode == 0, process.stderr
    return FinishedDemo(process, json.loads(process.stdout), bag)


def test_all_is_well_and_nothing_was_lost(station_demo):
    figures = station_demo.figures
    assert figures['complaints'] == []
    assert figures['counts_equal'] is True
    samples = round(100 * SECONDS)
    assert figures['counts']['/auv/imu/data']['received'] == samples
    thrusts = figures['counts']['/auv/control/thrust']
    assert thrusts['received'] == thrusts['recorded'] == pytest.approx(10 * SECONDS, abs=2)


def test_the_replay_repeats_state_receipts_current_and_model_bit_for_bit(station_demo):
    verify = station_demo.figures['verify']
    assert verify['equal'] is True
    assert {'nav/state', 'nav/receipt', 'nav/current', 'nav/model'} <= set(verify['sha256'])
    done = polar('verify', station_demo.bag, '--json')
    assert done.returncode == 0, done.stderr
    topics = json.loads(done.stdout)['topics']
    assert topics['nav/current']['live_messages'] == pytest.approx(SECONDS, abs=3)
    assert topics['nav/model'] == topics['nav/model'] | {
        'replayed_messages': topics['nav/current']['replayed_messages']
    }


def test_every_packet_has_a_verdict_and_every_score_is_finite(station_demo):
    received = station_demo.figures['counts']['/auv/acomms/rx']['received']
    assert received > 0.6 * SECONDS / 2.5
    for name in NAMES:
        one = station_demo.figures['algorithms'][name]
        assert sum(one['verdicts'].values()) == one['fixes'] == received
        assert one['verdicts']['FUSED'] > 0.5 * received
        assert all(math.isfinite(v) for v in one['rms'].values())


def test_water_and_drag_are_scored_against_their_truth(station_demo):
    done = polar('score', station_demo.bag, '--json')
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)['runs']
    assert set(runs) == set(NAMES)
    late = runs['default']['model']['windows']['second_half']
    current = late['quantities']['current, grid east']
    # Two minutes do not tell the current well, but better than not at all: it flows at 0.47 m/s.
    assert abs(current['final'] - current['truth']) < 4.0 * current['final_sigma'] < 1.2
    assert math.isfinite(late['nees']['current, 2 dof']['mean_per_dof'])


def test_other_strategies_replay_the_same_bag(station_demo):
    done = polar('score', station_demo.bag, '--configs', 'ignore,clone,default', '--json')
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)['runs']
    assert set(runs) == {'ignore', 'clone', 'default'}
    found = {name: run['summary']['horizontal_second_half'] for name, run in runs.items()}
    assert found['ignore'] != found['default']
    assert found['clone'] == pytest.approx(found['default'], rel=0.2)


@pytest.mark.parametrize('name', ['published', 'default', 'tagged'])
def test_arrays_give_the_bits_of_the_messages(station_demo, name):
    bag = open_bag(station_demo.bag)
    fast = replay_arrays(load_arrays(bag), configuration=name)
    slow = replay(bag, configuration=name)
    assert (fast.taken, fast.verdicts) == (slow.taken, slow.verdicts)
    assert_same(fast.estimates, estimates_from_cdr(slow.of('nav/state'), 'auv'))
    model = model_run_from_cdr(slow.of('nav/model'), slow.of('nav/identification'), None)
    assert_same(fast.model.estimated, model.estimated)
    assert fast.model.identified == model.identified
    receipts = receipts_from_cdr(slow.of('nav/receipt'))
    assert len(fast.receipts) == len(receipts)
    for one, other in zip(fast.receipts, receipts, strict=True):
        assert_same(one, other)


def assert_same(one, other):
    """All fields of two dataclasses, to the last bit."""
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, float | np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=field.name)
        else:
            assert a == b, field.name


def test_the_story_of_a_fix_and_the_health_of_the_bag_are_told(station_demo):
    done = polar('why', station_demo.bag, '--seq', '5')
    assert done.returncode == 0, done.stderr
    assert 'Content of the packet, by the station' in done.stdout
    assert 'away at t3' in done.stdout
    assert polar('doctor', station_demo.bag).returncode == 0
    assert polar('info', station_demo.bag).returncode == 0


def test_the_report_shows_the_current_as_an_arrow_and_the_drag_with_its_truth(station_demo):
    html = (station_demo.bag / 'report.html').read_text()
    assert 'Current estimated by default: at the end' in html
    assert 'Parameters estimated by default at the end of the run: drag d1x' in html
    assert 'Polar stereographic map: auv and station' in html
