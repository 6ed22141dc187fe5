"""Errors that many measurements share: air, drift, sticking, leader, array, station, clock."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sim_chances import inside
from sim_station import FRAME, START_NS, Straight

from polar_nav_sim.mission import load_mission
from polar_nav_sim.poses import TrajectoryPoses
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.clock import ClockErrors
from polar_nav_sim.sensors.depth import M_PER_HPA, DepthErrors, DepthSensor
from polar_nav_sim.sensors.reference import ReferenceErrors, ReferenceSystem
from polar_nav_sim.sensors.station import Station, StationErrors
from polar_nav_sim.sensors.usbl import Usbl, UsblErrors
from polar_nav_sim.sound_speed import SoundSpeed

RUNS = 300
WATER = SoundSpeed.constant(1440.0)
QUIET = DepthErrors(noise_sigma_m=0.0)


def depths(seed, n, period_s=0.5, **changes):
    sensor = DepthSensor(dataclasses.replace(QUIET, **changes), stream(seed, 'depth'), period_s)
    return np.array([sensor.measure(k, 100.0 + 0.01 * k, np.eye(3)) for k in range(n)])


def test_air_pressure_is_drawn_per_run():
    x = np.array([depths(k, 2, air_pressure_sigma_hpa=15.0) for k in range(RUNS)])
    assert inside(x[:, :1] - 100.0, 15.0 * M_PER_HPA)
    assert_allclose(x[:, 1] - x[:, 0], 0.01, atol=1e-12)
    assert pytest.approx(0.3, rel=0.02) == 30.0 * M_PER_HPA


def test_drift_has_its_sigma_and_correlation():
    change = {'drift_sigma_m': 0.2, 'drift_tau_s': 100.0}
    x = np.array([depths(k, 201, **change) for k in range(RUNS)]) - 100.0 - 0.01 * np.arange(201)
    assert inside(x[:, [0, 200]], 0.2)
    # x(t + tau) - x(t) / e is independent of x(t).
    assert inside(x[:, 200:] - x[:, :1] / math.e, 0.2 * math.sqrt(1.0 - math.exp(-2.0)))


def test_a_sensor_that_sticks_repeats_what_it_gave():
    n = 20_000
    x = depths(3, n, stick_probability=0.01, stick_s=5.0)
    held = np.diff(x) == 0.0
    # Sticking for 10 samples, free for 1 / p - 1 on average before the next.
    share = 10.0 / (10.0 + 0.99 / 0.01)
    # About 180 times: 7 % is one sigma of how often.
    assert held.mean() == pytest.approx(share, rel=0.28)
    assert_allclose(x[1:][~held], 100.0 + 0.01 * np.arange(1, n)[~held])


def test_options_of_depth_change_no_other_number():
    def noisy(**changes):
        sensor = DepthSensor(DepthErrors(**changes), stream(1, 'depth'))
        return np.array([sensor.measure(k, 100.0, np.eye(3)) for k in range(600)])

    moved = noisy(air_pressure_sigma_hpa=10.0) - noisy()
    assert_allclose(moved, moved[0], atol=1e-12)
    stuck = noisy(stick_probability=0.01)
    assert np.mean(stuck == noisy()) > 0.2


def test_a_leader_may_be_off_without_stating_it():
    plain = ReferenceErrors(1.0, 0.1, 0.1, 0.1)
    wrong = dataclasses.replace(plain, position_offset_m=(3.0, -2.0, 1.0), heading_bias_deg=2.0)
    a, b = (ReferenceSystem(e, 0.1, stream(1, 'reference')) for e in (plain, wrong))
    assert_array_equal(a.sigma, b.sigma)
    x, y = a.error(7), b.error(7)
    assert_allclose(y.dr_G - x.dr_G, [3.0, -2.0, 1.0])
    assert_array_equal(y.dv_G, x.dv_G)
    alone = ReferenceSystem(ReferenceErrors(heading_bias_deg=2.0), 0.1, stream(1, 'r')).error(0)
    C = alone.attitude(np.eye(3))
    assert math.degrees(math.atan2(C[1, 0], C[0, 0])) == pytest.approx(2.0)


def test_the_array_has_one_turn_and_one_range_scale_per_run():
    mission = load_mission('demo')
    leader, follower = (TrajectoryPoses(mission.truth(v)) for v in mission.vehicles)
    exact = UsblErrors(cosine_sigma=0.0, range_sigma_m=0.0)

    def read(seed, sequence=0, **changes):
        usbl = Usbl(dataclasses.replace(exact, **changes), WATER, seed, 'leader', 'follower')
        t1_ns = mission.start_ns + (1 + sequence) * 10**9
        return usbl.read(usbl.cycle(sequence, t1_ns, leader, follower))

    true = read(1)
    drawn = [read(k, range_scale_sigma=0.01, misalignment_sigma_deg=0.5) for k in range(RUNS)]
    assert inside(np.array([[r.range_m / true.range_m - 1.0] for r in drawn]), 0.01)
    turned = np.array([r.direction_a for r in drawn]) - true.direction_a
    across = np.linalg.svd(true.direction_a[None, :])[2][1:]
    assert inside(turned @ across.T, math.radians(0.5))
    assert read(1, range_scale=0.02).range_m == pytest.approx(1.02 * true.range_m, rel=1e-9)
    # The next cycle has the same.
    again = read(1, 5, range_scale_sigma=0.01).range_m / read(1, 5).range_m
    assert again == pytest.approx(read(1, range_scale_sigma=0.01).range_m / true.range_m, rel=1e-9)


def test_a_station_may_be_elsewhere_and_measure_long():
    exact = StationErrors(
        range_error=0.0, range_quantum_m=0.0, bearing_error_deg=0.0, bearing_quantum_deg=0.0
    )
    wrong = dataclasses.replace(exact, range_scale=0.01, position_offset_m=(20.0, -5.0))
    away = Straight((800.0, 300.0, -15.0))
    readings = []
    for errors in (exact, wrong):
        station = Station(errors, WATER, 1, 'station', 'auv', FRAME)
        readings.append(station.read(station.cycle(0, START_NS, Straight((0, 0, 0)), away)))
    true, off = readings
    assert off.polar.range == pytest.approx(1.01 * true.polar.range)
    assert off.polar.bearing == true.polar.bearing
    assert_allclose(off.polar.station - true.polar.station, [20.0, -5.0, 0.0])


def test_a_clock_is_late_by_offset_and_drift():
    clock = ClockErrors(clock_offset_s=-0.05, clock_drift_ppm=20.0)
    assert clock.reads_ns(10**18, 0) == 10**18 - 50_000_000
    assert clock.reads_ns(10**18, 1000 * 10**9) == 10**18 - 30_000_000
    assert ClockErrors().reads_ns(10**18 + 1, 123) == 10**18 + 1
