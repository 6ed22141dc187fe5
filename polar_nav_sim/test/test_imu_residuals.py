"""Temperature, g, drawn scale and cross-axis terms, steps, vibration: each as stated."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sim_chances import inside

from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.imu import DPH, G0, MICRO_G, ImuErrors, ImuSensor

T = 0.5
ZERO = (0.0, 0.0, 0.0)
QUIET = ImuErrors(
    gyro_bias_dph=ZERO,
    accel_bias_ug=ZERO,
    gyro_noise_density=ZERO,
    accel_noise_density=ZERO,
)
RUNS = 300


def errors_of(errors, seed, n=1, omega=ZERO, f=ZERO, k0=0):
    """Measured minus true, one row per sample: gyros, then accelerometers."""
    sensor = ImuSensor(errors, T, stream(seed, 'follower/imu'))
    omega, f = np.tile(omega, (n, 1)), np.tile(f, (n, 1))
    measured = sensor.measure(k0, omega * T, f * T)
    return np.hstack([measured[0] - omega, measured[1] - f])


def runs(n=1, omega=ZERO, f=ZERO, k0=0, **changes):
    errors = dataclasses.replace(QUIET, **changes)
    return np.array([errors_of(errors, seed, n, omega, f, k0) for seed in range(RUNS)])


OPTIONS = {
    'gyro_scale_sigma': 1e-3,
    'accel_misalignment_sigma': 1e-3,
    'gyro_temperature_sigma_dph': 1.0,
    'gyro_g_sigma_dph': 1.0,
    'gyro_step_dph': (1.0, 0.0, 0.0),
    'bias_steps_per_hour': 600.0,
    'vibration_rms_g': 2.0,
}


def test_nothing_is_added_by_default_and_an_option_changes_no_other_number():
    plain = errors_of(ImuErrors(), 3, 600, (0.1, 0.2, 0.3), (1.0, 2.0, 9.8))
    steps = {'gyro_step_sigma_dph': 1.0, 'accel_vibration_sigma_ug': 10.0}
    options = {**OPTIONS, **steps}
    everything = ImuErrors(**options)
    added = errors_of(everything, 3, 600, (0.1, 0.2, 0.3), (1.0, 2.0, 9.8)) - plain
    assert np.abs(added).max() > 0.0
    alone = sum(
        errors_of(ImuErrors(**{**steps, name: value}), 3, 600, (0.1, 0.2, 0.3), (1.0, 2.0, 9.8))
        - plain
        for name, value in OPTIONS.items()
    )
    assert_allclose(added, alone, rtol=0, atol=1e-12)


def test_drawn_scale_and_cross_axis_terms():
    x = (
        runs(omega=(0.3, 0.0, 0.0), gyro_scale_sigma=1e-3, gyro_misalignment_sigma=2e-3)[:, 0, :3]
        / 0.3
    )
    assert inside(x, [1e-3, 2e-3, 2e-3])
    x = runs(f=(0.0, 0.0, G0), accel_scale_sigma=5e-4, accel_misalignment_sigma=1e-3)[:, 0, 3:]
    assert inside(x / G0, [1e-3, 1e-3, 5e-4])
    assert abs(np.corrcoef(x.T)[0, 1]) < 4.0 / np.sqrt(RUNS)


def test_bias_over_temperature_follows_the_history():
    changes = {
        'gyro_temperature_sigma_dph': 0.5,
        'accel_temperature_sigma_ug': 100.0,
        'temperature_start_c': 18.0,
        'temperature_end_c': -2.0,
        'temperature_tau_s': 200.0,
    }
    start, late = runs(**changes)[:, 0], runs(k0=int(200.0 / T), **changes)[:, 0]
    assert_array_equal(start, 0.0)
    fallen = 20.0 * (1.0 - np.exp(-1.0))
    assert inside(late / fallen, np.repeat([0.5 * DPH, 100.0 * MICRO_G], 3))


@pytest.mark.parametrize('axis', range(3))
def test_gyro_bias_per_g(axis):
    x = runs(f=G0 * np.eye(3)[axis], gyro_g_sigma_dph=1.0)[:, 0]
    assert inside(x[:, :3], DPH)
    assert_array_equal(x[:, 3:], 0.0)


def test_a_step_happens_when_it_is_stated():
    step = dataclasses.replace(
        QUIET, bias_step_s=300.0, gyro_step_dph=(0.0, 0.1, 0.0), accel_step_ug=(0.0, 0.0, 50.0)
    )
    x = errors_of(step, 1, 700)
    assert_array_equal(x[:600], 0.0)
    assert_allclose(x[600:] - [0, 0.1 * DPH, 0, 0, 0, 50 * MICRO_G], 0.0, atol=1e-18)


def test_random_steps_come_at_their_rate_and_size():
    x = runs(n=720, bias_steps_per_hour=40.0, gyro_step_sigma_dph=2.0)
    moved = np.diff(x[:, :, 0], axis=1)
    count = np.count_nonzero(moved)
    expected = RUNS * 719 * T * 40.0 / 3600.0
    assert abs(count - expected) < 4.0 * np.sqrt(expected)
    assert inside(moved[moved != 0.0][:, None], 2.0 * DPH)
    assert_array_equal(x[:, :, 3:], 0.0)


def test_vibration_is_rectified_once_it_begins():
    x = runs(
        n=3,
        vibration_rms_g=2.0,
        vibration_from_s=T,
        gyro_vibration_sigma_dph=0.1,
        accel_vibration_sigma_ug=5.0,
    )
    assert_array_equal(x[:, 0], 0.0)
    assert inside(x[:, 1], np.repeat([0.4 * DPH, 20.0 * MICRO_G], 3))


def test_blocks_and_single_samples_give_the_same():
    errors = ImuErrors(
        bias_steps_per_hour=3600.0, gyro_step_sigma_dph=1.0, gyro_temperature_sigma_dph=1.0
    )
    whole = errors_of(errors, 2, 600)
    sensor = ImuSensor(errors, T, stream(2, 'follower/imu'))
    for k in (0, 1, 255, 256, 257, 599):
        assert_array_equal(
            sensor.measure(k, np.zeros((1, 3)), np.zeros((1, 3)))[0][0], whole[k, :3]
        )
