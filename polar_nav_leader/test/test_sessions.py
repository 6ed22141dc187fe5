"""The leader behind its topics: what is taken, refused, published. Messages, but no node."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip('rclpy')

import leader_messages as messages
from closed_loop import START_NS, World
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix, NavSatStatus

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.link import packet
from polar_nav_leader import convert, session
from polar_nav_leader.params import LeaderParams
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_msg, to_ns
from polar_nav_ros.topics import IMU, RECEIPT, STATE

SECONDS = 6


@pytest.fixture(scope='module')
def world():
    return World(SECONDS, lat_deg=89.9, lon_deg=150.0)


def own(world, **changes):
    return session.OwnSession(world.params(LeaderParams, navigation='own', **changes), 'leader')


def feed(run, world, until_s=SECONDS, extra=()):
    """Published messages by topic; ``extra`` is (after seconds, topic, message)."""
    out = {}
    extra = sorted(extra, key=lambda e: e[0])
    for topic, message in messages.stream(world, until_s):
        now_s = (to_ns(message.header.stamp) - START_NS) * 1e-9
        while extra and extra[0][0] <= now_s:
            _, name, late = extra.pop(0)
            for p in run.take(name, late):
                out.setdefault(p.topic, []).append(p.message)
        for p in run.take(topic, message):
            out.setdefault(p.topic, []).append(p.message)
            if p.topic == STATE:
                out.setdefault('odometry', []).append(run.odometry(p.message))
    for p in run.flush():
        out.setdefault(p.topic, []).append(p.message)
    return out


@pytest.fixture(scope='module')
def sent(world):
    """A run with one fix of the array, whose reply was back after 3 s."""
    run = own(world)
    fix = messages.usbl(int(world.stamps[300]) + 7_000_000)
    return run, feed(run, world, extra=[(3.1, topics.USBL, fix)])


def test_packet_holds_the_own_state_and_its_covariance(world, sent):
    _, out = sent
    (tx,), (content,) = out[topics.TX], out[topics.BROADCAST]
    b = packet.decode(bytes(tx.data), int(world.stamps[-1]))
    k = 300
    moved = 0.007 * grid.ecef_to_grid(world.r_e[k]).T @ world.v_G[k]
    assert np.linalg.norm(b.leader_r_e - world.r_e[k] - moved) < 0.02
    state = min(
        out[STATE],
        key=lambda s: abs(to_ns(s.header.stamp) - b.return_ns),
    )
    P = np.reshape(state.position_covariance_g, (3, 3))
    said = np.diag([b.leader_sigma_horizontal**2] * 2 + [b.leader_sigma_vertical**2])
    assert np.linalg.eigvalsh(said - P)[0] > 0.0
    assert b.leader_sigma_horizontal < 1.07 * 1.06 * np.sqrt(np.linalg.eigvalsh(P[:2, :2])[1])
    heading = np.sqrt(np.reshape(state.attitude_covariance_g, (3, 3))[2, 2])
    assert heading <= b.leader_sigma_heading < 1.07 * heading
    assert content.leader_sigma_velocity > 0.0


def test_attitude_is_in_the_relative_vector_once(world, sent):
    """What the array measured, turned by an uncertain attitude: nothing else, nothing twice."""
    _, out = sent
    (content,) = out[topics.BROADCAST]
    exact = dataclasses.replace(
        LeaderParams(), **{'navigation': 'odometry', 'odometry_history_s': 30.0}
    )
    told = session.OdometrySession(exact, 'leader')
    for odometry in out['odometry']:
        covariance = np.reshape(odometry.pose.covariance, (6, 6)).copy()
        covariance[3:, 3:] = 1e-30 * np.eye(3)
        odometry.pose.covariance = covariance.reshape(36)
        list(told.take(topics.ODOMETRY, odometry))
    fix = messages.usbl(int(world.stamps[300]) + 7_000_000)
    array_only = next(iter(told.take(topics.USBL, fix))).message
    r = np.array(content.r_lf_g)
    states = out[STATE]
    P = np.reshape(states[30].attitude_covariance_g, (3, 3))
    S = attitude.skew(r)
    expected = np.reshape(array_only.r_lf_covariance_g, (3, 3)) + S @ P @ S.T
    np.testing.assert_allclose(
        np.reshape(content.r_lf_covariance_g, (3, 3)), expected, atol=2e-3 * np.trace(expected)
    )
    np.testing.assert_allclose(array_only.r_lf_g, content.r_lf_g, atol=1e-4)


def test_odometry_has_rate_and_covariance_so_another_leader_could_read_it(sent):
    run, out = sent
    params = LeaderParams()
    for odometry in out['odometry'][2:5]:
        state = convert.state_from_msg(odometry, params)
        assert np.isfinite(state.omega_eb_b).all()
        assert np.linalg.eigvalsh(state.P_r_e)[0] > 0.0
        assert np.linalg.eigvalsh(state.P_v_e)[0] > 0.0
    assert run.engine.navigating


def test_transmit_stamp_is_the_processing_delay_after_the_return(world, sent):
    _, out = sent
    (tx,) = out[topics.TX]
    due = int(world.stamps[300]) + 7_000_000 + 300_000_000
    assert to_ns(tx.transmit_time) == due


def test_broadcasts_go_on_from_a_navigation_that_was_restored(world):
    """With the sigma that it then has."""
    run = own(world, max_specific_force=1e300)
    kick = messages.imu(world.imu()[100])
    kick.linear_acceleration.x = 1e200
    kick.header.stamp = to_msg(int(world.stamps[101]) + 1)
    fix = messages.usbl(int(world.stamps[300]))
    out = feed(run, world, extra=[(1.01, IMU, kick), (3.1, topics.USBL, fix)])
    assert run.engine.restored.count == 1
    assert len(out[STATE]) > 25
    assert len(out[topics.TX]) == 1


@pytest.mark.parametrize('lat', [80.0, 89.9999, -75.0])
def test_absolute_fix_is_a_position_in_earth_axes(lat):
    r_e = earth.ecef_from_geodetic(np.radians(lat), np.radians(150.0), -60.0)
    C_e_g = np.linalg.inv(np.column_stack([earth_axis(r_e, k) for k in ('east', 'north', 'up')]))
    covariance_g = np.diag([4.0, 9.0, 16.0])
    fix = convert.absolute_fix_from_msg(messages.absolute(START_NS, r_e, covariance_g), 3)
    assert (fix.validity_ns, fix.receive_ns, fix.sequence) == (START_NS, START_NS, 3)
    np.testing.assert_allclose(fix.r_e, r_e, atol=1e-6)
    np.testing.assert_allclose(C_e_g @ fix.covariance_e @ C_e_g.T, covariance_g, atol=1e-6)


def earth_axis(r_e, name):
    up = earth.up(r_e)
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    return {'east': east, 'north': np.cross(up, east), 'up': up}[name]


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'position_covariance_type': NavSatFix.COVARIANCE_TYPE_UNKNOWN}, 'unknown accuracy'),
        ({'status': NavSatStatus(status=NavSatStatus.STATUS_NO_FIX)}, 'has no position'),
        ({'altitude': float('nan')}, 'not finite'),
        ({'latitude': 91.0}, 'latitude is 91.0 deg'),
        ({'position_covariance': [0.0] * 9}, 'not positive'),
    ],
)
def test_absolute_fix_that_says_too_little_is_refused_with_a_reason(world, change, reason):
    run = own(world)
    message = messages.absolute(int(world.stamps[400]), world.r_e[400], 4.0 * np.eye(3))
    for name, value in change.items():
        setattr(message, name, value)
    out = feed(run, world, extra=[(4.01, topics.ABSOLUTE, message)])
    (receipt,) = out[RECEIPT]
    assert receipt.verdict == Verdict.NOT_FINITE
    assert reason in receipt.reason
    assert receipt.topic == topics.ABSOLUTE


def test_absolute_fixes_are_fused_and_bound_the_error(world):
    params = world.params(LeaderParams, navigation='own')
    moved = dataclasses.replace(
        params, initial_latitude_deg=params.initial_latitude_deg + 2.0 / 111_700.0
    )
    run = session.OwnSession(moved, 'leader')
    fixes = [
        (
            t + 0.01,
            topics.ABSOLUTE,
            messages.absolute(int(world.stamps[100 * t]), world.r_e[100 * t], 0.01 * np.eye(3)),
        )
        for t in range(1, 6)
    ]
    out = feed(run, world, extra=fixes)
    assert [r.verdict for r in out[RECEIPT]] == [Verdict.FUSED] * 5
    last = out[STATE][-1]
    k = round((to_ns(last.header.stamp) - START_NS) / 10**7)
    assert np.linalg.norm(np.array(last.r_e) - world.r_e[k]) < 0.2
    assert np.linalg.norm(np.array(out[STATE][0].r_e) - world.r_e[1]) > 1.9


def test_the_odometrys_own_velocity_covariance_counts_and_else_the_parameter():
    message = Odometry()
    message.pose.pose.position.z = 6.356e6
    P = convert.state_from_msg(message, LeaderParams(velocity_sigma=0.3)).P_v_e
    np.testing.assert_allclose(P, 0.09 * np.eye(3))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([1.0, 2.0, 3.0])
    message.twist.covariance = covariance.reshape(36)
    message.pose.pose.orientation.z = message.pose.pose.orientation.w = np.sqrt(0.5)
    P = convert.state_from_msg(message, LeaderParams(velocity_sigma=0.3)).P_v_e
    np.testing.assert_allclose(np.diag(P), [2.0, 1.0, 3.0], atol=1e-12)
