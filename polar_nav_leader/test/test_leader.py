"""The leader's part of a fix: moving ends, tilted array, lever arms, the pole."""

import numpy as np
import pytest
from sailing import C_SOUND, T0, TURN_AROUND, Sailing, cycle

from polar_nav_core import attitude, grid
from polar_nav_core.link import packet
from polar_nav_leader.broadcast import ArrayMeasurement
from polar_nav_leader.leader import Leader
from polar_nav_leader.params import LeaderParams
from polar_nav_leader.states import LeaderStates


def send(leader, measurement, until, **changes):
    params = LeaderParams(processing_delay_s=0.3, **changes)
    engine = Leader(params)
    out = []
    engine.add_measurement(measurement)
    for k in range(int(until * 10) + 1):
        engine.add_state(leader.state(k / 10))
        out += [(k / 10, p) for p in engine.due()]
    return engine, out


PLACES = [(80.0, 120.0), (89.999, 179.999), (90.0, 0.0), (-89.99, 30.0), (75.0, -180.0)]


@pytest.mark.parametrize(('lat', 'lon'), PLACES)
@pytest.mark.parametrize('tells_depth', [True, False])
def test_noise_free_fix_is_where_the_follower_was_at_the_reply(lat, lon, tells_depth):
    lever, rpy = (1.2, -0.4, -0.8), (178.0, 3.0, 25.0)
    C_a_b = attitude.matrix_from_euler(*np.deg2rad(rpy[::-1]))
    leader = Sailing(lat, lon, 60.0, (0.5, 2.0, 0.2))
    C_G_e = grid.ecef_to_grid(leader.start).T
    follower = Sailing(lat, lon, 60.0, (0.5, 2.0, 0.2), offset_e=C_G_e @ [500.0, 300.0, -40.0])
    measurement, t3, t4 = cycle(leader, follower, np.array(lever), C_a_b, 2.0137, tells_depth)
    _, out = send(leader, measurement, 6.0, array_lever_b=lever, array_rpy_deg=rpy)
    ((sent_at, p),) = out
    b = packet.decode(p.data, T0 + 10_000_000_000)
    fix = p.broadcast.leader_r_e + grid.ecef_to_grid(p.broadcast.leader_r_e).T @ p.broadcast.r_lf_G
    assert np.linalg.norm(fix - follower.r_e(t3)) < 0.02
    assert abs(p.broadcast.validity_ns - (T0 + t3 * 1e9)) < 1e5
    assert b.return_ns == pytest.approx(T0 + t4 * 1e9, abs=1e5)
    assert sent_at == pytest.approx(np.ceil((t4 + 0.3) * 10) / 10)
    np.testing.assert_allclose(b.r_lf_G, p.broadcast.r_lf_G, atol=0.006)


def test_without_the_correction_for_the_leaders_motion_the_range_would_be_off():
    """Closing at 3 m/s: half the way the leader made meanwhile is 1.4 m; the fix has none."""
    leader = Sailing(80.0, 120.0, 60.0, (0.0, 0.0, 0.0))
    along = grid.ecef_to_grid(leader.start).T @ [1.0, 0.0, 0.0]
    leader.v_e = 3.0 * along
    follower = Sailing(80.0, 120.0, 60.0, (0.0, 0.0, 0.0), offset_e=700.0 * along)
    measurement, t3, _ = cycle(leader, follower, np.zeros(3), np.eye(3), 1.0)
    half_path = 0.5 * C_SOUND * (measurement.round_trip - TURN_AROUND)
    _, [(_, p)] = send(leader, measurement, 5.0, formation=False)
    fix = p.broadcast.leader_r_e + grid.ecef_to_grid(p.broadcast.leader_r_e).T @ p.broadcast.r_lf_G
    assert np.linalg.norm(fix - follower.r_e(t3)) < 0.02
    assert abs(half_path - np.linalg.norm(p.broadcast.r_lf_G)) > 1.3


@pytest.mark.slow
def test_covariance_of_the_fix_covers_its_scatter():
    """Measurements with their stated noise, 400 of them: mean normalized square is 3."""
    leader = Sailing(85.0, -60.0, 60.0, (1.0, 1.0, 0.0))
    C_G_e = grid.ecef_to_grid(leader.start).T
    follower = Sailing(85.0, -60.0, 60.0, (1.0, 1.0, 0.0), offset_e=C_G_e @ [400.0, 500.0, -60.0])
    clean, _, _ = cycle(leader, follower, np.zeros(3), np.eye(3), 1.0)
    _, [(_, reference)] = send(leader, clean, 5.0)
    rng = np.random.default_rng(7)
    total = 0.0
    for _ in range(400):
        noisy = clean.direction_a + np.array([*rng.normal(0, 1e-3, 2), 0.0])
        noisy[2] = -np.sqrt(1.0 - noisy[0] ** 2 - noisy[1] ** 2)
        noise = dict(
            direction_a=noisy,
            round_trip=clean.round_trip + 2 * rng.normal(0, 0.3) / C_SOUND,
            target_depth=clean.target_depth + rng.normal(0, 0.05),
        )
        _, [(_, p)] = send(leader, ArrayMeasurement(**{**clean.__dict__, **noise}), 5.0)
        e = p.broadcast.r_lf_G - reference.broadcast.r_lf_G
        total += e @ np.linalg.solve(p.broadcast.r_lf_covariance_G, e)
    assert 2.6 < total / 400 < 3.4


def test_interpolation_is_a_thousandth_of_a_degree_and_a_millimetre():
    leader = Sailing(80.0, 120.0, 60.0, (1.0, 2.0, 0.0), phase=0.4)
    states = LeaderStates(30.0)
    for k in range(101):
        assert states.add(leader.state(k / 10))
    for t in (0.05, 3.333, 7.777):
        got = states.at(T0 + round(t * 1e9))
        assert np.rad2deg(np.linalg.norm(attitude.log(leader.C_b_e(t).T @ got.C_b_e))) < 1e-3
        assert np.linalg.norm(got.r_e - leader.r_e(t)) < 1e-3
        np.testing.assert_allclose(got.v_e, leader.v_e, atol=1e-4)
    assert states.at(T0 + 10_100_000_000) is None
    assert not states.add(leader.state(5.0))


def test_what_cannot_be_used_is_counted():
    leader = Sailing(80.0, 120.0, 60.0, (1.0, 2.0, 0.0))
    follower = Sailing(80.0, 120.0, 100.0, (1.0, 2.0, 0.0), offset_e=(300.0, 0.0, 0.0))
    good, _, _ = cycle(leader, follower, np.zeros(3), np.eye(3), 1.0)
    cases = {
        'unusable': {'round_trip': 0.01},
        'other_target': {'target': 'somebody'},
        'no_own_state': {'ping_ns': T0 - 5_000_000_000},
    }
    for name, changes in cases.items():
        engine, out = send(leader, ArrayMeasurement(**{**good.__dict__, **changes}), 5.0)
        assert not out
        assert engine.counts == {name: 1}
