"""A leader that navigates by itself: its states, its packets, its absolute fixes. Ring 1."""

import numpy as np
import pytest
from closed_loop import START_NS, World, run
from sailing import T0, Sailing, cycle

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind
from polar_nav_core.engine.outputs import Estimate
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import default_of
from polar_nav_leader.broadcast import position_sigmas
from polar_nav_leader.leader import Leader
from polar_nav_leader.navigation import LeaderEngine, state_of
from polar_nav_leader.params import LeaderParams
from polar_nav_leader.states import LeaderState, LeaderStates


@pytest.fixture(scope='module')
def world():
    return World(8, lat_deg=89.99, lon_deg=-170.0)


def states_of(world, **changes):
    """States of the leader as its session makes them, one for each estimate."""
    engine = LeaderEngine(world.params(LeaderParams, navigation='own', **changes))
    out = []
    for event in sorted([*world.imu(), *world.dvl(), *world.depth()], key=lambda e: e.key):
        for result in engine.process(event):
            assert isinstance(result, Estimate)
            out.append(state_of(result, engine.omega_ib_b()))
    return engine, out


def test_state_is_the_truth_in_earth_axes(world):
    _, states = states_of(world)
    assert len(states) == 80
    for s in states[1:]:
        k = round((s.stamp_ns - START_NS) / 10_000_000)
        C_G_e = grid.ecef_to_grid(world.r_e[k]).T
        np.testing.assert_allclose(s.r_e, world.r_e[k], atol=1e-3)
        np.testing.assert_allclose(s.v_e, C_G_e @ world.v_G[k], atol=1e-4)
        turn = attitude.log(s.C_b_e.T @ C_G_e @ world.C_b_G[k])
        assert np.linalg.norm(turn) < 1e-6
        assert np.linalg.eigvalsh(s.P_r_e)[0] > 0.0
        assert np.linalg.eigvalsh(s.P_phi_e)[0] > 0.0
        assert np.linalg.eigvalsh(s.P_v_e)[0] > 0.0


def test_rate_is_that_of_the_stamp_and_not_of_the_interval_before(world):
    """The last mean lags half an interval: where the rate changes fast that would show."""
    _, states = states_of(world)
    for s in states[2:]:
        k = round((s.stamp_ns - START_NS) / 10_000_000)
        earth_b = world.C_b_G[k].T @ grid.earth_rate(world.r_e[k])
        between = 0.5 * (world.omega[k - 1] + world.omega[min(k, world.n - 1)])
        lag = 0.5 * np.abs(world.omega[min(k, world.n - 1)] - world.omega[k - 1]).max()
        off = np.abs(s.omega_eb_b - (between - earth_b)).max()
        # What is left is the rate's curvature; the lag of a mean would be 1.
        assert off < 0.2 * lag + 1e-8


def test_attitude_covariance_turns_into_earth_axes():
    """Heading is known ten times worse than tilt: the long axis must be the local up."""
    world = World(1, lat_deg=75.0, lon_deg=40.0)
    first = states_of(world)[1][0]
    values, vectors = np.linalg.eigh(first.P_phi_e)
    assert abs(vectors[:, 2] @ earth.up(first.r_e)) > 1.0 - 1e-6
    heading = np.radians(default_of(LeaderParams, 'initial_sigma_heading_deg'))
    assert values[2] == pytest.approx(heading**2, rel=1e-6)


def test_a_restart_breaks_the_line_of_states(world):
    engine, _ = states_of(world)
    assert engine.restarts == 0
    stamp_ns = int(world.stamps[-1]) + 1
    list(engine.process(Command(stamp_ns, 0, CommandKind.RESET, engine.params.initial_state())))
    assert engine.restarts == 1
    states = LeaderStates(30.0)
    zero = np.zeros((3, 3))
    for k in range(2):
        states.add(LeaderState(k, np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3), zero, zero))
    states.clear()
    assert states.newest_ns is None


def test_perfect_sensors_give_the_same_track_as_any_engine(world):
    """The leader's engine only watches: estimates are those of the engine that it extends."""
    params = world.params(LeaderParams, navigation='own')
    events = [*world.imu(), *world.dvl(), *world.depth()]
    for a, b in zip(run(Engine(params), events), run(LeaderEngine(params), events), strict=True):
        np.testing.assert_array_equal(a.r_e, b.r_e)
        np.testing.assert_array_equal(a.P, b.P)


@pytest.mark.parametrize('seed', range(20))
def test_two_sigmas_cover_the_whole_covariance(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-2, 2, size=3)
    P = A @ A.T
    horizontal, vertical = position_sigmas(P)
    rest = np.diag([horizontal**2, horizontal**2, vertical**2]) - P
    assert np.linalg.eigvalsh(rest)[0] > -1e-9 * np.trace(P)
    assert horizontal**2 <= 2.0 * np.linalg.eigvalsh(P[:2, :2])[1] * (1 + 1e-9)


def test_without_correlation_the_sigmas_are_the_half_axes():
    assert position_sigmas(np.diag([9.0, 4.0, 1.0])) == pytest.approx((3.0, 1.0))
    assert position_sigmas(np.zeros((3, 3))) == (0.0, 0.0)


def test_a_packet_that_would_need_a_state_not_there_yet_is_refused_at_start():
    with pytest.raises(ConfigError, match=r'processing_delay_s: 0.1 s is shorter than'):
        LeaderParams(navigation='own', processing_delay_s=0.1)
    LeaderParams(navigation='own', processing_delay_s=0.1, lockstep=True)
    LeaderParams(processing_delay_s=0.1)


def test_fixes_do_not_wait_for_ever_for_a_navigation_that_stopped():
    leader = Sailing(80.0, 120.0, 60.0, (1.0, 2.0, 0.0))
    follower = Sailing(80.0, 120.0, 100.0, (1.0, 2.0, 0.0), offset_e=(300.0, 0.0, 0.0))
    measurement, _, _ = cycle(leader, follower, np.zeros(3), np.eye(3), 1.0)
    node = Leader(LeaderParams(odometry_history_s=5.0))
    node.add_state(leader.state(0.5))
    node.add_measurement(measurement)
    assert not list(node.due(T0 + 4_000_000_000))
    assert node.waiting == 1
    assert not list(node.due(T0 + 9_000_000_000))
    assert (node.waiting, node.counts) == (0, {'no_own_state': 1})


def test_a_packet_leaves_when_its_time_has_come_and_not_with_the_next_state():
    leader = Sailing(80.0, 120.0, 60.0, (1.0, 2.0, 0.0))
    follower = Sailing(80.0, 120.0, 100.0, (1.0, 2.0, 0.0), offset_e=(300.0, 0.0, 0.0))
    measurement, _, t4 = cycle(leader, follower, np.zeros(3), np.eye(3), 1.0)
    node = Leader(LeaderParams())
    node.add_measurement(measurement)
    for k in range(int(t4 * 10) + 2):
        node.add_state(leader.state(k / 10))
    due_ns = measurement.return_ns + 300_000_000
    assert not list(node.due(due_ns - 1))
    (packet,) = node.due(due_ns)
    assert packet.transmit_ns == due_ns
    assert packet.transmit_ns > T0


def test_velocity_sigma_goes_out_with_the_packet():
    leader = Sailing(80.0, 120.0, 60.0, (1.0, 2.0, 0.0))
    follower = Sailing(80.0, 120.0, 100.0, (1.0, 2.0, 0.0), offset_e=(300.0, 0.0, 0.0))
    measurement, _, _ = cycle(leader, follower, np.zeros(3), np.eye(3), 1.0)
    node = Leader(LeaderParams())
    node.add_measurement(measurement)
    for k in range(40):
        s = leader.state(k / 10)
        P_v = np.diag([1e-4, 4e-4, 1e-4])
        node.add_state(
            LeaderState(s.stamp_ns, s.r_e, s.v_e, s.C_b_e, s.omega_eb_b, s.P_r_e, s.P_phi_e, P_v)
        )
    (packet,) = node.due()
    assert packet.broadcast.leader_sigma_velocity == pytest.approx(0.02)
