"""A navigation without a DVL that cannot be right begins anew at its fixes."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.health.conditions import Level

pytestmark = pytest.mark.slow

CONFIGURATION = {'configuration': 'default', 'initial_sigma_position': 5.0}
SENTENCE = 'no correction led the estimate back to them: it began anew'


@pytest.fixture(scope='module')
def world():
    return World(150.0)


def inputs_with(world, seed=3, delay_s=0.5, pings=False):
    """Fixes each 2 s, and by default no ping."""
    rng = np.random.default_rng(seed)
    found = inputs_of(world, world.fixes(2.0, lambda _: delay_s, rng=rng, first_s=1.0))
    return found if pings else replace(found, dvl_valid=np.zeros_like(found.dvl_valid))


def turning(inputs, deg, axis, length_s, start_s=40.0):
    """Gyros that measure a turn about an axis of the body which never was."""
    since_s = (inputs.imu_stamps_ns - inputs.imu_stamps_ns[0]) * 1e-9 - start_s
    hit = (since_s >= 0.0) & (since_s < length_s)
    rate = np.zeros((len(hit), 3))
    rate[:, axis] = np.radians(deg) / length_s * hit
    return replace(inputs, omega_ib_b=inputs.omega_ib_b + rate)


def run(world, inputs, **changes):
    params = world.params(**{**CONFIGURATION, **changes})
    return engine_run.run(params, inputs, look_every_s=1.0)


def errors(result, world, since_s):
    """Errors of horizontal position [m] and of velocity [m/s], with their sigmas, by rows."""
    track = result.track
    rows = track.stamps_ns >= track.stamps_ns[0] + since_s * 1e9
    at = np.searchsorted(world.stamps, track.stamps_ns[rows])
    C_e_G = world_axes(world)
    r_G = (track.r_e[rows] - world.r_e_array[at]) @ C_e_G.T
    v_G = track.v_G[rows] - world.v_G_array[at]
    P = track.P[rows]
    P_r = np.einsum('ij,njk,lk->nil', C_e_G, P[:, 6:9, 6:9], C_e_G)
    s_r = np.sqrt(np.einsum('nii->ni', P_r))
    s_v = np.sqrt(np.einsum('nii->ni', P[:, 3:6, 3:6]))
    return r_G[:, :2], s_r[:, :2], v_G[:, :2], s_v[:, :2]


def world_axes(world):
    world.r_e_array, world.v_G_array = np.array(world.r_e), np.array(world.v_G)
    return grid.ecef_to_grid(world.r_e_array[-1])


def sentences(result):
    return [
        p.condition for h in result.health for p in h.present if SENTENCE in p.condition.sentence
    ]


@pytest.mark.parametrize(
    ('deg', 'length_s', 'delay_s', 'most_m'),
    [
        (57.0, 1.0, 0.5, 60.0),
        (170.0, 1.0, 0.5, 60.0),
        (-60.0, 110.0, 0.5, 60.0),
        (57.0, 1.0, 6.0, 400.0),
        (170.0, 1.0, 6.0, 400.0),
        (-60.0, 110.0, 6.0, 400.0),
        (200.0, 60.0, 0.5, 400.0),  # 12,000 deg/h: more than a bias is taken to be
    ],
)
def test_it_stays_beside_its_fixes(world, deg, length_s, delay_s, most_m):
    """Before, it was thousands of kilometres away soon, for no linear correction leads back.

    Where fixes are 6 s late the attitude is learnt by those that are valid after the new beginning
    only, and the error of a row of refused ones grows meanwhile.
    """
    result = run(world, turning(inputs_with(world, delay_s=delay_s), deg, 1, length_s))
    r, s_r, v, s_v = errors(result, world, 42.0)
    assert np.hypot(*r.T).max() < 800.0
    found = sentences(result)
    assert found
    assert {c.level for c in found} == {Level.ERROR}
    assert result.health[-1].resets >= 1
    # In the last 20 s the next fixes have found the attitude, or it has begun anew once more.
    assert np.hypot(*r[-200:].T).max() < most_m
    if most_m < 100.0:
        for error, sigma in ((r[-200:], s_r[-200:]), (v[-200:], s_v[-200:])):
            assert np.mean(np.square(error / sigma)) < 4.0


def pushed(inputs, force, start_s=40.0):
    """Inputs whose first accelerometer is off by a constant from a time on [m/s^2]."""
    since_s = (inputs.imu_stamps_ns - inputs.imu_stamps_ns[0]) * 1e-9
    f_b = inputs.f_b.copy()
    f_b[since_s >= start_s, 0] += force
    return replace(inputs, f_b=f_b)


@pytest.mark.parametrize('force', [0.1, 0.2])
@pytest.mark.parametrize('seed', [3, 4])
def test_an_accelerometer_that_has_jumped_leads_nowhere(world, seed, force):
    """Before, it was 150 to 320 m off until it was faster than a vehicle, or ten were refused."""
    result = run(world, pushed(inputs_with(world, seed, delay_s=2.0), force))
    r, s_r, _, _ = errors(result, world, 42.0)
    assert np.hypot(*r.T).max() < 75.0
    assert sentences(result)
    assert np.mean(np.square(r[-200:] / s_r[-200:])) < 4.0


@pytest.mark.parametrize('axis', [0, 1])
def test_it_begins_anew_before_it_is_faster_than_a_vehicle(world, axis):
    """A turn of 3 deg that never was: before, it was 240 m off, 100 times what it claimed."""
    result = run(world, turning(inputs_with(world, delay_s=2.0), 3.0, axis, 1.0))
    r, s_r, _, _ = errors(result, world, 42.0)
    assert np.hypot(*r.T).max() < 120.0
    assert (np.hypot(*r.T) / np.hypot(*s_r.T)).max() < 50.0


def test_its_heading_is_an_error_until_pings_have_shown_it(world):
    faulty = turning(inputs_with(world, pings=True), 57.0, 1, 1.0)
    since_s = (faulty.dvl_stamps_ns - faulty.imu_stamps_ns[0]) * 1e-9
    names = []
    for from_s in (100.0, np.inf):
        result = run(world, replace(faulty, dvl_valid=faulty.dvl_valid & (since_s > from_s)))
        names.append([{p.condition.key for p in h.present} for h in result.health])
    again, never = ([('heading unknown' in row) for row in rows] for rows in names)
    assert not any(again[:40])
    assert all(again[60:100])
    assert not any(again[-10:])
    assert all(never[60:])


def test_a_past_that_was_replaced_is_not_one_that_sensors_outran(world):
    engine = Engine(world.params(**CONFIGURATION))
    for event in turning(inputs_with(world), 57.0, 1, 1.0).events():
        list(engine.process(event))
        if engine.resets:
            break
    assert engine.fusion.oldest_ns() == engine.fusion.replaced_ns == engine.fusion.stamp_ns
    assert engine.history_warning == ''


def test_a_smoother_is_told_that_nothing_before_bears_on_what_follows(world):
    faulty = turning(inputs_with(world), 57.0, 1, 1.0)
    found = smoothing.smooth(world.params(**CONFIGURATION), faulty)
    assert found.passes == 1
    assert found.unsettled.startswith('the filter enlarged its covariance')


def test_nothing_begins_anew_beside_a_dvl(world):
    result = run(world, turning(inputs_with(world, pings=True), 57.0, 1, 1.0))
    assert not sentences(result)


def test_it_begins_anew_by_what_it_runs_away_from_whatever_speed_is_possible(world):
    result = run(world, turning(inputs_with(world), 57.0, 1, 1.0), max_speed=10_000.0)
    assert sentences(result)
    assert np.hypot(*errors(result, world, 130.0)[0].T).max() < 60.0


def test_nothing_begins_anew_where_nobody_may_or_need(world):
    faulty = turning(inputs_with(world), 57.0, 1, 1.0)
    assert not sentences(run(world, faulty, reopen_after_s=0.0))
    assert not sentences(run(world, inputs_with(world)))


def test_whole_runs_begin_anew_as_nodes_do(world):
    params = world.params(**CONFIGURATION)
    faulty = turning(inputs_with(world, delay_s=6.0), 57.0, 0, 1.0)
    whole, single = (
        engine_run.run(params, faulty, one_by_one=k, look_every_s=1.0) for k in (False, True)
    )
    np.testing.assert_array_equal(whole.track.P, single.track.P)
    np.testing.assert_array_equal(whole.track.r_e, single.track.r_e)
    assert whole.health == single.health
    assert sentences(whole)
