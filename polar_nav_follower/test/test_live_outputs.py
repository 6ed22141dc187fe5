"""A follower node in process: odometry now, local frames, transforms that fit together. Ring 2."""

import math
import os
import time

import numpy as np
import pytest
import test_live_views

rclpy = pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_msgs.msg import String, UInt32  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from polar_nav_core import attitude, earth  # noqa: E402
from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_core.local_frame import LocalFrame, frame_of_yaml  # noqa: E402
from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_msgs.msg import Depth, NavState  # noqa: E402
from polar_nav_ros import transforms  # noqa: E402
from polar_nav_ros.qos import DATA_QOS, LATCHED_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg, to_ns  # noqa: E402
from polar_nav_ros.topics import TYPES  # noqa: E402

START_NS = 1_772_323_200_000_000_000
needs_tf2 = pytest.mark.skipif(transforms.TFMessage is None, reason=transforms.NO_TF)


@pytest.fixture
def ros(monkeypatch):
    """Context of a test with the nodes that it makes, all gone at its end."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    nodes = []

    def start(*parameters):
        args = ['--ros-args', '-r', '__ns:=/auv', '-p', 'initialize:=parameters']
        for parameter in parameters:
            args += ['-p', parameter]
        rclpy.init(args=args, domain_id=20 + os.getpid() % 20)
        nodes.append(FollowerNode())
        nodes.append(rclpy.create_node('peer', use_global_arguments=False))
        return nodes

    yield start
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


class Rig:
    """A follower node, someone who feeds it, and someone who listens."""

    def __init__(self, nodes, latched=()):
        self.node, self.peer = nodes
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.heard = {}
        self._listen(Odometry, 'odometry/now', DATA_QOS)
        self._listen(Odometry, 'odometry/local', DATA_QOS)
        self._listen(Odometry, 'odometry', DATA_QOS)
        self._listen(Depth, 'odometry/depth', DATA_QOS)
        self._listen(NavState, 'nav/state', DATA_QOS)
        for kind, topic, qos in latched:
            self._listen(kind, topic, qos)
        self.imu = self.peer.create_publisher(Imu, '/auv/imu/data_raw', DATA_QOS)
        self.reset = self.peer.create_client(Trigger, '/auv/follower_node/reset')
        self.stamp_ns, self._sent = START_NS, 0
        self.until(lambda: self.imu.get_subscription_count() == 1)
        self.until(lambda: self.node.count_subscribers('/auv/odometry/now') == 1)
        self.until(self.reset.service_is_ready)

    def _listen(self, kind, topic, qos):
        found = self.heard.setdefault(topic, [])
        name = topic if topic.startswith('/') else f'/auv/{topic}'
        self.peer.create_subscription(kind, name, found.append, qos)

    def until(self, done, seconds=30.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def sail(self, samples, omega_b=(0.0, 0.0, 0.05)):
        """Give IMU samples of a vehicle that turns and speeds up, one by one."""
        for _ in range(samples):
            self.stamp_ns += 10_000_000
            message = Imu()
            message.header.stamp = to_msg(self.stamp_ns)
            a, w = message.linear_acceleration, message.angular_velocity
            a.x, a.y, a.z = 0.2, 1e-6 * (self._sent % 7), 9.83
            w.x, w.y, w.z = omega_b
            self.imu.publish(message)
            self._sent += 1
            self.until(lambda: self.node.taken_counts()['/auv/imu/data_raw'] == self._sent)

    def heard_until(self, topic, stamp_ns):
        found = self.heard[topic]
        self.until(lambda: found and to_ns(found[-1].header.stamp) == stamp_ns)
        return found


def pose_of(message):
    p, q = message.pose.pose.position, message.pose.pose.orientation
    T = np.eye(4)
    T[:3, :3] = attitude.matrix_from_quaternion([q.x, q.y, q.z, q.w])
    T[:3, 3] = p.x, p.y, p.z
    return T


def matrix_of(transform):
    p, q = transform.transform.translation, transform.transform.rotation
    T = np.eye(4)
    T[:3, :3] = attitude.matrix_from_quaternion([q.x, q.y, q.z, q.w])
    T[:3, 3] = p.x, p.y, p.z
    return T


def test_odometry_now_stands_at_the_newest_sample_and_is_what_the_state_is_later(ros):
    rig = Rig(ros('reorder_window_s:=0.05'), latched=[(String, 'nav/origin', LATCHED_QOS)])
    rig.sail(60)
    found = rig.heard_until('odometry/now', rig.stamp_ns)
    assert len(found) >= 50
    stamps_ns = np.array([to_ns(m.header.stamp) for m in found])
    np.testing.assert_array_equal(np.diff(stamps_ns), 10_000_000)
    assert {m.header.frame_id for m in found} == {'auv/map'}
    assert {m.child_frame_id for m in found} == {'auv/base_link'}
    for m in (*found, *rig.heard['odometry/local'], *rig.heard['odometry']):
        assert np.isfinite(m.pose.covariance).all()
        assert np.isfinite(m.twist.covariance).all()
        assert np.linalg.eigvalsh(np.reshape(m.pose.covariance, (6, 6))).min() > 0.0
        assert np.linalg.eigvalsh(np.reshape(m.twist.covariance, (6, 6))).min() > 0.0
    rig.until(lambda: rig.heard['nav/origin'])
    frame = frame_of_yaml(rig.heard['nav/origin'][0].data)
    by_stamp = {to_ns(m.header.stamp): m for m in found}
    state = rig.heard['nav/state'][-1]
    there = pose_of(by_stamp[to_ns(state.header.stamp)])
    np.testing.assert_allclose(there[:3, 3], frame.position(state.r_e), atol=1e-6)
    depth = rig.heard_until('odometry/depth', rig.stamp_ns)[-1]
    assert depth.depth == pytest.approx(-there[2, 3], abs=0.05)
    assert found[-1].twist.twist.angular.z == pytest.approx(0.05, abs=1e-3)


@needs_tf2
def test_the_transforms_compose_to_the_published_pose(ros):
    static = transforms._qos(1, transforms.DurabilityPolicy.TRANSIENT_LOCAL)
    moving = transforms._qos(100, transforms.DurabilityPolicy.VOLATILE)
    rig = Rig(
        ros('dvl_lever_b:=[1.0, 2.0, -0.5]', 'dvl_rpy_deg:=[0.0, 0.0, 45.0]'),
        latched=[
            (transforms.TFMessage, '/tf', moving),
            (transforms.TFMessage, '/tf_static', static),
        ],
    )
    rig.sail(60)
    last = rig.heard_until('odometry/now', rig.stamp_ns)[-1]
    tf = rig.heard['/tf']
    rig.until(lambda: tf and to_ns(tf[-1].transforms[0].header.stamp) == rig.stamp_ns)
    parts = {
        (t.header.frame_id, t.child_frame_id): matrix_of(t)
        for t in (*rig.heard['/tf_static'][-1].transforms, *tf[-1].transforms)
    }
    chain = [
        parts[pair]
        for pair in (
            ('earth', 'auv/map'),
            ('auv/map', 'auv/odom'),
            ('auv/odom', 'auv/base_link'),
        )
    ]
    np.testing.assert_allclose(chain[1] @ chain[2], pose_of(last), atol=1e-9)
    local = rig.heard_until('odometry/local', rig.stamp_ns)[-1]
    np.testing.assert_allclose(chain[2], pose_of(local), atol=1e-12)
    state = rig.heard['nav/state'][-1]
    stamp_ns = to_ns(state.header.stamp)
    [then] = [m for m in tf if to_ns(m.transforms[0].header.stamp) == stamp_ns]
    in_earth = chain[0] @ matrix_of(then.transforms[0]) @ matrix_of(then.transforms[1])
    np.testing.assert_allclose(in_earth[:3, 3], state.r_e, atol=1e-6)
    [odometry] = [m for m in rig.heard['odometry'] if to_ns(m.header.stamp) == stamp_ns]
    np.testing.assert_allclose(in_earth, pose_of(odometry), atol=1e-6)
    dvl = parts[('auv/base_link', 'auv/dvl')]
    np.testing.assert_allclose(dvl[:3, 3], [1.0, 2.0, -0.5])
    np.testing.assert_allclose(dvl[:3, 0], [math.sqrt(0.5), math.sqrt(0.5), 0.0], atol=1e-12)
    ned = parts[('auv/map', 'auv/map_ned')]
    np.testing.assert_allclose(ned[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)


def test_all_that_the_shipped_views_name_is_published_in_its_type(ros):
    """RViz and Foxglove ask for reliable messages, of what the node publishes."""
    node, _peer = ros()
    rviz, _ = test_live_views.named(test_live_views.rviz())
    layout, _ = test_live_views.named(test_live_views.foxglove())
    heard = {'/follower/initialpose'}
    shown = {t for t in rviz | layout if not t.startswith('/studio_script/')} - heard
    assert len(shown) == 8
    for topic in shown:
        name = topic.replace('/follower/', '/auv/')
        [publisher] = [
            i for i in node.get_publishers_info_by_topic(name) if i.node_name == node.get_name()
        ]
        assert publisher.topic_type == test_live_views.type_of(topic), name
        assert publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    [subscription] = node.get_subscriptions_info_by_topic('/auv/initialpose')
    assert subscription.topic_type == 'geometry_msgs/msg/PoseWithCovarianceStamped'
    for topic in ('/tf', '/tf_static'):
        if transforms.TFMessage is not None:
            [publisher] = node.get_publishers_info_by_topic(topic)
            assert publisher.topic_type == TYPES[topic]


def ned_frd(message, static):
    """What MAVROS' plugin odometry makes of a message: position, quaternion, velocities, rows.

    Read in its source (mavros_extras 2.12, plugins/odom.cpp): rotations alone, looked up as
    frame_id + `_ned` and child_frame_id + `_frd`; covariances as upper triangles, row by row.
    """
    parent, child = message.header.frame_id, message.child_frame_id
    C_ned = static[(parent, f'{parent}_ned')][:3, :3].T
    C_frd = static[(child, f'{child}_frd')][:3, :3].T
    T, twist = pose_of(message), message.twist.twist
    linear = [twist.linear.x, twist.linear.y, twist.linear.z]
    angular = [twist.angular.x, twist.angular.y, twist.angular.z]
    triangles = []
    for C, stated in ((C_ned, message.pose.covariance), (C_frd, message.twist.covariance)):
        both = np.kron(np.eye(2), C)
        P = both @ np.reshape(stated, (6, 6)) @ both.T
        triangles.append(P.astype(np.float32)[np.triu_indices(6)])
    attitude_ned = C_ned @ T[:3, :3] @ C_frd.T
    return C_ned @ T[:3, 3], attitude_ned, C_frd @ linear, C_frd @ angular, *triangles


@needs_tf2
@pytest.mark.parametrize('map_frame', ['', 'map'])
def test_mavros_gets_north_east_down_and_forward_right_down(ros, map_frame, tmp_path):
    """An autopilot's external odometry, by the plugin's arithmetic, against nav/state."""
    static = transforms._qos(1, transforms.DurabilityPolicy.TRANSIENT_LOCAL)
    origin = tmp_path / 'origin.yaml'
    place = earth.ecef_from_geodetic(*np.radians([69.99, 9.98]), 0.0)
    origin.write_text(LocalFrame(place, 'enu').as_yaml())
    stated = (
        'initial_latitude_deg:=70.0', 'initial_longitude_deg:=10.0', 'initial_height:=-20.0',
        'initial_grid_heading_deg:=40.0', 'initial_roll_deg:=3.0', 'initial_pitch_deg:=-2.0',
        'initial_v_G:=[0.6, 0.8, 0.1]', 'initial_sigma_position:=5.0',
        'initial_sigma_height:=2.0', 'initial_sigma_tilt_deg:=0.5',
        'initial_sigma_heading_deg:=3.0', 'accel_bias_sigma:=1e-5', 'gyro_bias_sigma:=1e-7',
        f'origin_file:={origin}', 'reorder_window_s:=0.05',
    )  # fmt: skip
    named = (f'map_frame:={map_frame}', 'base_frame:=base_link') if map_frame else ()
    rig = Rig(ros(*stated, *named), latched=[(transforms.TFMessage, '/tf_static', static)])
    # As the plugin subscribes: reliable, the newest message only.
    rig._listen(Odometry, 'odometry/now', QoSProfile(depth=1))
    rig.sail(40)
    rig.until(lambda: rig.heard['nav/state'] and rig.heard['/tf_static'])
    found = {
        (t.header.frame_id, t.child_frame_id): matrix_of(t)
        for t in rig.heard['/tf_static'][-1].transforms
    }
    state = rig.heard['nav/state'][-1]
    stamp_ns = to_ns(state.header.stamp)
    [now, *_] = [m for m in rig.heard['odometry/now'] if to_ns(m.header.stamp) == stamp_ns]
    p_ned, C_b_ned, v_frd, omega_frd, pose, twist = ned_frd(now, found)

    # The same from nav/state: geodetic place, true heading, grid velocity.
    up = earth.ecef_to_enu(*np.radians([69.99, 9.98]))
    assert p_ned == pytest.approx((up @ (state.r_e - place))[[1, 0, 2]] * [1, 1, -1], abs=1e-4)
    assert p_ned[2] > 19.9  # down, and the plane falls away
    yaw = math.atan2(C_b_ned[1, 0], C_b_ned[0, 0])
    assert math.remainder(yaw - state.true_heading, math.tau) == pytest.approx(0.0, abs=6e-4)
    roll, pitch = math.atan2(C_b_ned[2, 1], C_b_ned[2, 2]), -math.asin(C_b_ned[2, 0])
    assert roll == pytest.approx(state.roll, abs=6e-4)
    # Nose up is positive in forward-right-down and negative in forward-left-up axes.
    assert pitch == pytest.approx(-state.pitch, abs=6e-4)
    speed = float(np.linalg.norm(state.v_g))
    assert float(np.linalg.norm(v_frd)) == pytest.approx(speed, abs=1e-6)
    north_east = (C_b_ned @ v_frd)[:2]
    turn = state.true_heading - state.grid_heading
    v_E, v_N = state.v_g[:2]
    c, s = math.cos(turn), math.sin(turn)
    assert north_east == pytest.approx([v_N * c - v_E * s, v_E * c + v_N * s], abs=1e-3)
    assert omega_frd == pytest.approx([0.0, 0.0, -0.05], abs=1e-3)

    # Row-major upper triangle of x, y, z, roll, pitch, yaw: the diagonal stands at these places.
    diagonal = [0, 6, 11, 15, 18, 20]
    assert len(pose) == len(twist) == 21
    assert np.isfinite([*pose, *twist]).all()
    assert pose[diagonal[0]] == pytest.approx(25.0, rel=0.1)
    assert pose[diagonal[2]] == pytest.approx(4.0, rel=0.1)
    assert pose[diagonal[3]] == pytest.approx(math.radians(0.5) ** 2, rel=0.1)
    assert pose[diagonal[5]] == pytest.approx(math.radians(3.0) ** 2, rel=0.1)
    assert min(pose[diagonal]) > 0.0
    assert min(twist[diagonal]) > 0.0


def test_the_origin_is_latched_and_a_reset_counts(ros, tmp_path):
    origin = tmp_path / 'origin.yaml'
    frame = LocalFrame(earth.ecef_from_geodetic(*np.radians([80.01, 120.0]), 0.0), 'enu')
    origin.write_text(frame.as_yaml())
    rig = Rig(
        ros(f'origin_file:={origin}', 'map_frame:=map', 'now_every:=5'),
        latched=[
            (String, 'nav/origin', LATCHED_QOS),
            (UInt32, 'odometry/reset_counter', LATCHED_QOS),
        ],
    )
    rig.until(lambda: rig.heard['nav/origin'])
    assert rig.heard['nav/origin'][0].data == frame.as_yaml()
    rig.sail(50)
    answer = rig.reset.call_async(Trigger.Request())
    rig.until(answer.done)
    rig.sail(50)
    counter = rig.heard['odometry/reset_counter']
    rig.until(lambda: len(counter) == 2)
    assert [m.data for m in counter] == [0, 1]
    found = rig.heard['odometry/now']
    assert 15 <= len(found) <= 20
    assert found[-1].header.frame_id == 'map'
    assert pose_of(found[-1])[1, 3] == pytest.approx(-1116.0, abs=5.0)  # 0.01 deg to the south


@pytest.mark.parametrize('text', ['map_axes:=enu', 'origin_file:=/nonexistent/origin.yaml'])
def test_a_frame_that_cannot_be_stops_the_node_at_its_start(ros, text):
    with pytest.raises(ConfigError, match=r'from a pole|origin\.yaml'):
        ros('initial_latitude_deg:=89.999', text)


def test_in_lockstep_nothing_is_now(ros):
    node, _ = ros('lockstep:=true')
    published = node.get_publisher_names_and_types_by_node(node.get_name(), '/auv')
    names = {name for name, _ in published}
    assert '/auv/odometry' in names
    assert '/auv/odometry/now' not in names
