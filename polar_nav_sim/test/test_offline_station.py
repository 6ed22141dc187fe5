"""The station scenario in arrays: same bits from a seed, consistent, and what its switches do."""

import dataclasses

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.vehicle_model import VehicleModel
from polar_nav_sim.mission import load_mission
from polar_nav_sim.offline_station import StationScenario, simulate

SHORT = StationScenario(duration_s=120.0)


@pytest.fixture(scope='module')
def run():
    return simulate(SHORT, 1)


@pytest.fixture(scope='module')
def whole():
    return simulate(StationScenario(), 1)


def errors_of(run):
    """Errors of the fixes, horizontal, station axes [m]."""
    f = run.fixes
    angle = f.bearing + f.station_heading
    level = np.sqrt(f.range**2 - (f.station_position - f.true_position)[:, 2] ** 2)
    place = f.station_position[:, :2] + (level * [np.cos(angle), np.sin(angle)]).T
    return place - f.true_position[:, :2]


def test_the_same_seed_gives_the_same_bits(run):
    simulate(dataclasses.replace(SHORT, excitation=0.5), 3)
    simulate(dataclasses.replace(SHORT, excitation=0.6), 3)  # the motion is not kept any more
    again, other = simulate(SHORT, 1), simulate(SHORT, 2)
    for name in ('omega_ib_b', 'C_b_G', 'force_b', 'depth', 'p', 'v', 'current'):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))
    for f in dataclasses.fields(run.fixes):
        np.testing.assert_array_equal(getattr(again.fixes, f.name), getattr(run.fixes, f.name))
    np.testing.assert_array_equal(other.p, run.p)
    for name in ('omega_ib_b', 'C_b_G', 'depth'):
        assert np.all(getattr(other, name) != getattr(run, name))


def test_the_paper_scenario(whole):
    """The delay, the distance and the error of the fixes that the reference computation states."""
    f = whole.fixes
    assert whole.sent == len(f.sequence) == 640
    delay = f.receive_s - f.validity_s
    assert 1.25 < delay.min() < delay.max() < 1.74
    distance = np.linalg.norm(f.true_position - f.station_position, axis=1)
    assert 780.0 < distance.min() < 790.0
    assert 1125.0 < distance.max() < 1135.0
    e = errors_of(whole)
    x, y = np.sqrt(np.mean(e**2, axis=0))
    assert (x, y) == (pytest.approx(9.0, rel=0.1), pytest.approx(6.8, rel=0.1))
    assert np.abs(e).max() < 26.0


def test_stated_sigmas_fit_the_errors(whole):
    f = whole.fixes
    line = f.true_position - f.station_position
    range_error = f.range - np.linalg.norm(line, axis=1)
    bearing_error = f.bearing + f.station_heading - np.arctan2(line[:, 1], line[:, 0])
    bearing_error = np.remainder(bearing_error + np.pi, 2 * np.pi) - np.pi
    for x in (range_error / f.range_sigma, bearing_error / f.bearing_sigma):
        assert np.mean(x**2) == pytest.approx(1.0, abs=4 * 0.9 / np.sqrt(640))


def test_truth_is_one_motion(run):
    h = run.t_s[1]
    np.testing.assert_allclose((run.p[2:] - run.p[:-2]) / (2 * h), run.v[1:-1], atol=1e-5)
    back = np.einsum('nij,nj->ni', run.true_C_b_G, run.v_r_b) + run.current
    np.testing.assert_allclose(back, run.v, atol=1e-9)
    heading = np.arctan2(run.true_C_b_G[:, 1, 0], run.true_C_b_G[:, 0, 0])
    np.testing.assert_allclose(np.unwrap(heading), run.psi, atol=1e-6)
    sag = np.sum(run.p[:, :2] ** 2, axis=1) / (2 * 6.38e6)
    np.testing.assert_allclose(run.station_depth - run.p[:, 2] - sag, run.true_depth, atol=2e-3)
    assert np.abs(run.depth - run.true_depth).max() <= 0.05
    at = np.interp(run.fixes.validity_s, run.t_s, run.p[:, 0])
    np.testing.assert_allclose(at, run.fixes.true_position[:, 0], atol=1e-3)


def test_rates_are_the_means_that_an_imu_gives(run):
    truth = load_mission('station').with_duration(20.0).dynamics('auv')
    mean = truth.samples(1, 1501).delta_theta_b / 0.01
    np.testing.assert_allclose(run.true_omega_b[1:1501], mean, atol=1e-8)
    assert np.abs(run.omega_ib_b - run.true_omega_b).max() <= 0.01


def test_the_reduced_model_follows_from_thrust_rates_and_attitude(run):
    b = run.body
    model = VehicleModel.of(
        b.mass_kg, b.added_mass[:3], b.drag_linear[:3], b.drag_quadratic[:3], b.net_buoyancy_n
    )
    v, h, got = run.v_r_b[0].copy(), run.t_s[1], []
    for k in range(6000):
        # The rate over the step that begins here; the Earth's is 7e-5 rad/s.
        omega = run.true_omega_b[k + 1]
        v = v + h * model.acceleration(v, omega, run.true_C_b_G[k].copy(), run.force_b[k].copy())
        got.append(v)
    np.testing.assert_allclose(got, run.v_r_b[1:6001], atol=2e-4)


def test_losses_delays_and_short_periods():
    lossy = simulate(dataclasses.replace(SHORT, loss=0.5, duration_s=600.0), 2)
    assert 0.35 * lossy.sent < len(lossy.fixes.sequence) < 0.65 * lossy.sent
    late = simulate(dataclasses.replace(SHORT, random_delay_s=3.0), 2).fixes
    assert np.any(np.diff(late.sequence) < 0)
    assert np.all(np.diff(late.receive_s) > 0)
    slower = simulate(dataclasses.replace(SHORT, period_s=2.0), 2)
    assert np.diff(slower.fixes.validity_s).min() > 2.0
    with pytest.raises(ConfigError, match='period_s'):
        simulate(dataclasses.replace(SHORT, period_s=2.0, when_short='refuse'), 2)


def test_switches_of_the_scenario(run):
    half = simulate(dataclasses.replace(SHORT, noise=0.5), 1)
    ratio = np.std(errors_of(half)) / np.std(errors_of(run))
    assert 0.4 < ratio < 0.65
    assert np.abs(half.depth - half.true_depth).max() <= 0.025
    biased = simulate(dataclasses.replace(SHORT, heading_bias=0.035), 1)
    turn = np.einsum('nji,njk->nik', run.C_b_G, biased.C_b_G)
    np.testing.assert_allclose(np.arccos((turn.trace(axis1=1, axis2=2) - 1) / 2), 0.035, atol=1e-6)
    low = simulate(dataclasses.replace(SHORT, excitation=0.25, duration_s=600.0), 1)
    assert np.abs(low.force_b[:, 0] - 52.0).max() <= 8.0
    slow = simulate(dataclasses.replace(SHORT, current_change=0.3, current_turn=0.6), 1)
    np.testing.assert_allclose(slow.current[0], run.current[0], atol=1e-12)
    assert np.linalg.norm(slow.current[-1] - run.current[-1]) > 0.1
    false_speed = simulate(dataclasses.replace(SHORT, assumed_sound_speed=1450.0), 1)
    np.testing.assert_allclose(false_speed.fixes.range / run.fixes.range, 1450 / 1500, atol=6e-4)
    turned = simulate(dataclasses.replace(SHORT, station_heading_bias=0.1), 1)
    np.testing.assert_allclose(
        turned.fixes.station_heading - run.fixes.station_heading, 0.1, atol=2e-4
    )


def test_arrays_that_seeds_share_cannot_be_changed(run):
    with pytest.raises(ValueError, match='read-only'):
        run.p[0] = 0.0
