"""All nodes of the package in one process, in lockstep: nothing lost, right values. Ring 2."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, Imu, NavSatFix
from sim_ros import ros  # noqa: F401 - a fixture of every test

from polar_nav_core.attitude import matrix_from_quaternion
from polar_nav_core.depth import depth_from_pressure
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import earth_rate
from polar_nav_core.params import NodeParams
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl, UsblFix, VehicleTruth
from polar_nav_ros.node import PolarNode
from polar_nav_ros.qos import DATA_QOS
from polar_nav_ros.stamps import to_msg, to_ns
from polar_nav_sim.mission import load_mission
from polar_nav_sim.nodes.absolute_fix_node import AbsoluteFixNode
from polar_nav_sim.nodes.acoustic_link_node import AcousticLinkNode
from polar_nav_sim.nodes.ahrs_node import AhrsNode
from polar_nav_sim.nodes.depth_node import DepthNode
from polar_nav_sim.nodes.dvl_node import DvlNode
from polar_nav_sim.nodes.imu_node import ImuNode
from polar_nav_sim.nodes.leader_reference_node import LeaderReferenceNode
from polar_nav_sim.nodes.truth_node import TruthNode
from polar_nav_sim.nodes.usbl_node import UsblNode
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.compass import CompassErrors, CompassSensor
from polar_nav_sim.sensors.dvl import DvlErrors, DvlSensor
from polar_nav_sim.sensors.imu import ImuErrors, ImuSensor
from polar_nav_sim.sensors.noise import CHUNK
from polar_nav_sim.truth_cdr import decode, encode

SECONDS = 4.0
# The real floor is out of reach of a DVL: its pings are wanted here.
LOCK = 'bottom_lock=assumed'
MISSION = (
    load_mission('near_pole').with_overrides({'bottom_lock': 'assumed'}).with_duration(SECONDS)
)
SAMPLES = 401
ABSOLUTE = {
    'period_s': 0.5,
    'horizontal_sigma_m': 2.0,
    'vertical_sigma_m': 0.0,
    'lever_b': [1.0, 0.0, 0.5],
    'first_s': 0.4,
    'available_s': 0.8,
    'repeat_s': 2.0,
}
TOPICS = {
    '/leader/truth': VehicleTruth,
    '/follower/truth': VehicleTruth,
    '/clock': Clock,
    '/follower/imu/data_raw': Imu,
    '/follower/dvl/data': Dvl,
    '/follower/dvl/twist': TwistWithCovarianceStamped,
    '/follower/depth/data': Depth,
    '/follower/depth/pressure': FluidPressure,
    '/follower/ahrs/imu': Imu,
    '/leader/usbl/fix': UsblFix,
    '/leader/odometry': Odometry,
    '/leader/absolute/fix': NavSatFix,
    '/follower/acomms/rx': AcousticPacket,
    '/diagnostics': DiagnosticArray,
}


def overrides(**values):
    return [Parameter(name, value=value) for name, value in values.items()]


def make(cls, namespace='', **values):
    return cls(namespace=namespace, parameter_overrides=overrides(**values))


def packet(n, after_s):
    msg = AcousticPacket(source='leader', destination='follower', sequence=n, data=bytes([n] * 32))
    msg.transmit_time = msg.header.stamp = to_msg(MISSION.start_ns + round(after_s * 1e9))
    return msg


@pytest.fixture(scope='module')
def run():
    """Everything that was published in one short mission, by topic."""
    nodes = [
        make(ImuNode, 'follower', lockstep=True, seed=7),
        make(DvlNode, 'follower', lockstep=True, seed=7),
        make(DepthNode, 'follower', lockstep=True, seed=7, noise_sigma_m=0.0),
        make(AhrsNode, 'follower', lockstep=True, seed=7, reference='grid'),
        make(UsblNode, 'leader', lockstep=True, seed=7, first_ping_s=0.5, period_s=1.0),
        make(LeaderReferenceNode, 'leader', lockstep=True, seed=7),
        make(AbsoluteFixNode, 'leader', lockstep=True, seed=7, **ABSOLUTE),
        make(AcousticLinkNode, lockstep=True, seed=7),
    ]
    # The modem's own packets count too: it takes part in the lockstep.
    peer = PolarNode('peer', NodeParams, parameter_overrides=overrides(lockstep=True))
    nodes.append(peer)
    got = {topic: [] for topic in TOPICS}
    for topic, kind in TOPICS.items():
        peer.create_subscription(kind, topic, got[topic].append, DATA_QOS)
    tx = peer.advertise(AcousticPacket, '/leader/acomms/tx')
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    end = time.monotonic() + 30.0
    while tx.matched < 1 and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    for n, after_s in ((0, 0.5), (1, 1.5), (2, 3.9)):
        tx.publish(packet(n, after_s))
    truth = make(
        TruthNode,
        mission='near_pole',
        overrides=[LOCK],
        duration_s=SECONDS,
        pace='lockstep',
        exit_at_end=True,
        expected_nodes=[n.get_fully_qualified_name() for n in nodes],
    )
    executor.add_node(truth)
    while truth.ended is None and time.monotonic() < end + 60.0:
        executor.spin_once(timeout_sec=0.1)
    assert truth.ended == 0
    executor.remove_node(truth)
    nodes[-2].close()
    counts = {k: v for n in [truth, *nodes] for k, v in n.published_counts().items()}
    while time.monotonic() < end + 60.0 and any(len(got[t]) < counts.get(t, 0) for t in TOPICS):
        executor.spin_once(timeout_sec=0.1)
    for _ in range(5):
        executor.spin_once(timeout_sec=0.05)
    for node in [truth, *nodes]:
        node.destroy_node()
    return got


def test_nothing_is_lost_and_counts_are_right(run):
    expected = {
        '/leader/truth': SAMPLES,
        '/follower/truth': SAMPLES,
        '/clock': SAMPLES,
        '/follower/imu/data_raw': SAMPLES - 1,
        '/follower/dvl/data': 21,
        '/follower/dvl/twist': 21,
        '/follower/depth/data': 41,
        '/follower/depth/pressure': 41,
        '/follower/ahrs/imu': 41,
        '/leader/odometry': 41,
        '/leader/usbl/fix': 3,  # the reply to the ping at 3.5 s is not back in time
        '/leader/absolute/fix': 4,  # two in each of two windows
        '/follower/acomms/rx': 2,
    }
    assert {t: len(run[t]) for t in expected} == expected


def test_imu_is_the_model_bit_for_bit(run):
    block = MISSION.truth('follower').samples(1, SAMPLES)
    sensor = ImuSensor(ImuErrors(), 0.01, stream(7, 'follower/imu'))
    omega, f = sensor.measure(1, block.delta_theta_b, block.delta_v_b)
    messages = run['/follower/imu/data_raw']
    assert [to_ns(m.header.stamp) for m in messages] == block.stamp_ns.tolist()
    got = [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in messages]
    assert np.array_equal(got, omega)
    last = messages[-1]
    assert last.linear_acceleration.z == f[-1, 2]
    assert last.linear_acceleration.z > 9.0
    assert last.header.frame_id == 'follower/imu'
    assert last.orientation_covariance[0] == -1.0
    density = ImuErrors().gyro_noise_density[0]
    assert last.angular_velocity_covariance[0] == pytest.approx(density**2 / 0.01)


def test_the_ahrs_is_the_model_bit_for_bit(run):
    trajectory = MISSION.truth('follower')
    sensor = CompassSensor(CompassErrors(), 'grid', 0.1, stream(7, 'follower/compass'))
    for k, m in enumerate(run['/follower/ahrs/imu']):
        s = trajectory.state(to_ns(m.header.stamp))
        reading = sensor.measure(k, to_ns(m.header.stamp), s.r_e, s.C_b_G, s.v_G)
        q = m.orientation
        got = matrix_from_quaternion([q.x, q.y, q.z, q.w])
        np.testing.assert_allclose(got, reading.attitude(), atol=1e-9)
        # In grid axes it is base_link's own attitude, to a few degrees.
        assert np.degrees(np.arccos(0.5 * (np.trace(got @ s.C_b_G.T) - 1.0))) < 8.0
    assert m.header.frame_id == 'follower/ahrs'


def test_absolute_fixes_come_in_their_windows_with_the_noise_they_state(run):
    trajectory = MISSION.truth('leader')
    noise = stream(7, 'leader/absolute').standard_normal((CHUNK, 3))
    found = []
    for m in run['/leader/absolute/fix']:
        stamp_ns = to_ns(m.header.stamp)
        s = trajectory.state(stamp_ns)
        found.append((stamp_ns - MISSION.start_ns) * 1e-9)
        r_e = ecef_from_geodetic(np.radians(m.latitude), np.radians(m.longitude), m.altitude)
        error_G = s.C_e_G @ (r_e - s.r_e) - s.C_b_G @ [1.0, 0.0, 0.5]
        k = round(found[-1] / 0.5)
        np.testing.assert_allclose(error_G, noise[k] * [2.0, 2.0, 0.0], atol=1e-6)
        assert m.position_covariance.tolist() == [4.0, 0, 0, 0, 4.0, 0, 0, 0, 0.0]
        assert m.position_covariance_type == NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    assert found == pytest.approx([0.5, 1.0, 2.5, 3.0])


def test_dvl_and_depth_are_the_models(run):
    trajectory = MISSION.truth('follower')
    sensor = DvlSensor(DvlErrors(), 0.2, stream(7, 'follower/dvl'))
    for k, m in enumerate(run['/follower/dvl/data']):
        assert to_ns(m.header.stamp) == MISSION.start_ns + k * 200_000_000
        s = trajectory.state(to_ns(m.header.stamp))
        omega_eb_b = s.omega_ib_b - s.C_b_G.T @ earth_rate(s.r_e)
        ping = sensor.measure(k, s.C_b_G.T @ s.v_G, omega_eb_b)
        assert [m.velocity.x, m.velocity.y, m.velocity.z] == pytest.approx(
            ping.velocity_m.tolist()
        )
        assert m.velocity_covar[0] == pytest.approx(0.005**2)
        assert (m.num_good_beams, m.velocity_mode) == (4, Dvl.DVL_MODE_BOTTOM)
        assert math.isnan(m.altitude)
    assert m.header.frame_id == 'follower/dvl'
    for depth, pressure in zip(
        run['/follower/depth/data'], run['/follower/depth/pressure'], strict=True
    ):
        s = trajectory.state(to_ns(depth.header.stamp))
        assert depth.depth == pytest.approx(float(s.depth), abs=1e-8)
        back = depth_from_pressure(pressure.fluid_pressure, float(s.lat))
        assert back == pytest.approx(depth.depth, abs=1e-6)


def test_odometry_is_truth_in_earth_axes(run):
    for m in run['/leader/odometry']:
        s = MISSION.truth('leader').state(to_ns(m.header.stamp))
        p, q = m.pose.pose.position, m.pose.pose.orientation
        assert [p.x, p.y, p.z] == pytest.approx(s.r_e.tolist(), abs=1e-8)
        C_b_e = matrix_from_quaternion([q.x, q.y, q.z, q.w])
        assert np.abs(C_b_e - s.C_e_G.T @ s.C_b_G).max() < 1e-12
        v = m.twist.twist.linear
        assert np.abs(s.C_b_G @ [v.x, v.y, v.z] - s.v_G).max() < 1e-12
        assert (m.header.frame_id, m.child_frame_id) == ('earth', 'leader/base_link')


def test_usbl_fix_dates_t3_and_points_at_the_follower(run):
    for n, m in enumerate(run['/leader/usbl/fix']):
        assert (m.sequence, m.source, m.target) == (n, 'leader', 'follower')
        t1, t3, t4 = (to_ns(t) for t in (m.ping_time, m.header.stamp, m.return_time))
        assert t1 == MISSION.start_ns + 500_000_000 + n * 1_000_000_000
        leader, follower = MISSION.truth('leader').state(t4), MISSION.truth('follower').state(t3)
        line_e = follower.r_e - leader.r_e
        distance = np.linalg.norm(line_e)
        line_b = leader.C_b_G.T @ leader.C_e_G @ line_e / distance
        assert [m.direction.x, m.direction.y] == pytest.approx(line_b[:2].tolist(), abs=5e-3)
        assert m.range == pytest.approx(distance, abs=3.0)
        assert (t4 - t3) * 1e-9 == pytest.approx(distance / 1440.0, abs=1e-8)


def test_packets_arrive_late_and_whole_and_the_rest_is_named(run):
    for n, m in enumerate(run['/follower/acomms/rx']):
        assert (m.sequence, m.source, m.destination) == (n, 'leader', 'follower')
        assert bytes(m.data) == bytes([n] * 32)
        assert m.header.stamp == m.transmit_time
        delay_s = (to_ns(m.receive_time) - to_ns(m.transmit_time)) * 1e-9
        # 256 bits at 1000 bit/s, 600 m of water, 0.1 s of detection.
        assert delay_s == pytest.approx(0.256 + 601.3 / 1440.0 + 0.1, abs=2e-3)
    final = [
        {v.key: v.value for v in a.status[0].values}
        for a in run['/diagnostics']
        if a.status[0].name == '/acoustic_link_node'
    ][-1]
    assert final['in_flight'] == '1'
    assert final['in_flight_packets'].startswith('leader->follower#2@')
    assert final['delivered'] == '2'


def test_dvl_node_sends_its_beams():
    mission = MISSION.with_overrides({'sea_floor_depth_m': 150.0})
    sample = decode(encode(mission.truth('follower').samples(0, 1))[0])
    node = make(DvlNode, 'follower', four_beams=True, beam_noise_sigma=0.0, max_altitude_m=60.0)
    sent = []
    try:
        node._data = node._twist = SimpleNamespace(publish=sent.append)
        node.measure(0, sample)
    finally:
        node.destroy_node()
    dvl, twist = sent
    assert (dvl.num_good_beams, dvl.beam_velocities_valid, dvl.beam_ranges_valid) == (
        4,
        True,
        True,
    )
    v = dvl.velocity
    for b, s in zip(dvl.beam_unit_vec, dvl.beam_velocity, strict=True):
        assert b.x * v.x + b.y * v.y + b.z * v.z == pytest.approx(s, abs=1e-12)
    assert dvl.altitude == pytest.approx(50.0, abs=0.3)
    assert twist.twist.twist.linear == v


def test_truth_node_follows_a_track_as_recorded():
    node = make(TruthNode, mission='near_pole', overrides=['path.as_recorded=true'])
    try:
        recorded = load_mission('near_pole').with_overrides({'path.as_recorded': True})
        mission = node._mission
        assert mission.path.as_recorded
        assert mission.start_ns == recorded.start_ns == 1597867217 * 10**9  # 2020-08-19T20:00:17Z
    finally:
        node.destroy_node()


def test_bad_parameters_stop_a_node():
    for cls, values, words in (
        (UsblNode, {'targets': ['leader']}, 'targets'),
        (AcousticLinkNode, {'vehicles': ['leader']}, 'vehicles'),
        (TruthNode, {'mission': 'nowhere'}, 'nowhere'),
        (TruthNode, {'overrides': ['path.speed=3']}, 'speed'),
        (ImuNode, {'gyro_bias_dph': [0.0, 0.0]}, 'gyro_bias_dph'),
        (DvlNode, {'rate_hz': -1.0}, 'rate_hz'),
    ):
        with pytest.raises(ConfigError, match=words):
            make(cls, 'leader', **values)
