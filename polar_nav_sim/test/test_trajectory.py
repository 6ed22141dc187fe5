"""Truth: its derivatives are derivatives, and the core's strapdown integrates it back."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from polar_nav_core import attitude, earth, grid
from polar_nav_core.strapdown import Strapdown
from polar_nav_sim.mission import load_mission
from polar_nav_sim.resources import mission_names

CASES = ['over_pole', 'south_pole', 'antimeridian', 'near_pole', 'racetrack', 'dive', 'demo']


def at(mission, seconds):
    return mission.start_ns + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


@pytest.mark.parametrize('name', CASES)
def test_velocity_force_and_rate_are_those_of_the_motion(name):
    """Central differences of position and attitude against f_b and omega_ib_b."""
    mission = load_mission(name)
    truth = mission.truth('follower')
    middle, h = mission.duration_s / 2 + 0.123, 0.01
    times = middle + h * np.arange(-2, 3)
    s = truth.state(at(mission, times))
    # Fourth-order central differences of position; ECEF rounding limits them to 1e-6 m/s^2.
    first = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * h)
    second = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * h * h)
    r = s.r_e - s.r_e[2]
    assert_allclose(first @ r, s.v_e[2], atol=3e-7)
    spin = np.array([0.0, 0.0, earth.OMEGA_IE])
    f_e = (
        second @ r + 2.0 * np.cross(spin, s.v_e[2]) + earth.gravity(s.r_e[2]) * earth.up(s.r_e[2])
    )
    C_b_e = np.einsum('nji,njk->nik', s.C_e_G, s.C_b_G)
    assert_allclose(C_b_e[2].T @ f_e, s.f_b[2], atol=2e-4)
    turn = [attitude.log(C_b_e[2].T @ C) for C in C_b_e]
    assert_allclose(first @ turn + C_b_e[2].T @ spin, s.omega_ib_b[2], atol=1e-9)
    assert_allclose(s.v_G[2], s.C_e_G[2] @ s.v_e[2], atol=1e-15)
    assert_allclose(s.C_e_G[2], grid.ecef_to_grid(s.r_e[2]), atol=0)


@pytest.mark.parametrize('name', mission_names())
def test_strapdown_reproduces_truth(name):
    """Ten minutes at 100 Hz, nothing held: within a millimetre, 1e-5 m/s and 1e-9 rad."""
    mission = load_mission(name)
    truth = mission.truth(mission.followers[0])
    count = min(mission.sample_count, 60001)
    block = truth.samples(0, count)
    s = block.state
    ins = Strapdown(s.C_b_G[0], s.v_G[0], s.r_e[0])
    ins.run(block.delta_theta_b[1:], block.delta_v_b[1:], 0.01)
    assert np.linalg.norm(ins.r_e - s.r_e[-1]) < 1e-3
    assert np.abs(ins.v_G - s.v_G[-1]).max() < 1e-5
    assert np.abs(attitude.log(s.C_b_G[-1].T @ ins.C_b_G)).max() < 1e-9


def test_what_is_left_of_strapdown_is_its_step():
    """The closure error is the strapdown's own: it falls with the step, truth does not change."""
    errors = []
    for rate in (50.0, 100.0, 200.0):
        mission = load_mission('over_pole').with_overrides(
            {'imu_rate_hz': rate, 'duration_s': 300.0}
        )
        block = mission.truth('follower').samples(0, mission.sample_count)
        s = block.state
        ins = Strapdown(s.C_b_G[0], s.v_G[0], s.r_e[0])
        ins.run(block.delta_theta_b[1:], block.delta_v_b[1:], 1.0 / rate)
        errors.append(np.linalg.norm(ins.r_e - s.r_e[-1]))
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]


def test_increments_are_integrals():
    """Against a quadrature of many more points, and block by block the same bits."""
    mission = load_mission('near_pole')
    truth = mission.truth('follower')
    block = truth.samples(30000, 30010)
    x, w = np.polynomial.legendre.leggauss(12)
    for i in (0, 9):
        end = (30000 + i) * 0.01
        t = at(mission, end - 0.01 + 0.005 * (x + 1.0))
        inner = truth.state(t)
        # Times are rounded to nanoseconds here, hence 1e-9 of the rates.
        assert_allclose(0.005 * w @ inner.omega_ib_b, block.delta_theta_b[i], atol=2e-12)
        assert_allclose(0.005 * w @ inner.f_b, block.delta_v_b[i], atol=2e-11)
    assert_allclose(truth.samples(30004, 30005).delta_v_b[0], block.delta_v_b[4], rtol=0, atol=0)


def test_first_sample_has_no_interval():
    block = load_mission('demo').truth('leader').samples(0, 3)
    assert block.interval_s.tolist() == [0.0, 0.01, 0.01]
    assert not block.delta_v_b[0].any()
    assert block.stamp_ns.tolist() == [1772323200 * 10**9 + k * 10**7 for k in range(3)]


def test_straight_is_constant_in_grid_axes():
    mission = load_mission('over_pole')
    s = mission.truth('follower').state(at(mission, np.linspace(0.0, 600.0, 1201)))
    assert np.ptp(s.v_G, axis=0).max() < 1e-10
    assert np.hypot(s.r_e[:, 0], s.r_e[:, 1]).min() < 1.0
    # The pole is an ordinary place: true course jumps there by half a turn, nothing else does.
    assert np.abs(np.diff(s.C_b_G, axis=0)).max() < 0.1


def test_oscillation_is_the_papers():
    mission = load_mission('demo')
    seconds = np.linspace(0.0, 210.0, 2101)
    s = mission.truth('follower').state(at(mission, seconds))
    psi, theta, phi = attitude.euler_from_matrix(s.C_b_G)
    for angle, amplitude, period in ((theta, 4.0, 3.0), (phi, 5.0, 5.0), (psi - psi[0], 3.0, 7.0)):
        expected = np.radians(amplitude) * np.sin(2.0 * np.pi * seconds / period)
        assert_allclose(angle, expected, atol=1e-12)


def test_dive_goes_where_it_says_and_points_there():
    mission = load_mission('dive').with_overrides({'oscillation.pitch.amplitude_deg': 0.0})
    s = mission.truth('follower').state(at(mission, np.arange(0.0, 600.0, 0.5)))
    assert s.depth.min() == pytest.approx(40.0, abs=1e-3)
    assert s.depth.max() == pytest.approx(100.0, abs=1e-3)
    _, theta, _ = attitude.euler_from_matrix(s.C_b_G)
    horizontal = np.hypot(s.v_G[:, 0], s.v_G[:, 1])
    assert_allclose(theta, np.arctan2(-s.v_G[:, 2], horizontal), atol=1e-5)
    assert theta.max() == pytest.approx(np.radians(12.0), abs=1e-5)


@pytest.mark.parametrize(('name', 'turns'), [('racetrack', 1), ('lawnmower', 0)])
def test_legs_and_turns(name, turns):
    mission = load_mission(name)
    s = mission.truth('follower').state(at(mission, np.arange(0.0, mission.duration_s, 0.5)))
    course = np.unwrap(np.arctan2(s.v_G[:, 1], s.v_G[:, 0]))
    if turns:
        assert course[-1] - course[0] > 2.0 * np.pi
    else:
        assert np.ptp(course) == pytest.approx(np.pi, abs=1e-4)
    rate = np.gradient(course, 0.5)
    radius = mission.path.speed_mps / np.abs(rate).max()
    assert radius == pytest.approx(mission.path.turn_radius_m, rel=0.01)


def test_truth_outside_of_the_mission_is_refused():
    mission = load_mission('demo')
    with pytest.raises(ValueError, match='no truth from 700'):
        mission.truth('leader').state(at(mission, 700.0))
    with pytest.raises(ValueError, match='k0 < k1'):
        mission.truth('leader').samples(5, 5)


def test_altitude_is_known_only_with_a_floor():
    mission = load_mission('demo')
    assert np.isnan(mission.truth('follower').state(mission.start_ns).altitude)
    shallow = mission.with_overrides({'sea_floor_depth_m': 150.0, 'sea_surface_height_m': 12.0})
    s = shallow.truth('follower').state(mission.start_ns)
    assert float(s.altitude) == pytest.approx(50.0, abs=1e-6)
    assert float(s.h) == pytest.approx(12.0 - 100.0, abs=1e-6)
