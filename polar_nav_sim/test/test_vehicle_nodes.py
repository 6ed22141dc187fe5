"""Station mission in one process, in lockstep: vehicle, station, AHRS, link, commands. Ring 2."""

import math
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu
from sim_ros import ros  # noqa: F401 - a fixture of every test

from polar_nav_core.attitude import matrix_from_quaternion
from polar_nav_core.errors import ConfigError
from polar_nav_core.link.station_packet import decode as read_packet
from polar_nav_core.params import NodeParams
from polar_nav_msgs.msg import (
    AcousticPacket,
    Depth,
    Setpoint,
    StationFix,
    VehicleModel,
    VehicleTruth,
)
from polar_nav_ros.node import PolarNode
from polar_nav_ros.qos import DATA_QOS
from polar_nav_ros.stamps import to_ns
from polar_nav_sim.mission import load_mission
from polar_nav_sim.nodes.acoustic_link_node import AcousticLinkNode
from polar_nav_sim.nodes.depth_node import DepthNode
from polar_nav_sim.nodes.imu_node import ImuNode
from polar_nav_sim.nodes.station_node import StationNode
from polar_nav_sim.nodes.truth_node import TruthNode
from polar_nav_sim.nodes.vehicle_node import VehicleNode
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.ahrs import AhrsErrors, AhrsSensor
from polar_nav_sim.truth_cdr import decode, encode

SECONDS, WINDOW = 6.0, 20
TOLD, PUSHED = 300, 420
"""Samples at which the commander speaks."""
WANTED = {'heading': math.nan, 'pitch': math.nan, 'depth': 21.0, 'speed': 0.7}
MISSION = load_mission('station').with_duration(SECONDS)
TOPICS = {
    '/auv/truth': VehicleTruth,
    '/station/truth': VehicleTruth,
    '/auv/control/thrust': WrenchStamped,
    '/auv/truth/model': VehicleModel,
    '/auv/imu/data_raw': Imu,
    '/auv/imu/data': Imu,
    '/auv/depth/data': Depth,
    '/station/station/fix': StationFix,
    '/auv/acomms/rx': AcousticPacket,
}


def make(cls, namespace='', **values):
    return cls(
        namespace=namespace, parameter_overrides=[Parameter(k, value=v) for k, v in values.items()]
    )


class Commander(PolarNode[NodeParams]):
    """Says something at two samples of truth, as a guidance node would."""

    def __init__(self, **kwargs):
        super().__init__('commander', NodeParams, **kwargs)
        self.setpoint = self.advertise(Setpoint, '/auv/control/setpoint')
        self.push = self.advertise(WrenchStamped, '/auv/control/thrust_command')
        self.subscribe(VehicleTruth, '/auv/truth', self._on_truth, raw=True)

    def _on_truth(self, data):
        sample = decode(data)
        if sample.sequence == TOLD:
            self.setpoint.publish(Setpoint(**WANTED))
        if sample.sequence == PUSHED:
            message = WrenchStamped()
            message.wrench.force.x = 80.0
            self.push.publish(message)


@pytest.fixture(scope='module')
def run():
    """Everything that was published in one short mission, by topic."""
    nodes = [
        make(ImuNode, 'auv', lockstep=True, seed=7, ahrs=True),
        make(DepthNode, 'auv', lockstep=True, seed=7, uniform_error_m=0.05, noise_sigma_m=0.0),
        make(StationNode, 'station', lockstep=True, seed=7, sound_speed=1500.0, own_id=9),
        make(
            AcousticLinkNode,
            lockstep=True,
            seed=7,
            vehicles=['station', 'auv'],
            sound_speed=1500.0,
            detection_delay_s=0.0,
        ),
        make(Commander, lockstep=True),
    ]
    peer = make(lambda **k: PolarNode('peer', NodeParams, **k))
    got = {topic: [] for topic in TOPICS}
    for topic, kind in TOPICS.items():
        peer.create_subscription(kind, topic, got[topic].append, DATA_QOS)
    truth = make(
        VehicleNode,
        duration_s=SECONDS,
        pace='lockstep',
        window_s=WINDOW * 0.01,
        exit_at_end=True,
        commands=True,
        command_timeout_s=0.5,
        expected_nodes=[n.get_fully_qualified_name() for n in nodes],
    )
    executor = SingleThreadedExecutor()
    for node in (*nodes, peer, truth):
        executor.add_node(node)
    end = time.monotonic() + 60.0
    while truth.ended is None and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    assert truth.ended == 0
    executor.remove_node(truth)
    counts = {k: v for n in [truth, *nodes] for k, v in n.published_counts().items()}
    while time.monotonic() < end and any(len(got[t]) < counts.get(t, 0) for t in TOPICS):
        executor.spin_once(timeout_sec=0.1)
    for node in [truth, peer, *nodes]:
        node.destroy_node()
    return got


@pytest.fixture(scope='module')
def expected():
    """The same motion made without nodes.

    A command is taken before the window after the one that led to it; by then all steps up to that
    window's last sample are made.
    """
    truth = MISSION.with_overrides({}).dynamics('auv')

    def made_at(k):
        return (k // WINDOW + 1) * WINDOW - 1

    truth.motion.advance(made_at(TOLD))
    truth.motion.want(*WANTED.values())
    truth.motion.advance(made_at(PUSHED))
    truth.motion.push(np.array([80.0, 0, 0, 0, 0, 0]))
    # The hold counts from the first sample of the window to come.
    truth.motion.advance(made_at(PUSHED) + 50)
    truth.motion.push(None)
    truth.state(MISSION.end_ns)
    return truth


def test_the_vehicle_moves_as_its_model_and_its_commands_say(run, expected):
    assert len(run['/auv/truth']) == len(run['/station/truth']) == 601
    states = expected.samples(0, 601)
    np.testing.assert_array_equal([m.r_e for m in run['/auv/truth']], states.state.r_e)
    np.testing.assert_array_equal([m.delta_v_b for m in run['/auv/truth']], states.delta_v_b)
    np.testing.assert_array_equal([m.current_g for m in run['/auv/truth']], states.state.current_G)
    quiet = MISSION.with_overrides({}).dynamics('auv').state(MISSION.end_ns)
    assert np.linalg.norm(states.state.r_e[-1] - quiet.r_e) > 0.1


def test_thrust_and_model_are_told(run, expected):
    thrust = run['/auv/control/thrust']
    assert len(thrust) == 61
    for m in thrust:
        assert m.header.frame_id == 'auv/base_link'
        tau = expected.thrust(to_ns(m.header.stamp))
        assert [m.wrench.force.x, m.wrench.force.z, m.wrench.torque.z] == tau[[0, 2, 5]].tolist()
    assert [round(m.wrench.force.x, 6) == 80.0 for m in thrust].count(True) == 5
    models = run['/auv/truth/model']
    assert len(models) == 7
    for m in models:
        v_r_b = expected.velocity_through_water(to_ns(m.header.stamp))
        np.testing.assert_allclose(m.v_r_b, v_r_b, atol=1e-12)
        assert (m.drag_linear, m.drag_quadratic) == (25.0, 19.0)
        np.testing.assert_allclose(m.current_g, [0.4, 0.25, 0.0], atol=2e-4)
        assert not np.any(m.current_covariance_g)


def test_the_ahrs_is_the_model_bit_for_bit(run, expected):
    block = expected.samples(1, 601)
    raw, with_attitude = run['/auv/imu/data_raw'], run['/auv/imu/data']
    assert len(raw) == len(with_attitude) == 600
    rates = np.array(
        [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in raw]
    )
    sensor = AhrsSensor(AhrsErrors(), stream(7, 'auv/ahrs'))
    omega, C_b_G = sensor.measure(1, rates, block.state.C_b_G)
    for k in (0, 300, 599):
        m = with_attitude[k]
        q, w = m.orientation, m.angular_velocity
        got = matrix_from_quaternion([q.x, q.y, q.z, q.w])
        np.testing.assert_allclose(got, C_b_G[k], atol=1e-12)
        assert [w.x, w.y, w.z] == omega[k].tolist()
        assert m.header.stamp == raw[k].header.stamp
        assert m.linear_acceleration == raw[k].linear_acceleration
        assert m.orientation_covariance[0] == pytest.approx(0.02**2 / 3)
    assert raw[0].orientation_covariance[0] == -1.0


def test_depth_has_the_papers_error(run, expected):
    errors = [
        m.depth - float(expected.state(to_ns(m.header.stamp)).depth)
        for m in run['/auv/depth/data']
    ]
    assert 0.03 < max(map(abs, errors)) <= 0.05
    assert run['/auv/depth/data'][0].variance == pytest.approx(0.05**2 / 3)


def test_fixes_and_packets_go_through_the_link(run, expected):
    fixes, packets = run['/station/station/fix'], run['/auv/acomms/rx']
    assert [m.sequence for m in fixes] == [0, 1]
    assert len(packets) == 2
    station = MISSION.truth('station').state(MISSION.start_ns)
    for n, (m, p) in enumerate(zip(fixes, packets, strict=True)):
        assert (m.source, m.target, m.header.frame_id) == ('station', 'auv', 'station')
        t1, t3, t4 = (to_ns(t) for t in (m.ping_time, m.header.stamp, m.return_time))
        line = station.C_e_G @ (expected.state(t3).r_e - station.r_e)
        distance = np.linalg.norm(line)
        assert t1 == MISSION.start_ns + n * 2_500_000_000
        assert (t4 - t3) * 1e-9 == pytest.approx(distance / 1500.0, abs=1e-8)
        assert abs(m.range - distance) <= 0.01 * distance + 1.0
        bearing = math.atan2(line[1], line[0]) - 0.3
        assert abs(math.remainder(m.bearing - bearing, 2 * math.pi)) <= math.radians(1.25)
        assert m.station_heading == pytest.approx(0.3, abs=1e-9)
        assert to_ns(p.transmit_time) == t4 + 200_000_000
        delay_s = (to_ns(p.receive_time) - t3) * 1e-9
        assert delay_s == pytest.approx(2 * distance / 1500.0 + 0.02 + 0.2, abs=2e-3)
        assert (p.source, p.destination, p.sequence, len(p.data)) == ('station', 'auv', n, 24)
        told = read_packet(bytes(p.data), to_ns(p.receive_time))
        assert (told.source, told.target, told.sequence) == (9, 2, n)
        assert told.range == pytest.approx(m.range, abs=1e-9)
        assert abs(told.validity_ns - t3) <= 50_000


def test_the_truth_node_sails_such_missions_too():
    node = make(TruthNode, mission='model_aided', duration_s=5.0)
    try:
        assert '/follower/control/thrust' in node.published_counts()
        assert not [t for t in node.taken_counts() if 'control' in t]
    finally:
        node.destroy_node()


def test_commands_that_are_no_numbers_are_refused():
    node = make(VehicleNode, duration_s=5.0, commands=True)
    try:
        before = node.mission.dynamics('auv').motion._wrench.copy()
        bad = WrenchStamped()
        bad.wrench.force.x = math.nan
        node._vehicles._on_thrust('auv', bad)
        node._vehicles._on_setpoint('auv', Setpoint(depth=math.inf))
        assert node._vehicles.refused == 2
        np.testing.assert_array_equal(node.mission.dynamics('auv').motion._wrench, before)
    finally:
        node.destroy_node()


def test_bad_parameters_stop_a_node():
    for cls, values, words in (
        (VehicleNode, {'mission': 'demo'}, 'no vehicle with dynamics'),
        (StationNode, {'target': 'station'}, 'target'),
        (StationNode, {'when_short': 'hope'}, 'when_short'),
    ):
        with pytest.raises(ConfigError, match=words):
            make(cls, 'station', **values)


def test_a_period_too_short_stops_the_station():
    node = make(StationNode, 'station', period_s=1.5, sound_speed=1500.0)
    own, other = (
        encode(MISSION.with_overrides({}).truth(v).samples(0, 200)) for v in ('station', 'auv')
    )

    def listen():
        for a, b in zip(own, other, strict=True):
            node._on_truth(node._own, a)
            node._on_truth(node._target, b)

    try:
        with pytest.raises(ConfigError, match=r'period_s: 1\.5 s is shorter'):
            listen()
    finally:
        node.destroy_node()
