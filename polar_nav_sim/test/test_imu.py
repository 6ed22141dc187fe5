"""IMU errors, term by term, against their stated statistics."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from polar_nav_core.attitude import exp
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.imu import DPH, MICRO_G, ImuErrors, ImuSensor
from polar_nav_sim.sensors.noise import CHUNK, GaussMarkov

NONE = ImuErrors(
    gyro_bias_dph=(0.0,) * 3,
    gyro_noise_density=(0.0,) * 3,
    accel_bias_ug=(0.0,) * 3,
    accel_noise_density=(0.0,) * 3,
)
DT = 0.01
OMEGA, FORCE = np.array([0.1, -0.2, 0.05]), np.array([0.3, -0.1, 9.83])


def measure(errors, n, name='imu', omega=OMEGA, force=FORCE):
    sensor = ImuSensor(errors, DT, stream(1, name))
    return sensor.measure(1, np.tile(omega * DT, (n, 1)), np.tile(force * DT, (n, 1)))


def with_errors(**changes):
    return dataclasses.replace(NONE, **changes)


def test_without_errors_it_gives_the_means():
    gyro, accel = measure(NONE, 3)
    assert_allclose(gyro, np.tile(OMEGA, (3, 1)), rtol=1e-15)
    assert_allclose(accel, np.tile(FORCE, (3, 1)), rtol=1e-15)


def test_defaults_are_the_papers():
    gyro, accel = measure(ImuErrors(), 200_000)
    # 0.03 deg/h and 1e-6 g0; 0.001 deg/h and 1e-7 g0 over 0.1 s, so sqrt(10) of it over 0.01 s.
    assert_allclose(gyro.mean(axis=0) - OMEGA, 0.03 * DPH, rtol=0.01)
    assert_allclose(accel.mean(axis=0) - FORCE, MICRO_G, rtol=0.01)
    assert_allclose(gyro.std(axis=0), 0.001 * DPH * np.sqrt(10.0), rtol=0.01)
    tenths = accel.reshape(-1, 10, 3).mean(axis=1)
    assert_allclose(tenths.std(axis=0), 0.1 * MICRO_G, rtol=0.03)


def test_turn_on_bias_is_drawn_once_per_run():
    errors = with_errors(gyro_turn_on_sigma_dph=5.0, accel_turn_on_sigma_ug=300.0)
    drawn = np.array([[x[0] for x in measure(errors, 2, f'run{i}')] for i in range(400)])
    assert_allclose((drawn[:, 0] - OMEGA).std() / (5.0 * DPH), 1.0, atol=0.1)
    assert_allclose((drawn[:, 1] - FORCE).std() / (300.0 * MICRO_G), 1.0, atol=0.1)
    gyro, _ = measure(errors, 2)
    assert_array_equal(gyro[0], gyro[1])


def test_instability_is_gauss_markov():
    tau = 5.0
    errors = with_errors(gyro_instability_sigma_dph=2.0, gyro_instability_tau_s=tau)
    gyro, _ = measure(errors, 400_000)
    x = (gyro - OMEGA) / (2.0 * DPH)
    # 800 correlation times on 3 axes: the variance is known to about 4 %.
    assert_allclose(x.var(), 1.0, atol=0.15)
    for lag_s in (1.0, 5.0):
        lag = round(lag_s / DT)
        assert_allclose((x[lag:] * x[:-lag]).mean(), np.exp(-lag_s / tau), atol=0.1)


@pytest.mark.parametrize('columns', [1, 3])
def test_gauss_markov_has_the_bits_of_a_linear_filter(columns):
    rng = np.random.default_rng(columns)
    first = rng.standard_normal(columns)
    process = GaussMarkov(np.full(columns, 2.0), 60.0, 0.01, first)
    a, b, x = process._a, process._b, process._x[None, :]
    for _ in range(3):
        w = rng.standard_normal((CHUNK, columns))
        expected, x = lfilter([0.0, 1.0], [1.0, -a], b * w, axis=0, zi=x)
        assert_array_equal(process.advance(w), expected)


def test_a_sensor_does_not_load_what_takes_as_long_as_itself():
    program = """
import sys
import numpy as np
from polar_nav_sim.sensors.imu import ImuErrors, ImuSensor
ImuSensor(ImuErrors(), 0.01, np.random.default_rng(1)).measure(0, np.ones((1, 3)), np.ones((1, 3)))
sys.exit('scipy.signal' in sys.modules)
"""
    subprocess.run([sys.executable, '-c', program], check=True)


def test_random_walk_grows_with_the_root_of_time():
    density = 1e-6
    n = 2 * CHUNK
    ends = [measure(with_errors(accel_random_walk=density), n, f'w{i}')[1][-1] for i in range(300)]
    assert_allclose((np.array(ends) - FORCE).std(), density * np.sqrt((n + 1) * DT), rtol=0.1)


def test_scale_and_misalignment():
    scale, turn = (1e-3, -2e-3, 3e-3), (0.01, -0.02, 0.03)
    gyro, accel = measure(
        with_errors(gyro_scale=scale, accel_scale=scale, accel_misalignment=turn), 1
    )
    assert_allclose(gyro[0], (1.0 + np.array(scale)) * OMEGA, rtol=1e-14)
    assert_allclose(accel[0], (1.0 + np.array(scale)) * (exp(turn).T @ FORCE), rtol=1e-14)


def test_saturation():
    gyro, _ = measure(with_errors(gyro_range=0.15), 1)
    assert_array_equal(gyro[0], [0.1, -0.15, 0.05])


def test_quantization_counts_pulses_and_loses_none():
    quantum = 7e-4
    gyro, _ = measure(with_errors(gyro_quantum=quantum), 1000)
    counts = gyro * DT / quantum
    assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.ptp(counts[:, 0]) == pytest.approx(1.0)
    assert_allclose(gyro.sum(axis=0) * DT, OMEGA * 10.0, atol=quantum)


def test_same_bits_one_by_one_in_blocks_and_with_gaps():
    errors = with_errors(
        gyro_noise_density=(1e-4,) * 3,
        gyro_instability_sigma_dph=1.0,
        gyro_random_walk=1e-6,
        gyro_scale=(1e-3,) * 3,
        gyro_misalignment=(0.1, 0.2, 0.3),
    )
    rng = np.random.default_rng(3)
    angles, velocities = rng.standard_normal((2, 700, 3)) * 1e-3
    together = ImuSensor(errors, DT, stream(1, 'a')).measure(1, angles, velocities)[0]
    single = ImuSensor(errors, DT, stream(1, 'a'))
    for i in range(700):
        if i in (5, 300, 301):
            continue
        one = single.measure(1 + i, angles[i : i + 1], velocities[i : i + 1])[0]
        assert_array_equal(one[0], together[i])
    with pytest.raises(ValueError, match='sample 3 comes after sample 700'):
        single.measure(3, angles[:1], velocities[:1])


def test_switching_one_error_on_leaves_the_others_alone():
    quiet = measure(ImuErrors(), 600)[0]
    noisy = measure(dataclasses.replace(ImuErrors(), accel_instability_sigma_ug=50.0), 600)[0]
    assert_array_equal(quiet, noisy)
