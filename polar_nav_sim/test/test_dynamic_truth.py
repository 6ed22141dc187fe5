"""Truth of a vehicle with dynamics: its derivatives, its ideal IMU, pieces of any size."""

import math
from pathlib import Path

import numpy as np
import pytest

from polar_nav_core import attitude, earth, grid
from polar_nav_core.errors import ConfigError
from polar_nav_sim.closure import closure
from polar_nav_sim.dynamics.motion import OutOfControl
from polar_nav_sim.mission import load_mission, mission_from
from polar_nav_sim.poses import TrajectoryPoses
from polar_nav_sim.trajectory import ABYSS_M
from polar_nav_sim.truth_cdr import decode, encode

STATION = load_mission('station').with_duration(60.0)
START = STATION.start_ns


def fresh(mission=STATION):
    """A truth that nobody has asked anything yet."""
    return mission.with_overrides({}).dynamics('auv')


def test_it_starts_where_the_mission_says():
    s = fresh().state(START)
    leader = STATION.truth('station').state(START)
    west_north_up = grid.ecef_to_grid(leader.r_e) @ (s.r_e - leader.r_e)
    # The sea surface falls away by 7 cm over 919 m.
    np.testing.assert_allclose(west_north_up, [-850.0, 350.0, -15.066], atol=0.002)
    assert float(s.depth) == pytest.approx(20.0, abs=1e-6)
    psi, theta, phi = attitude.euler_from_matrix(s.C_b_G)
    assert (float(psi), float(theta), float(phi)) == pytest.approx((0.3, 0.0, 0.0), abs=2e-4)


def test_velocity_rate_and_force_are_those_of_the_motion():
    truth, h_ns = fresh(), 20_000
    t_ns = START + 10_000_000 * np.array([105, 2000, 4321]) + 5_000_000
    s, a, b = (truth.state(t) for t in (t_ns, t_ns - h_ns, t_ns + h_ns))
    h = 2e-9 * h_ns
    np.testing.assert_allclose((b.r_e - a.r_e) / h, s.v_e, atol=1e-4)
    np.testing.assert_allclose(np.einsum('nij,nj->ni', s.C_e_G, s.v_e), s.v_G, atol=1e-12)
    # The whole ellipsoid turns: attitude against inertial axes is C_b_e turned by omega_ie t.
    for i in range(len(t_ns)):
        C_b_e = [x.C_e_G[i].T @ x.C_b_G[i] for x in (a, b)]
        spin = attitude.exp(np.array([0.0, 0.0, earth.OMEGA_IE * h]))
        turn = attitude.log(C_b_e[0].T @ (spin @ C_b_e[1]))
        np.testing.assert_allclose(turn / h, s.omega_ib_b[i], atol=1e-7)
        a_e = (b.v_e[i] - a.v_e[i]) / h
        coriolis = 2.0 * np.cross([0.0, 0.0, earth.OMEGA_IE], s.v_e[i])
        f_e = a_e + coriolis + float(earth.gravity(s.r_e[i])) * earth.up(s.r_e[i])
        f_b = s.C_b_G[i].T @ s.C_e_G[i] @ f_e
        np.testing.assert_allclose(f_b, s.f_b[i], atol=1e-5)


@pytest.mark.parametrize('rate_hz', [50.0, 100.0])
def test_ideal_increments_carry_the_strapdown_for_a_minute(rate_hz):
    """At 50 Hz the thrust changes within the interval."""
    left = closure(STATION.with_overrides({'imu_rate_hz': rate_hz}), 'auv', hold=False)
    assert left.position_m < 1e-5
    assert left.velocity < 1e-6
    assert left.attitude < 1e-9


@pytest.mark.slow
def test_and_for_ten_minutes_in_a_swinging_current():
    mission = load_mission('station').with_overrides(
        {
            'duration_s': 600.0,
            'vehicles.auv.dynamics.current.change': 0.3,
            'vehicles.auv.dynamics.current.turn_deg': 34.4,
        }
    )
    left = closure(mission, 'auv', hold=False)
    assert left.position_m < 1e-3
    assert left.velocity < 1e-5
    assert left.attitude < 1e-9


def test_pieces_give_the_bits_of_the_whole():
    whole = fresh().samples(0, 500)
    ahead, bits = fresh(), b''.join(encode(whole))
    ahead.state(START + 50 * 10**9)
    step = fresh()
    pieces = [step.samples(k, k + n) for k, n in ((0, 1), (1, 7), (8, 92), (100, 400))]
    assert b''.join(b''.join(encode(p)) for p in pieces) == bits
    assert b''.join(encode(ahead.samples(0, 500))) == bits


def test_poses_are_those_of_the_state():
    truth = fresh()
    for t_ns in (START, START + 1_234_567_891):
        fast, slow = truth.pose(t_ns), TrajectoryPoses(truth).pose(t_ns)
        np.testing.assert_allclose(fast.r_e, slow.r_e, atol=1e-8)
        np.testing.assert_allclose(fast.C_b_e, slow.C_b_e, atol=1e-12)
        assert fast.depth == pytest.approx(slow.depth, abs=1e-9)


def test_the_current_and_the_thrust_are_told():
    truth = fresh()
    sample = decode(encode(truth.samples(100, 101))[0])
    np.testing.assert_allclose(sample.vector('current_g'), [0.4, 0.25, 0.0], atol=2e-4)
    tau = truth.thrust(START + 10**9)
    assert tau[0] == pytest.approx(52 + 18 * math.sin(0.05) + 14 * math.sin(0.013))
    assert tau[2] == pytest.approx(-5.0, abs=0.1)
    v_r_b = truth.velocity_through_water(START)
    assert 25 * v_r_b[0] + 19 * v_r_b[0] ** 2 == pytest.approx(52.0, abs=1e-3)


def test_other_rates_of_truth_are_the_same_motion():
    slow = STATION.with_overrides({'imu_rate_hz': 50.0}).dynamics('auv')
    a, b = slow.state(START + 20 * 10**9), fresh().state(START + 20 * 10**9)
    np.testing.assert_allclose(a.r_e, b.r_e, atol=1e-8)
    assert slow.motion.step_s == pytest.approx(0.01)


def test_between_steps_it_moves_as_with_shorter_steps():
    """Constant thrust, so that steps of 5 and 10 ms hold the same; in the middle of a long one."""
    fine = STATION.with_overrides({'imu_rate_hz': 200.0}).dynamics('auv')
    coarse = fresh()
    for truth in (fine, coarse):
        truth.motion.push(np.array([60.0, 0.0, -5.0, 0.0, 0.0, 3.0]))
    t_ns = START + 20 * 10**9 + 5_000_000
    a, b = fine.state(t_ns), coarse.state(t_ns)
    assert np.linalg.norm(b.omega_ib_b) > 0.1
    np.testing.assert_allclose(a.r_e, b.r_e, atol=1e-8)
    np.testing.assert_allclose(a.v_e, b.v_e, atol=1e-8)
    np.testing.assert_allclose(a.f_b, b.f_b, atol=1e-6)
    np.testing.assert_allclose(a.omega_ib_b, b.omega_ib_b, atol=1e-8)


def test_set_points_and_thrust_from_outside():
    truth = fresh()
    truth.state(START + 10**9)
    truth.motion.want(math.nan, math.nan, 25.0, 0.8)
    s = truth.state(START + 48 * 10**9)
    assert float(s.depth) == pytest.approx(25.0, abs=0.05)
    assert truth.velocity_through_water(START + 48 * 10**9)[0] == pytest.approx(0.8, abs=0.01)
    truth.motion.push(np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]))
    assert truth.velocity_through_water(START + 57 * 10**9)[0] < 0.3
    np.testing.assert_array_equal(truth.thrust(START + 50 * 10**9), [0, 0, -5, 0, 0, 0])
    truth.motion.push(None)
    assert truth.thrust(START + 59 * 10**9)[0] > 20.0


def test_out_of_control_is_said():
    weak = STATION.with_overrides(
        {
            'vehicles.auv.dynamics.loops.pitch_gain': 10.0,
            'vehicles.auv.dynamics.loops.pitch_damping': 5.0,
        }
    ).dynamics('auv')
    weak.motion.want(math.nan, math.nan, 40.0, 3.0)
    with pytest.raises(OutOfControl, match='raise pitch_gain'):
        weak.state(START + 60 * 10**9)


def test_no_truth_beyond_the_mission():
    with pytest.raises(ValueError, match=r'the mission has 0 to 60\.0 s'):
        fresh().state(STATION.end_ns + 10**9)


def test_the_floor_is_lost_when_the_mission_says():
    mission = load_mission('model_aided')
    t_ns = mission.start_ns + np.array([299, 300, 599, 600]) * 10**9
    altitude = mission.truth('follower').state(t_ns).altitude
    assert np.isnan(altitude[[0, 3]]).all()
    assert np.all(altitude[1:3] > 0.9 * ABYSS_M)
    assert np.isnan(mission.truth('leader').state(t_ns).altitude).all()


def test_vehicles_of_model_aided_stay_together():
    mission = load_mission('model_aided')
    t_ns = mission.start_ns + np.arange(0, 900, 5) * 10**9
    a, b = (mission.truth(v).state(t_ns).r_e for v in mission.vehicles)
    distance = np.linalg.norm(a - b, axis=1)
    assert 440.0 < distance.min() <= distance.max() < 570.0


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'vehicles.auv.dynamics.body.mass_kg': -1.0}, ('auv.dynamics.body', 'mass_kg')),
        ({'vehicles.auv.dynamics.hull': {}}, ('auv.dynamics', 'hull')),
        ({'vehicles.auv.dynamics.law.surge_n': [1.0]}, ('auv.dynamics.law', 'surge_n')),
        ({'vehicles.auv.fixed': True}, ('fixed',)),
        ({'vehicles.auv.dynamics': 3}, ('auv.dynamics', '3')),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(ConfigError) as error:
        STATION.with_overrides(change)
    for word in ('station.yaml', *words):
        assert word in str(error.value)


def test_a_fixed_vehicle_stays_and_a_track_has_no_place():
    truth = STATION.truth('station')
    s = truth.state(START + np.array([0, 60]) * 10**9)
    np.testing.assert_allclose(s.r_e[0], s.r_e[1], atol=1e-9)
    np.testing.assert_allclose(s.v_G, 0.0, atol=1e-9)
    psi = attitude.euler_from_matrix(s.C_b_G)[0]
    np.testing.assert_allclose(psi, 0.3, atol=1e-12)
    document = dict(load_mission('near_pole').document)
    document['vehicles'] = {'leader': {'role': 'leader', 'fixed': True}, 'follower': {}}
    with pytest.raises(ConfigError, match='a track has none'):
        mission_from(document, Path(load_mission('near_pole').file)).truth('leader')
    with pytest.raises(ConfigError, match='has no dynamics'):
        STATION.dynamics('station')
