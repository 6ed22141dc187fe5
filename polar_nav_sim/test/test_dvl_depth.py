"""DVL and depth sensor: geometry and every error term."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.depth import depth_from_pressure, pressure_from_depth
from polar_nav_sim.randomness import stream
from polar_nav_sim.schedule import Schedule
from polar_nav_sim.sensors.depth import DepthErrors, DepthSensor
from polar_nav_sim.sensors.dvl import DvlErrors, DvlSensor
from polar_nav_sim.sensors.reference import ReferenceErrors, ReferenceSystem

NONE = DvlErrors(scale=(0.0,) * 3, markov_sigma=0.0, noise_sigma=0.0)
V, OMEGA = np.array([3.0, 0.2, -0.1]), np.array([0.01, 0.02, 0.3])


def pings(errors, n, **kwargs):
    sensor = DvlSensor(errors, 0.2, stream(1, 'dvl'))
    return [sensor.measure(k, V, OMEGA, **kwargs) for k in range(n)]


def test_dvl_sees_its_own_velocity_in_its_own_axes():
    errors = dataclasses.replace(NONE, lever_b=(1.0, -0.5, 0.2), rpy_deg=(10.0, -20.0, 135.0))
    (ping,) = pings(errors, 1)
    C_m_b = matrix_from_euler(*np.radians([135.0, -20.0, 10.0]))
    assert_allclose(C_m_b @ ping.velocity_m, V + np.cross(OMEGA, [1.0, -0.5, 0.2]), rtol=1e-14)


def test_dvl_scale_and_bias():
    errors = dataclasses.replace(NONE, scale=(1e-3, 2e-3, 0.0), bias=(0.0, 0.0, 0.1))
    (ping,) = pings(errors, 1)
    assert_allclose(ping.velocity_m, V * [1.001, 1.002, 1.0] + [0.0, 0.0, 0.1], rtol=1e-14)


def test_dvl_white_noise_and_its_variance():
    errors = dataclasses.replace(NONE, noise_sigma=0.01)
    all_pings = pings(errors, 4000)
    assert_allclose(np.std([p.velocity_m for p in all_pings], axis=0), 0.01, rtol=0.05)
    assert_allclose(all_pings[0].covariance_m, 1e-4 * np.eye(3))


def test_dvl_markov_error_has_its_sigma_and_correlation():
    errors = dataclasses.replace(NONE, markov_sigma=0.005, markov_tau_s=2.0)
    x = (np.array([p.velocity_m for p in pings(errors, 20_000)]) - V) / 0.005
    assert_allclose(x.var(), 1.0, atol=0.12)
    assert_allclose((x[10:] * x[:-10]).mean(), math.exp(-1.0), atol=0.1)


def test_dvl_loses_beams():
    errors = dataclasses.replace(NONE, beam_loss_probability=0.3)
    all_pings = pings(errors, 4000)
    valid = 0.7**4 + 4 * 0.3 * 0.7**3
    assert_allclose(np.mean([p.valid for p in all_pings]), valid, atol=0.03)
    for p in all_pings:
        assert p.valid == (p.beams >= 3) == bool(np.isfinite(p.velocity_m).all())


@pytest.mark.parametrize(
    ('altitude', 'valid'), [(math.nan, True), (100.0, True), (201.0, False), (0.1, False)]
)
def test_dvl_bottom_lock_depends_on_altitude(altitude, valid):
    (ping,) = pings(NONE, 1, altitude=altitude)
    assert ping.valid == valid
    if not valid:
        assert math.isnan(ping.altitude)
        assert ping.beams == 0


def test_dvl_noise_of_a_ping_does_not_depend_on_the_others():
    errors = DvlErrors()
    whole = pings(errors, 600)
    sensor = DvlSensor(errors, 0.2, stream(1, 'dvl'))
    for k in (3, 299, 599):
        assert_allclose(sensor.measure(k, V, OMEGA).velocity_m, whole[k].velocity_m, rtol=0)


def test_depth_noise_bias_quantum_and_lever():
    errors = DepthErrors(bias_m=0.5, noise_sigma_m=0.05)
    sensor = DepthSensor(errors, stream(1, 'depth'))
    x = np.array([sensor.measure(k, 100.0, np.eye(3)) for k in range(4000)])
    assert_allclose([x.mean(), x.std()], [100.5, 0.05], atol=0.003)
    exact = DepthErrors(noise_sigma_m=0.0, quantum_m=0.25, lever_b=(2.0, 0.0, 0.5))
    down = matrix_from_euler(0.3, np.radians(30.0), 0.0)  # nose down: the sensor is deeper
    measured = DepthSensor(exact, stream(1, 'depth')).measure(0, 100.0, down)
    assert measured == 0.25 * round((100.0 + 1.0 - 0.5 * math.cos(math.radians(30.0))) / 0.25)
    assert DepthSensor(exact, stream(1, 'd')).variance == pytest.approx(0.25**2 / 12.0)


def test_pressure_is_the_inverse_of_depth():
    for lat in (-90.0, 45.0, 90.0):
        pressure = pressure_from_depth(100.0, math.radians(lat))
        assert_allclose(depth_from_pressure(pressure, math.radians(lat)), 100.0, atol=1e-8)


def test_reference_is_perfect_by_default_and_as_bad_as_stated():
    perfect = ReferenceSystem(ReferenceErrors(), 0.1, stream(1, 'r')).error(0)
    assert not np.any([perfect.dr_G, perfect.dv_G, perfect.phi_G])
    stated = ReferenceErrors(2.0, 0.01, 0.02, 0.1, error_tau_s=1.0)
    system = ReferenceSystem(stated, 0.1, stream(1, 'r'))
    errors = [system.error(k) for k in range(20_000)]
    x = np.array([np.concatenate([e.dr_G, e.dv_G, e.phi_G]) for e in errors])
    assert_allclose(x.std(axis=0), system.sigma, rtol=0.1)
    assert_allclose(system.sigma[[0, 3, 6, 8]], [2.0, 0.01, math.radians(0.02), math.radians(0.1)])


def test_schedule_follows_sample_numbers():
    schedule = Schedule(5.0)
    due = [schedule.due(k * 10_000_000) for k in range(50)]
    assert [k for k, n in enumerate(due) if n is not None] == [0, 20, 40]
    late = Schedule(30.0)  # 33.3 ms at samples every 10 ms: the first sample at or after
    times = [k for k in range(20) if late.due(k * 10_000_000) is not None]
    assert times == [0, 4, 7, 10, 14, 17]


def test_drawn_scale_error_has_its_sigma_and_changes_no_other_draw():
    v = np.array([3.0, -2.0, 1.0])

    def first(seed, **errors):
        sensor = DvlSensor(DvlErrors(scale=(0.0,) * 3, **errors), 0.2, np.random.default_rng(seed))
        return sensor.measure(0, v, np.zeros(3)).velocity_m

    ratios = np.array([(first(k, scale_sigma=1e-2) - first(k)) / v for k in range(400)])
    assert np.abs(ratios.std(axis=0) / 1e-2 - 1.0).max() < 0.15
    assert np.abs(ratios.mean(axis=0)).max() < 4.0 * 1e-2 / np.sqrt(400)
