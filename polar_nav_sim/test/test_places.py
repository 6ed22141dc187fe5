"""The exact poles and +-180 degrees are ordinary places for everything that is simulated."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sim_places import PLACES, mission_at

from polar_nav_core import attitude, earth
from polar_nav_core.depth import depth_from_pressure, pressure_from_depth
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import earth_rate
from polar_nav_sim.acoustics import Channel, ChannelSpec, Packet
from polar_nav_sim.closure import closure
from polar_nav_sim.mission import load_mission
from polar_nav_sim.poses import TrajectoryPoses, TruthHistory
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.dvl import DvlErrors, DvlSensor
from polar_nav_sim.sensors.usbl import Usbl, UsblErrors
from polar_nav_sim.sound_speed import SoundSpeed
from polar_nav_sim.truth_cdr import decode, encode

C = 1440.0
places = pytest.mark.parametrize('place', PLACES)


@places
def test_truth_is_smooth_and_derivatives_are_derivatives(place):
    mission = mission_at(place)
    truth = mission.truth('follower')
    # Across the very start, where the vehicle stands on the pole.
    h = 0.01
    times = np.arange(-2, 3) * 10_000_000 + mission.start_ns
    s = truth.state(times)
    first = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * h)
    second = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * h * h)
    r = s.r_e - s.r_e[2]
    assert_allclose(first @ r, s.v_e[2], atol=3e-7)
    spin = np.array([0.0, 0.0, earth.OMEGA_IE])
    up = earth.gravity(s.r_e[2]) * earth.up(s.r_e[2])
    f_e = second @ r + 2.0 * np.cross(spin, s.v_e[2]) + up
    C_b_e = np.einsum('nji,njk->nik', s.C_e_G, s.C_b_G)
    assert_allclose(C_b_e[2].T @ f_e, s.f_b[2], atol=2e-4)
    turn = [attitude.log(C_b_e[2].T @ C) for C in C_b_e]
    assert_allclose(first @ turn + C_b_e[2].T @ spin, s.omega_ib_b[2], atol=1e-9)
    whole = truth.samples(0, mission.sample_count).state
    assert np.ptp(whole.v_G, axis=0).max() < 1e-9
    assert np.abs(whole.depth - 100.0).max() < 1e-6
    latitude, _ = PLACES[place]
    assert float(np.degrees(s.lat[2])) == pytest.approx(latitude, abs=1e-9)


@places
def test_strapdown_closes(place):
    left = closure(mission_at(place), 'follower')
    assert left.position_m < 1e-5
    assert left.velocity < 1e-6
    assert left.attitude < 1e-10


@places
def test_truth_goes_through_messages_and_their_interpolation(place):
    mission = mission_at(place)
    truth = mission.truth('leader')
    block = truth.samples(0, 101)
    history = TruthHistory(10**10)
    for stamp_ns, data in zip(block.stamp_ns.tolist(), encode(block), strict=True):
        assert decode(data).stamp_ns == stamp_ns
        assert history.add(stamp_ns, data)
    exact = TrajectoryPoses(truth)
    for t_ns in np.random.default_rng(1).integers(*block.stamp_ns[[0, -1]], 20).tolist():
        got, expected = history.pose(t_ns), exact.pose(t_ns)
        assert np.abs(got.r_e - expected.r_e).max() < 1e-8
        assert np.abs(got.C_b_e - expected.C_b_e).max() < 1e-10
        assert got.depth == pytest.approx(expected.depth, abs=1e-6)


@places
def test_usbl_points_from_one_vehicle_to_the_other(place):
    mission = mission_at(place)
    leader, follower = (TrajectoryPoses(mission.truth(v)) for v in mission.vehicles)
    usbl = Usbl(
        UsblErrors(cosine_sigma=0.0, range_sigma_m=0.0),
        SoundSpeed.constant(C),
        1,
        'leader',
        'follower',
    )
    cycle = usbl.cycle(0, mission.start_ns + 10**9, leader, follower)
    at4, at3 = leader.pose(cycle.t4_ns), follower.pose(cycle.t3_ns)
    line_e = at3.r_e - at4.r_e
    distance = np.linalg.norm(line_e)
    assert_allclose(at4.C_b_e @ cycle.direction_a * distance, line_e, atol=1e-8)
    assert (cycle.t4_ns - cycle.t3_ns) * 1e-9 == pytest.approx(distance / C, abs=2e-9)
    assert distance == pytest.approx(600.0, abs=3.0)
    assert cycle.reply_depth == pytest.approx(100.0, abs=1e-6)


@places
def test_packets_travel_the_same_way(place):
    mission = mission_at(place)
    poses = {v: TrajectoryPoses(mission.truth(v)) for v in mission.vehicles}
    channel = Channel(ChannelSpec(), SoundSpeed.constant(C), 1, poses)
    channel.send(Packet('leader', 'follower', 0, mission.start_ns + 10**9, 0.0, bytes(32)))
    (arrival,) = channel.arrived(mission.start_ns + 20 * 10**9)
    travel_s = (arrival.receive_ns - arrival.packet.transmit_ns) * 1e-9 - 0.256 - 0.1
    assert travel_s * C == pytest.approx(601.0, abs=3.0)


@places
@pytest.mark.parametrize('four_beams', [False, True])
def test_dvl_sees_the_velocity(place, four_beams):
    mission = mission_at(place, sea_floor_depth_m=150.0)
    s = mission.truth('follower').state(mission.start_ns + 10**9)
    exact = DvlErrors(
        scale=(0.0,) * 3, markov_sigma=0.0, noise_sigma=0.0, four_beams=four_beams,
        beam_noise_sigma=0.0, beam_range_sigma_m=0.0,
    )  # fmt: skip
    omega_eb_b = s.omega_ib_b - s.C_b_G.T @ earth_rate(s.r_e)
    sensor = DvlSensor(exact, 0.2, stream(1, 'dvl'))
    ping = sensor.measure(0, s.C_b_G.T @ s.v_G, omega_eb_b, float(s.altitude), s.C_b_G)
    assert_allclose(s.C_b_G @ ping.velocity_m, s.v_G, atol=1e-12)
    assert ping.altitude == pytest.approx(50.0, abs=1e-6)


@places
def test_pressure_gives_the_depth_back(place):
    lat = np.radians(PLACES[place][0])
    assert_allclose(depth_from_pressure(pressure_from_depth(100.0, lat), lat), 100.0, atol=1e-8)


@pytest.mark.parametrize('name', ['over_pole', 'south_pole', 'antimeridian', 'meridian_180'])
def test_missions_over_the_pole_and_along_180_degrees_run_through(name):
    """Whole missions at the IMU rate: finite, at their speed, without a jump but in longitude."""
    mission = load_mission(name)
    s = mission.truth('follower').samples(0, mission.sample_count).state
    assert all(np.isfinite(getattr(s, f)).all() for f in ('r_e', 'v_G', 'C_b_G', 'f_b', 'lat'))
    assert_allclose(np.linalg.norm(s.v_G, axis=1), 3.0, atol=1e-9)
    assert np.abs(np.diff(s.C_b_G, axis=0)).max() < 3e-3
    assert np.abs(np.diff(s.C_e_G, axis=0)).max() < 1e-8
    if name == 'meridian_180':
        assert np.abs(np.abs(s.lon) - np.pi).max() < 1e-9
    else:
        assert np.abs(np.diff(s.lon)).max() > 1.0


@pytest.mark.parametrize('longitude', [90.0, -90.0, 270.0])
def test_the_only_singular_places_are_named(longitude):
    mission = mission_at('ordinary', **{'path.latitude_deg': 0.0, 'path.longitude_deg': longitude})
    with pytest.raises((ConfigError, ValueError), match='grid'):
        mission.truth('follower')
