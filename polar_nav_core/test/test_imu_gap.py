"""A gap between IMU samples is bridged: small errors, honest sigmas, late fixes across it."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of
from test_batch import both

from polar_nav_core import attitude, earth
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.health.view import Envelope, Gaps, View
from polar_nav_core.engine.health.watchdog import DEPTH, DVL, Watchdog
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels import watch

pytestmark = pytest.mark.slow

SECONDS = 90.0


@pytest.fixture(scope='module')
def world():
    return World(SECONDS)


def without_imu(inputs, first, last):
    """Inputs without the IMU samples of an interval of numbers."""
    kept = np.ones(len(inputs.imu_stamps_ns), dtype=bool)
    kept[first:last] = False
    return replace(
        inputs,
        imu_stamps_ns=inputs.imu_stamps_ns[kept],
        omega_ib_b=inputs.omega_ib_b[kept],
        f_b=inputs.f_b[kept],
    )


def errors_and_sigmas(world, track):
    """Horizontal errors and sigmas of position [m] of a track, by rows."""
    k = (track.stamps_ns - world.stamps[0]) // (world.stamps[1] - world.stamps[0])
    r_e = np.array(world.r_e)[k]
    up = earth.up(track.r_e)
    off = track.r_e - r_e
    off -= np.einsum('ni,ni->n', off, up)[:, None] * up
    P = track.P[:, 6:9, 6:9]
    horizontal = np.trace(P, axis1=1, axis2=2) - np.einsum('ni,nij,nj->n', up, P, up)
    return np.linalg.norm(off, axis=1), np.sqrt(horizontal)


@pytest.mark.parametrize('gap_s', [0.3, 1.0, 3.0])
@pytest.mark.parametrize('name', ['default', 'modified_akf', 'conventional_akf'])
def test_a_minute_after_a_gap_the_error_is_that_without_it(world, name, gap_s):
    rng = np.random.default_rng(3)
    inputs = inputs_of(world, world.fixes(2.0, 1.0, rng=rng))
    params = world.params(configuration=name)
    sound = engine_run.run(params, inputs)
    broken = engine_run.run(params, without_imu(inputs, 1500, 1500 + round(100 * gap_s)))
    (error, sigma), (error_0, sigma_0) = (
        errors_and_sigmas(world, r.track) for r in (broken, sound)
    )
    assert not broken.divergence
    assert error[-1] < 3.0 * error_0[-1] + 1.0
    assert sigma[-1] < 3.0 * sigma_0[-1]
    if name != 'conventional_akf':  # which is off by speed times delay anyway
        assert (error < 5.0 * sigma).all()


@pytest.mark.parametrize('tilt', [0.05, 0.1])
def test_a_tilt_that_is_lost_without_a_dvl_is_found_again_with_an_honest_sigma(world, tilt):
    """Depth says little of a tilt: what it takes from gravity along up is of second order.

    At the word of the transition it said all, and wrongly: mean squares of 10 to 250.
    """
    squares = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        inputs = inputs_of(world, world.fixes(2.0, 3.0, rng=rng))
        inputs = replace(inputs, dvl_valid=np.zeros_like(inputs.dvl_valid))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        turned = tilt * np.array([np.cos(angle), np.sin(angle), 0.0])
        yaw, pitch, roll = attitude.euler_from_matrix(attitude.exp(turned) @ world.C_b_G[1])
        params = world.params(
            configuration='custom',
            delay_handling='clone',
            gate_probability=1.0,
            initial_roll_deg=float(np.degrees(roll)),
            initial_pitch_deg=float(np.degrees(pitch)),
            initial_grid_heading_deg=float(90.0 - np.degrees(yaw)),
            initial_sigma_tilt_deg=float(np.degrees(tilt)),
        )
        track = engine_run.run(params, inputs).track
        rows = (track.stamps_ns > world.stamps[1000]) & (track.stamps_ns < world.stamps[3000])
        at = np.searchsorted(world.stamps, track.stamps_ns[rows])
        off = track.v_G[rows] - np.array(world.v_G)[at]
        variance = np.diagonal(track.P[rows, 3:6, 3:6], axis1=1, axis2=2)
        squares.append(np.mean(off**2 / variance, axis=0))
    assert (np.mean(squares, axis=0) < 2.0).all(), squares


@pytest.fixture(scope='module', params=[0.0, 25.0], ids=['straight', 'racetrack'])
def long_world(request):
    return World(165.0, leg_s=request.param)


REWIND = {'configuration': 'custom', 'delay_handling': 'rewind', 'gate_probability': 0.9999}


@pytest.mark.parametrize('gap_s', [0.05, 3.0, 10.0, 30.0, 60.0])
@pytest.mark.parametrize(
    'chosen',
    [{'configuration': 'default'}, {'configuration': 'modified_akf'}, REWIND],
    ids=['default', 'modified_akf', 'rewind'],
)
def test_a_minute_after_a_long_gap_no_fix_is_refused(long_world, chosen, gap_s):
    """Half a radian of heading is lost, and found again by a filter that is linear."""
    world, name = long_world, chosen['configuration']
    if (name, gap_s) == ('modified_akf', 60.0) and np.ptp(world.v_G, axis=0)[0] > 1.0:
        pytest.xfail('two half turns in the gap: 4.5 m instead of 1.4 m, nothing is gated')
    inputs = inputs_of(world, world.fixes(2.0, 1.0, rng=np.random.default_rng(3)))
    params = world.params(**chosen)
    sound = engine_run.run(params, inputs)
    broken = engine_run.run(params, without_imu(inputs, 3000, 3000 + round(100 * gap_s)))
    (error, sigma), (error_0, sigma_0) = (
        errors_and_sigmas(world, r.track) for r in (broken, sound)
    )
    assert not broken.divergence
    since_s = (broken.track.stamps_ns - world.stamps[3000]) * 1e-9 - gap_s
    k, k_0 = int(np.argmax(since_s > 60.0)), len(error_0) - len(error)
    assert error[k:].max() < 3.0 * error_0[k_0 + k :].max() + 1.0
    assert sigma[k] < 3.0 * sigma_0[k_0 + k]
    assert (error < 5.0 * sigma).all()
    assert all(r.verdict.name != 'GATED' for r in broken.receipts)


@pytest.mark.parametrize('instant', ['mean', 'instant'])
@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_same_bits_across_gaps_and_late_fixes_within(world, name, instant):
    rng = np.random.default_rng(5)
    fixes = world.fixes(0.37, lambda _: rng.uniform(0.0, 6.0), rng=rng)
    inputs = without_imu(inputs_of(world, fixes), 1500, 1620)
    inputs = without_imu(inputs, 2500, 2530)
    cut = int(inputs.imu_stamps_ns[4000])
    inputs = replace(
        inputs,
        imu_stamps_ns=inputs.imu_stamps_ns[:4000],
        omega_ib_b=inputs.omega_ib_b[:4000],
        f_b=inputs.f_b[:4000],
        fixes=tuple(f for f in inputs.fixes if f.receive_ns < cut),
    )
    chosen = {'configuration': 'custom', 'delay_handling': name, 'imu_sample': instant}
    result = both(world.params(**chosen, gate_probability=0.999), inputs)
    verdicts = [r.verdict.name for r in result.receipts]
    least = 0.2 if name == 'ignore' else 0.6  # off by speed times delay
    assert verdicts.count('FUSED') > least * len(verdicts)


def test_rewind_across_a_gap_gives_the_bits_of_fixes_in_order(world):
    rng = np.random.default_rng(7)
    fixes = world.fixes(0.37, lambda _: rng.uniform(0.0, 6.0), rng=rng)
    last_ns = int(world.stamps[4000])
    fixes = [f for f in fixes if f.receive_ns < last_ns]
    prompt = [replace(f, receive_ns=f.validity_ns) for f in fixes]
    params = world.params(configuration='custom', delay_handling='rewind')
    ends = []
    for some in (fixes, prompt):
        inputs = without_imu(inputs_of(world, some), 1500, 1750)
        ends.append(engine_run.run(params, inputs).track)
    assert np.array_equal(ends[0].r_e[-1], ends[1].r_e[-1])
    assert np.array_equal(ends[0].P[-1], ends[1].P[-1])


def test_a_slow_imu_has_no_gaps(world):
    """Every thirtieth sample: 0.3 s apart, longer than imu_gap_s, as it always is."""
    inputs = inputs_of(world, world.fixes(2.0, 1.0))
    k = np.arange(29, len(inputs.imu_stamps_ns), 30)
    slow = replace(
        inputs,
        imu_stamps_ns=inputs.imu_stamps_ns[k],
        omega_ib_b=inputs.omega_ib_b[k],
        f_b=inputs.f_b[k],
    )
    bridged, held = (
        engine_run.run(world.params(imu_gap_s=gap_s), slow).track.r_e[-1] for gap_s in (0.1, 60.0)
    )
    assert np.array_equal(bridged, held)


def view(**changes):
    values = {
        'stamp_ns': 10**12,
        'memories': np.zeros((watch.STREAMS, watch.MEMORIES, watch.WIDTH)),
        'opened_ns': np.zeros(3, dtype=np.int64),
        'used_ns': np.zeros(3, dtype=np.int64),
        'speed': 1.0,
        'depth': 10.0,
        'P_horizontal': np.eye(2),
        'resets': 0,
    }
    return View(**{**values, **changes})


@pytest.mark.parametrize(('length_s', 'level'), [(0.4, Level.WARN), (3.0, Level.ERROR)])
def test_a_gap_is_a_condition_for_a_minute(length_s, level):
    envelope = Envelope(20.0, 1000.0, max_imu_gap_s=0.5)
    health = Watchdog(envelope).look(view(gaps=Gaps(2, length_s, 10**12 - 20 * 10**9)), [])
    (found,) = health.present
    assert found.condition.level is level
    assert f'IMU gap of {length_s:.1f} s ended 20 s ago' in found.condition.sentence
    assert '2 so far' in found.condition.sentence
    later = Watchdog(envelope).look(view(gaps=Gaps(2, length_s, 10**12 - 61 * 10**9)), [])
    assert not later.present


def test_a_sensor_that_was_used_and_is_silent_is_a_warning():
    envelope = Envelope(20.0, 1000.0, silent_after_s=30.0)
    used = np.zeros(3, dtype=np.int64)
    assert not Watchdog(envelope).look(view(used_ns=used), []).present
    used[DVL], used[DEPTH] = 10**12 - 40 * 10**9, 10**12 - 29 * 10**9
    (found,) = Watchdog(envelope).look(view(used_ns=used), []).present
    assert (found.condition.level, found.condition.sentence) == (
        Level.WARN,
        'no DVL used for 40 s',
    )


@pytest.mark.parametrize('name', ['omega_ib_b', 'f_b'])
def test_an_instrument_that_hangs_is_a_gap_of_the_imu(world, name):
    """As if the IMU had given nothing from the sixth repeat on, in both drivers."""
    rng = np.random.default_rng(3)
    inputs = inputs_of(world, world.fixes(2.0, 1.0, rng=rng))
    values = getattr(inputs, name) + 1e-6 * rng.standard_normal((len(inputs.imu_stamps_ns), 3))
    values[1500:1800] = values[1499]
    stuck = replace(inputs, **{name: values})
    params = world.params(configuration='default')
    found = both(params, stuck)
    without = engine_run.run(params, without_imu(stuck, 1505, 1800))
    assert np.array_equal(found.track.r_e[-1], without.track.r_e[-1])
    assert np.array_equal(found.track.P[-1], without.track.P[-1])
    assert found.verdicts[Verdict.IMPLAUSIBLE] == 295
    error, sigma = errors_and_sigmas(world, found.track)
    assert (error < 5.0 * sigma).all()
