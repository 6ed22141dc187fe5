"""An IMU far noisier than stated, a good DVL, few fixes or none: no estimate runs away."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import LOST, RUNAWAY, Level
from polar_nav_core.engine.health.runaway import Runaway, divergence_of
from polar_nav_core.engine.params import EngineParams

EVERY = 10
"""Of the world's IMU samples of 100 Hz one mean is left: 10 Hz."""
MEMS = {
    'configuration': 'default',
    'max_imu_noise_factor': 1000.0,
    'gyro_noise_density': 2.4e-4,
    'accel_noise_density': 1.7e-3,
    'gyro_bias_sigma': 5e-4,
    'accel_bias_sigma': 0.02,
    'dvl_scale_sigma': 0.01,
    'initial_sigma_heading_deg': 90.0,
    'initial_sigma_tilt_deg': 2.0,
    'initial_sigma_velocity': 0.2,
}


@pytest.fixture(scope='module')
def world():
    return World(120.0, v_G=(0.4, 0.3, 0.0))


def noisy(world, times, seed, fixes=()):
    """Inputs with so many times the stated noise of the IMU, and its biases."""
    rng = np.random.default_rng(seed)
    inputs = inputs_of(world, fixes, seed)
    n = len(inputs.imu_stamps_ns) // EVERY
    omega, f = (
        x[: n * EVERY].reshape(n, EVERY, 3).mean(axis=1) for x in (inputs.omega_ib_b, inputs.f_b)
    )
    root = times * np.sqrt(100.0 / EVERY)
    omega += rng.normal(0.0, root * MEMS['gyro_noise_density'], omega.shape)
    f += rng.normal(0.0, root * MEMS['accel_noise_density'], f.shape)
    omega += rng.normal(0.0, MEMS['gyro_bias_sigma'], 3)
    f += rng.normal(0.0, MEMS['accel_bias_sigma'], 3)
    stamps = inputs.imu_stamps_ns[EVERY - 1 :: EVERY][:n]
    return replace(inputs, imu_stamps_ns=stamps, omega_ib_b=omega, f_b=f)


def run(world, inputs, **changes):
    params = world.params(**{**MEMS, **changes})
    return engine_run.run(params, inputs, look_every_s=1.0)


def errors(world, track):
    """Errors of speed [m/s] and horizontal distance to the truth [m], and claimed sigma [m]."""
    rows = (track.stamps_ns - world.stamps[0]) // 10_000_000
    off = np.linalg.norm(track.r_e - np.array(world.r_e)[rows], axis=1)
    speed = np.abs(np.linalg.norm(track.v_G, axis=1) - 0.5)
    return speed, off, np.sqrt(np.trace(track.P[:, 6:9, 6:9], axis1=1, axis2=2))


def refused_share(track):
    used, refused, _ = track.local_statistics[:, 0].sum(axis=0)
    return refused / (used + refused)


@pytest.mark.parametrize('times', [10.0, 100.0])
def test_an_imu_far_noisier_than_stated_does_not_run_away(world, times):
    several = [noisy(world, times, seed) for seed in range(1, 7)]
    shut = [run(world, inputs, max_imu_noise_factor=1.0) for inputs in several]
    ready = [run(world, inputs) for inputs in several]
    # How one of them runs away depends on the last digit, and so on the processor.
    shares = [np.mean([refused_share(r.track) for r in runs]) for runs in (shut, ready)]
    assert shares[0] > 2.0 * shares[1]
    assert np.mean([errors(world, r.track)[0].max() for r in shut]) > 0.1 * times
    inputs, found = several[0], ready[0]
    # The same with a heading that pings seem to show: most of them are refused.
    known = run(world, inputs, max_imu_noise_factor=1.0, dvl_turn_velocity='known')
    assert refused_share(known.track) > 0.5
    assert refused_share(found.track) < 0.25
    speed, *_ = errors(world, found.track)
    assert speed.max() < 0.1 * times
    assert speed[-100:].max() < 0.01 * times
    factors = [
        float(p.condition.sentence.split()[4])
        for p in found.health[-1].present
        if p.condition.key == 'IMU noise'
    ]
    assert len(factors) == 1
    assert 0.7 * times < factors[0] < 1.3 * times
    assert found.health[-1].level is Level.ERROR


def test_noise_as_stated_changes_no_bit(world):
    inputs = noisy(world, 1.0, seed=2)
    never, ready = run(world, inputs, max_imu_noise_factor=1.0), run(world, inputs)
    np.testing.assert_array_equal(never.track.P, ready.track.P)
    assert ready.health[-1].resets == 0


def test_a_dvl_that_fixes_contradict_is_not_believed(world):
    inputs = noisy(world, 1.0, 1, world.fixes(1.0, lambda _: 0.5))
    late = inputs.dvl_stamps_ns > world.stamps[0] + 40 * 10**9
    v_m = inputs.dvl_v_m + late[:, None] * np.array([1.5, 0.0, 0.0])
    result = run(world, replace(inputs, dvl_v_m=v_m))
    assert refused_share(result.track) > 0.5
    assert result.health[-1].resets == 0
    assert not any(p.condition.key == 'IMU noise' for p in result.health[-1].present)


@pytest.mark.parametrize('delay_handling', ['clone', 'rewind'])
def test_whole_runs_raise_the_noise_as_nodes_do(world, delay_handling):
    inputs = noisy(world, 30.0, 3, world.fixes(30.0, lambda _: 4.0, first_s=15.0))
    custom = {'configuration': 'custom', 'gate_probability': 0.9999}
    params = world.params(**{**MEMS, **custom, 'delay_handling': delay_handling})
    whole, single = (
        engine_run.run(params, inputs, one_by_one=k, look_every_s=1.0) for k in (False, True)
    )
    assert whole.health[-1].resets > 0
    np.testing.assert_array_equal(whole.track.P, single.track.P)
    np.testing.assert_array_equal(whole.track.r_e, single.track.r_e)
    assert whole.health == single.health


def longest_s(wrong):
    """Length of the longest stretch of looks, a second apart, that are so."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], wrong.astype(int), [0]))))
    return int(np.diff(edges)[::2].max(initial=0)) - 1


def test_a_velocity_that_cannot_be_is_a_divergence_after_half_a_minute(world):
    """With a gate that never opens again the velocity is lost."""
    stretches = []
    for seed in range(1, 5):
        kept_away = {'reopen_after_s': 0.0, 'dvl_turn_velocity': 'known'}
        shut = run(world, noisy(world, 100.0, seed=seed), **kept_away)
        speed = np.linalg.norm(shut.track.v_G, axis=1)[::10]
        stretches.append(longest_s(speed > EngineParams().max_speed))
        assert stretches[-1] < 32 or 'run away' in divergence_of(shut.health)
    assert max(stretches) > 32
    found = run(world, noisy(world, 100.0, seed=2))
    assert divergence_of(found.health) == ''
    runaway = Runaway()
    looks = [runaway.look(k * 10**9, k >= 10, 0.0, 0.0) for k in range(60)]
    assert [bool(found) for found in looks] == [k >= 40 for k in range(60)]
    assert RUNAWAY in LOST
