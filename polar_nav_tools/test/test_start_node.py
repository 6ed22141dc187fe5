"""A follower without a stated place: what it waits for, how it starts, its replay. Ring 2."""

import math
import os
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import FluidPressure, Imu, NavSatFix  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from polar_nav_core.attitude import quaternion_from_matrix  # noqa: E402
from polar_nav_core.earth import ecef_from_geodetic  # noqa: E402
from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_core.grid import convergence, ecef_to_grid  # noqa: E402
from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_msgs.msg import Command, FixReceipt, Inputs, NavHealth, NavState  # noqa: E402
from polar_nav_ros.cdr import to_bytes  # noqa: E402
from polar_nav_ros.qos import BEST_EFFORT, DATA_QOS, LATCHED_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg  # noqa: E402
from polar_nav_ros.topics import DIAGNOSTICS, RUN_INFO, TYPES  # noqa: E402
from polar_nav_tools.bags import BagWriter  # noqa: E402
from polar_nav_tools.replay.verification import verify  # noqa: E402

pytestmark = pytest.mark.slow

DOMAIN = 81 + os.getpid() % 18
LATITUDE, LONGITUDE, HEADING = 63.4, 10.4, 30.0  # true heading
STEP_NS = 20_000_000
DRIVERS = {
    '/imu': ('sensor_msgs/msg/Imu', Imu),
    '/dvl': ('geometry_msgs/msg/TwistWithCovarianceStamped', TwistWithCovarianceStamped),
    '/pressure': ('sensor_msgs/msg/FluidPressure', FluidPressure),
    '/gnss': ('sensor_msgs/msg/NavSatFix', NavSatFix),
}
HEARD = {
    'nav/state': NavState,
    'nav/command': Command,
    'nav/receipt': FixReceipt,
    'nav/inputs': Inputs,
    'nav/health': NavHealth,
}
MAPPING = """
version: 2
vehicle: auv
imu: {topic: /imu, type: sensor_msgs/msg/Imu}
heading: {topic: /imu, type: sensor_msgs/msg/Imu, reference: true, bias_sigma_deg: 2.0,
  coloured_sigma_deg: 0.1}
dvl: {topic: /dvl, type: geometry_msgs/msg/TwistWithCovarianceStamped, sigma: 0.02}
depth: {topic: /pressure, type: sensor_msgs/msg/FluidPressure, sigma: 0.1}
fixes: {topic: /gnss, type: sensor_msgs/msg/NavSatFix, sigma: 2.0, delay_s: 0.1}
noise: {imu: vn100, dvl: a50_standard}
parameters: {reorder_window_s: 0.05}
"""


class Rig:
    """A follower with drivers that publish, and a peer that keeps what goes over the wire."""

    def __init__(self, tmp_path, mapping=MAPPING, *parameters):
        path = tmp_path / 'mapping.yaml'
        path.write_text(mapping)
        args = ['--ros-args', '-r', '__ns:=/auv', '-p', f'sources:={path}']
        for parameter in parameters:
            args += ['-p', parameter]
        rclpy.init(args=args, domain_id=DOMAIN)
        self.node = FollowerNode()
        self.peer = rclpy.create_node('peer', use_global_arguments=False)
        self.rows, self.got, self.starts, self.health = [], {n: [] for n in HEARD}, [], []
        listen = self.peer.create_subscription
        for name, kind in HEARD.items():
            listen(kind, f'/auv/{name}', lambda m, n=name: self.hear(n, m), DATA_QOS)
        listen(DiagnosticArray, '/auv/nav/start', self.starts.append, LATCHED_QOS)
        listen(DiagnosticArray, DIAGNOSTICS, lambda m: self.health.append(m.status[0]), 10)
        listen(String, RUN_INFO, lambda m: self.keep(RUN_INFO, m), LATCHED_QOS)
        create = self.peer.create_publisher
        there = {n: kind for n, (_, kind) in DRIVERS.items() if f'topic: {n},' in mapping}
        self.out = {n: create(kind, n, DATA_QOS) for n, kind in there.items()}
        self.pose = create(PoseWithCovarianceStamped, '/auv/set_pose', 10)
        self.reset = self.peer.create_client(Trigger, '/auv/follower_node/reset')
        self.sent = dict.fromkeys(DRIVERS, 0)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.ns = self.node.get_clock().now().nanoseconds
        self.rng = np.random.default_rng(1)
        # Of the IMU its heading is another source.
        wanted = {n: 2 if n == '/imu' and 'heading' in mapping else 1 for n in self.out}
        self.until(
            lambda: all(p.get_subscription_count() == wanted[n] for n, p in self.out.items())
        )

    def keep(self, topic, message):
        self.rows.append((topic, time.time_ns(), to_bytes(message)))

    def hear(self, name, message):
        self.got[name].append(message)
        self.keep(f'/auv/{name}', message)

    def until(self, done, seconds=30.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def hear_all(self):
        """Topics keep no order among each other: wait for the last message of each."""
        sent = self.node.published_counts()
        self.until(lambda: all(len(self.got[n]) == sent[f'/auv/{n}'] for n in HEARD))

    def publish(self, name, message):
        if name not in self.out:
            return
        message.header.stamp = to_msg(self.ns)
        self.sent[name] += 1
        self.out[name].publish(message)
        self.keep(name, message)
        self.until(lambda: self.node.taken_counts()[name] == self.sent[name])

    def rest(self, seconds, without=()):
        """A vehicle at rest at 10 m depth, axes of the IMU forward, left, up."""
        yaw = math.radians(90.0 - HEADING)
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.ns += STEP_NS
            k = self.ns // STEP_NS
            imu = Imu()
            imu.orientation.z, imu.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
            if 'heading' in without:
                imu.orientation_covariance[0] = -1.0
            a, w = imu.linear_acceleration, imu.angular_velocity
            a.x, a.y, a.z = (self.rng.normal(m, 0.01) for m in (0.0, 0.0, 9.82))
            w.x, w.y, w.z = self.rng.normal(0.0, 1e-3, 3)
            self.publish('/imu', imu)
            if k % 10 == 0:
                self.publish('/dvl', TwistWithCovarianceStamped())
                self.publish('/pressure', FluidPressure(fluid_pressure=101325.0 + 1.01e5))
            if k % 50 == 5 and 'fixes' not in without:
                fix = NavSatFix(latitude=LATITUDE, longitude=LONGITUDE, altitude=math.nan)
                fix.status.status = 0
                self.publish('/gnss', fix)

    def said(self):
        """Newest status of the start as a sentence with its values."""
        self.until(lambda: self.starts)
        status = self.starts[-1].status[0]
        return status.message, {v.key: v.value for v in status.values}

    def diagnosis(self):
        self.health.clear()
        self.until(lambda: any(s.name == '/auv/follower_node' for s in self.health))
        return next(s for s in self.health if s.name == '/auv/follower_node')

    def bag(self, path):
        kinds = {name: kind for name, (kind, _) in DRIVERS.items()}
        kinds |= {f'/auv/{name}': TYPES[name] for name in HEARD} | {RUN_INFO: TYPES[RUN_INFO]}
        with BagWriter(path, {}) as writer:
            for name, kind in kinds.items():
                writer.add_topic(name, kind)
            for topic, log_ns, data in self.rows:
                writer.write(topic, data, log_ns)
        return path

    def end(self):
        self.node.destroy_node()
        self.peer.destroy_node()


@pytest.fixture
def rig(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    made = []

    def make(*arguments):
        made.append(Rig(tmp_path, *arguments))
        return made[-1]

    yield make
    for one in made:
        one.end()
    rclpy.try_shutdown()


def grid_heading():
    lat, lon = math.radians(LATITUDE), math.radians(LONGITUDE)
    return math.radians(HEADING) - float(convergence(lat, lon))


def test_it_starts_by_itself_from_gnss_and_ahrs_and_the_bag_replays(rig, tmp_path):
    one = rig()
    assert one.node.params.initialize == 'alignment'
    one.rest(14.0)
    one.until(lambda: len(one.got['nav/state']) > 10)
    state = one.got['nav/state'][0]
    assert math.degrees(state.latitude) == pytest.approx(LATITUDE, abs=1e-4)
    assert math.remainder(state.grid_heading - grid_heading(), math.tau) == pytest.approx(
        0.0, abs=1e-3
    )
    assert state.height == pytest.approx(-10.0, abs=0.5)
    assert [c.kind for c in one.got['nav/command']] == [Command.SET_INITIAL_STATE]
    one.until(lambda: one.said()[1]['state'] == 'navigating')
    sentence, values = one.said()
    assert values['origin'] == 'alignment'
    assert 'heading measured by heading/data (true north) (1-sigma 2 deg)' in sentence
    assert 'height by depth' in sentence
    late = []  # as a recorder that finds the topic after the first blocks
    kept = one.peer.create_subscription(Inputs, '/auv/nav/inputs', late.append, LATCHED_QOS)
    one.node.close()
    one.hear_all()
    one.until(lambda: len(late) == len(one.got['nav/inputs']))
    assert [b.sequence for b in late] == list(range(len(late)))
    assert kept.get_publisher_count() == 1
    assert one.got['nav/command'][-1].kind == Command.SHUTDOWN
    total = sum(one.sent.values()) + one.sent['/imu']  # of which the heading is, too
    assert sum(len(b.digest) for b in one.got['nav/inputs']) == total
    states = len(one.got['nav/state'])
    result = verify(one.bag(tmp_path / 'bag'))
    assert result.ok, result.difference
    assert not result.problems
    assert result.counts['nav/state'] == (states, states)


def test_without_a_heading_it_publishes_no_state_and_names_what_it_waits_for(rig):
    one = rig()
    one.rest(13.0, without=('heading',))
    status = one.diagnosis()
    assert status.level == b'\x01'
    assert 'no state yet: waiting for: a heading (its source heading/data (true' in status.message
    assert '~/set_initial_state' in status.message
    assert one.said()[1] == {'state': 'waiting', 'origin': 'none'}
    assert not one.got['nav/state']
    assert not one.got['nav/command']
    assert any('a heading' in c for c in one.got['nav/health'][-1].conditions)


def test_without_a_fix_it_waits_for_one_and_a_reset_starts_anew(rig):
    one = rig()
    one.rest(12.0, without=('fixes',))
    assert 'waiting for: a fix' in one.diagnosis().message
    one.rest(4.0)
    one.until(lambda: one.got['nav/state'])
    one.until(lambda: one.reset.service_is_ready())
    answer = one.reset.call_async(Trigger.Request())
    one.until(answer.done)
    assert answer.result().success
    one.rest(0.5)
    count = len(one.got['nav/state'])
    one.rest(2.0)
    assert len(one.got['nav/state']) == count
    one.rest(13.0)
    one.until(lambda: len(one.got['nav/state']) > count)
    kinds = [c.kind for c in one.got['nav/command']]
    assert kinds == [Command.SET_INITIAL_STATE, Command.RESET, Command.SET_INITIAL_STATE]


def pose_of(frame='earth', yaw_variance=0.07):
    r_e = np.asarray(ecef_from_geodetic(math.radians(LATITUDE), math.radians(LONGITUDE), 0.0))
    psi = 0.5 * math.pi - grid_heading()
    C_b_G = np.array(
        [[math.cos(psi), -math.sin(psi), 0.0], [math.sin(psi), math.cos(psi), 0.0], [0, 0, 1.0]]
    )
    x, y, z, w = quaternion_from_matrix(ecef_to_grid(r_e).T @ C_b_G)
    message = PoseWithCovarianceStamped()
    message.header.frame_id = frame
    at, q = message.pose.pose.position, message.pose.pose.orientation
    at.x, at.y, at.z = r_e
    q.x, q.y, q.z, q.w = x, y, z, w
    P_G = np.zeros((6, 6))
    P_G[0, 0] = P_G[1, 1] = 0.25
    P_G[5, 5] = yaw_variance
    turn = np.kron(np.eye(2), ecef_to_grid(r_e).T)
    message.pose.covariance = (turn @ P_G @ turn.T).reshape(36)
    return message


def test_a_pose_states_place_and_heading_and_the_rest_is_found(rig):
    one = rig()
    one.rest(2.0, without=('fixes', 'heading'))
    one.until(lambda: one.pose.get_subscription_count() == 1)
    one.pose.publish(pose_of('odom'))
    one.until(lambda: 'must be in one of the frames auv/map, earth' in one.said()[0])
    one.pose.publish(pose_of())
    one.until(lambda: 'refused' not in one.said()[0])
    one.rest(11.0, without=('fixes', 'heading'))
    one.until(lambda: one.got['nav/state'])
    state = one.got['nav/state'][0]
    assert math.remainder(state.grid_heading - grid_heading(), math.tau) == pytest.approx(
        0.0, abs=1e-2
    )
    assert state.height == pytest.approx(-10.0, abs=0.5)
    # A heading is promised by the file, and no message has one.
    one.until(lambda: one.said()[1] == {'state': 'degraded', 'origin': 'pose'})


POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
FROM_TOPIC = f"""
version: 2
vehicle: auv
imu: {{topic: /imu, type: sensor_msgs/msg/Imu}}
dvl: {{topic: /dvl, type: geometry_msgs/msg/TwistWithCovarianceStamped, sigma: 0.02}}
depth: {{topic: /pressure, type: sensor_msgs/msg/FluidPressure, sigma: 0.1}}
initial: {{from: topic, topic: /start, type: {POSE}, frame: earth}}
noise: {{imu: vn100, dvl: a50_standard}}
"""


def test_a_topic_states_the_start_and_the_bag_replays_without_it(rig, tmp_path):
    one = rig(FROM_TOPIC)
    start = one.peer.create_publisher(PoseWithCovarianceStamped, '/start', BEST_EFFORT)
    one.rest(2.0)
    assert 'a position of the topic of section initial' in one.diagnosis().message
    one.until(lambda: start.get_subscription_count() == 1)
    start.publish(pose_of())
    start.publish(pose_of())
    one.rest(3.0)
    one.until(lambda: one.got['nav/state'])
    state = one.got['nav/state'][0]
    assert math.degrees(state.latitude) == pytest.approx(LATITUDE, abs=1e-6)
    assert math.remainder(state.grid_heading - grid_heading(), math.tau) == pytest.approx(
        0.0, abs=1e-2
    )
    assert state.height == pytest.approx(-10.0, abs=0.5), 'by depth: its variance leaves it open'
    one.until(lambda: start.get_subscription_count() == 0)
    assert [c.kind for c in one.got['nav/command']] == [Command.SET_INITIAL_STATE]
    one.node.close()
    one.hear_all()
    result = verify(one.bag(tmp_path / 'bag'))
    assert result.ok, result.difference
    assert not result.problems


def test_a_start_from_a_topic_needs_its_type(rig):
    with pytest.raises(ConfigError, match='initial: /start: type is missing'):
        rig(FROM_TOPIC.replace(f' type: {POSE},', ''))


def test_a_follower_without_anything_stated_never_starts_at_a_default(monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init(args=['--ros-args', '-r', '__ns:=/auv'], domain_id=DOMAIN)
    node = FollowerNode()
    assert node.params.initialize == 'alignment'
    assert node.params.initial_state() is None
    assert 'waiting for: IMU samples' in node.diagnose().message
    node.destroy_node()
    rclpy.try_shutdown()
