"""A start that is stated again: what it contradicts is told, and fixes that show it wrong count.

A follower that had used fifty fixes took a start 1 km off for settled: it refused true fixes for
good, and nothing was said until three were refused.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World

from polar_nav_core import attitude, earth
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, Fix, ImuSample
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.replaced import Replaced
from polar_nav_core.engine.saved import pack, unpack
from polar_nav_core.error_model import X

AT = 1400
"""IMU epoch of the command: 14 s, after thirteen fixes."""
START = {'initial_sigma_position': 3.0, 'initial_sigma_heading_deg': 0.5}
CONTRADICTED = 'start contradicted'
NS = 10**9
METRE = 1.0 / 6.4e6
"""Of latitude [rad]."""


@pytest.fixture(scope='module')
def world():
    return World(64.0)


@pytest.fixture(scope='module')
def events(world):
    rng = np.random.default_rng(3)
    fixes = world.fixes(1.0, 0.5, rng=rng)
    every = [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *fixes]
    return sorted(every, key=lambda e: e.key)


def stated(world, **changes):
    """The state at the command's epoch, as somebody states it: true but for ``changes``."""
    lat, lon, height = (float(x) for x in earth.geodetic_from_ecef(world.r_e[AT]))
    psi, pitch, roll = (float(x) for x in attitude.euler_from_matrix(world.C_b_G[AT]))
    true = {
        'latitude': lat,
        'longitude': lon,
        'height': height,
        'v_G': tuple(float(v) for v in world.v_G[AT]),
        'roll': roll,
        'pitch': pitch,
        'grid_heading': math.remainder(0.5 * math.pi - psi, 2.0 * math.pi),
    }
    return replace(world.params(**START).initial_state(), **{**true, **changes})


def driven(world, events, start, until_s=64.0, again_ns=()):
    """Levels of conditions by second, from the command on; the engine at the end.

    The start is stated once more so many ns after the first time, for each of ``again_ns``.
    """
    engine = Engine(world.params(configuration='default', **START))
    at_ns, first_ns = int(world.stamps[AT]), int(world.stamps[0])
    commands = [
        Command(at_ns + 1 + after_ns, number, CommandKind.SET_INITIAL_STATE, start)
        for number, after_ns in enumerate((0, *again_ns))
    ]
    told = {}
    for event in sorted([*events, *commands], key=lambda e: e.key):
        if (event.stamp_ns - first_ns) * 1e-9 > until_s:
            break
        list(engine.process(event))
        if engine.health is not None and event.stamp_ns > at_ns:
            second = (engine.health.stamp_ns - first_ns) // 10**9
            told[second] = {p.condition.key: p.condition.level for p in engine.health.present}
    return told, engine


def metres_off(world, engine):
    """Error of the estimate [m]."""
    epoch = (engine.last_imu_ns - int(world.stamps[0])) // 10_000_000
    return float(np.linalg.norm(engine.fusion.filter.state.r_e - world.r_e[epoch]))


def test_a_start_1_km_off_is_told_at_once_and_moved_by_fixes(world, events):
    start = stated(world, latitude=stated(world).latitude + 1000.0 * METRE)
    told, engine = driven(world, events, start)
    levels = [told[t].get(CONTRADICTED) for t in sorted(told)]
    assert levels[0] is Level.ERROR
    assert levels[-1] is None
    assert levels.index(None) == sum(level is Level.ERROR for level in levels)
    assert metres_off(world, engine) < 2.0


def test_without_fixes_it_stays_a_warning(world, events):
    start = stated(world, latitude=stated(world).latitude + 1000.0 * METRE)
    blind = [e for e in events if not hasattr(e, 'covariance_e')]
    engine = driven(world, blind, start, 20.0)[1]
    replaced = engine._beginning.replaced
    for since_s, level in ((59.0, Level.ERROR), (61.0, Level.WARN)):
        (found,) = replaced.conditions(replaced.stamp_ns + round(since_s * 1e9), 9)
        assert found.level is level
        assert '1000 m and 0 deg' in found.sentence
    assert replaced.conditions(replaced.stamp_ns, 10) == []


def test_a_heading_a_quarter_off_is_told_and_turned_by_fixes(world, events):
    start = stated(world, grid_heading=stated(world).grid_heading + 0.5 * math.pi)
    told, engine = driven(world, events, start)
    assert told[min(told)][CONTRADICTED] is Level.ERROR
    assert metres_off(world, engine) < 5.0


@pytest.mark.parametrize(
    'changes',
    [
        {},
        {'latitude': 8.0 * METRE},
        {'latitude': 1000.0 * METRE, 'sigma_position_horizontal': 500.0},
        {'grid_heading': 3.0, 'sigma_heading': 1.0},
    ],
)
def test_a_start_within_what_both_claim_contradicts_nothing(world, events, changes):
    true = stated(world)
    moved = {n: v + getattr(true, n) * (not n.startswith('sigma')) for n, v in changes.items()}
    told, _ = driven(world, events, replace(true, **moved), 16.0)
    assert told
    assert not any(CONTRADICTED in keys for keys in told.values())


def test_a_heading_stated_as_unknown_is_unknown_whatever_fixes_came_before(world, events):
    start = stated(world, grid_heading=stated(world).grid_heading + 3.0, sigma_heading=3.0)
    told, engine = driven(world, events, start, 23.0)
    assert math.degrees(math.sqrt(engine.fusion.filter.published_P[2, 2])) < 10.0
    assert {keys.get('heading unknown') for keys in told.values()} == {Level.ERROR}


def test_a_navigation_that_is_behind_knows_nothing_any_more(world, events):
    """In a gap of the IMU."""
    at_ns = int(world.stamps[AT])
    gone = [e for e in events if not at_ns - 3 * 10**9 < e.stamp_ns <= at_ns]
    start = stated(world, latitude=stated(world).latitude + 1000.0 * METRE)
    _, engine = driven(world, gone, start, 15.0)
    assert engine._beginning.replaced is None


@pytest.mark.parametrize('again_ns', [1, 1_000_000_000])
def test_a_wrong_start_that_is_stated_twice_is_no_more_right(world, events, again_ns):
    """The second agrees with the first: before the next sample, and a second later."""
    start = stated(world, latitude=stated(world).latitude + 1000.0 * METRE)
    told, engine = driven(world, events, start, again_ns=(again_ns,))
    seconds = sorted(told)
    assert [told[t].get(CONTRADICTED) for t in seconds[:8]] == [Level.ERROR] * 8
    assert told[seconds[-1]].get(CONTRADICTED) is None
    assert metres_off(world, engine) < 2.0


def test_a_wrong_heading_that_is_stated_twice_is_turned_all_the_same(world, events):
    start = stated(world, grid_heading=stated(world).grid_heading + 0.5 * math.pi)
    _, engine = driven(world, events, start, again_ns=(1,))
    assert metres_off(world, engine) < 5.0


def test_a_heading_is_in_doubt_for_five_minutes():
    """Forged fixes that turn later meet a heading that is vouched for again."""
    found = Replaced(10**9, 0.0, 1.5, 100.0)
    assert found.heading_doubt(10**9 + 299 * 10**9) == 1.5
    assert found.heading_doubt(10**9 + 301 * 10**9) == 0.0


def test_a_restart_knows_how_many_fixes_came_since_the_start(world, events):
    start = stated(world, latitude=stated(world).latitude + 1000.0 * METRE)
    _, engine = driven(world, events, start, 16.0)
    saved = unpack(pack(engine.saved()))
    assert saved.fixes[1] > 10
    assert saved.since_start == engine.ledger.fused_since_start == 0
    engine.ledger.restore(saved.fixes, saved.records, saved.since_start)
    assert engine.ledger.fused_since_start == 0
    engine.ledger.restore(saved.fixes, saved.records)  # of an older file
    assert engine.ledger.fused_since_start == saved.fixes[1]


def led_astray(events, world, by_m):
    """Events with fixes that lie so far to one side from the command on."""
    side_e = np.cross(world.r_e[AT], [0.0, 1.0, 0.0])
    by_e = by_m * side_e / np.linalg.norm(side_e)
    at_ns = int(world.stamps[AT])
    return [
        replace(e, r_e=e.r_e + by_e) if isinstance(e, Fix) and e.validity_ns > at_ns else e
        for e in events
    ]


@pytest.mark.parametrize('again_ns', [(), (1, 2, 3), (NS // 2,)])
def test_fixes_that_lead_a_vague_start_away_from_the_old_navigation_are_told(
    world, events, again_ns
):
    """The first one fits the sigma of the start, and that is all a gate asks for."""
    start = stated(world, sigma_position_horizontal=20.0)
    away = led_astray(events, world, 15.0)
    told, engine = driven(world, away, start, 18.0, again_ns)
    assert engine.ledger.fused_since_start
    assert told[17][CONTRADICTED] is Level.ERROR
    (found,) = [p for p in engine.health.present if p.condition.key == CONTRADICTED]
    assert found.condition.sentence.startswith('the first fixes have led the stated start 1')


def test_true_fixes_of_a_vague_start_are_no_contradiction(world, events):
    told, engine = driven(world, events, stated(world, sigma_position_horizontal=20.0), 40.0)
    assert engine.ledger.fused_since_start > 10
    assert not [second for second, found in told.items() if CONTRADICTED in found]


def test_a_state_that_is_stated_in_a_gap_may_be_off_by_the_way_in_it(world, events):
    """It may be of any moment of the gap."""
    first, last = int(world.stamps[AT]), int(world.stamps[AT + 300])
    heard = [e for e in events if not (isinstance(e, ImuSample) and first < e.stamp_ns < last)]
    start = stated(world, sigma_position_horizontal=0.5)
    _, engine = driven(world, heard, start, 17.05)
    off_m = metres_off(world, engine)
    sigma = math.sqrt(float(np.trace(engine.fusion.filter.published_P[X.dr_e, X.dr_e])))
    assert 4.0 < off_m < 2.0 * sigma
    _, engine = driven(world, heard, replace(start, v_G=(0.0, 0.0, 0.0)), 17.05)
    assert math.degrees(math.sqrt(float(engine.fusion.filter.published_P[2, 2]))) < 0.6
