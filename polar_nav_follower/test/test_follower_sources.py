"""The follower node with a mapping file: foreign types, best effort, what is recorded. Ring 2."""

import math
import os
import time
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import TwistWithCovarianceStamped  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from rclpy.time import Time  # noqa: E402
from sensor_msgs.msg import FluidPressure, Imu, NavSatFix  # noqa: E402

from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_msgs.msg import Depth, FixReceipt, Inputs, NavHealth, NavState  # noqa: E402
from polar_nav_ros.qos import DATA_QOS, QUEUE_DEPTH  # noqa: E402
from polar_nav_ros.source_ports import digest_of  # noqa: E402
from polar_nav_ros.stamps import to_msg, to_ns  # noqa: E402
from polar_nav_ros.topics import HEALTH, STATE  # noqa: E402

pytestmark = pytest.mark.slow

BEST_EFFORT = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
DOMAIN = 81 + os.getpid() % 18
LATITUDE, LONGITUDE = 63.4, 10.4
MAPPING = f"""
version: 2
vehicle: auv
imu: {{topic: /xsens/imu, type: sensor_msgs/msg/Imu, rotation: frd}}
dvl:
  topic: dvl/twist
  type: geometry_msgs/msg/TwistWithCovarianceStamped
  reference: bottom
  sigma: 0.02
depth: {{topic: /bar30/pressure, type: sensor_msgs/msg/FluidPressure, sigma: 0.1}}
fixes:
  - {{topic: /ugps/fix, type: sensor_msgs/msg/NavSatFix, source: ugps, sigma: 2.0, delay_s: 0.3}}
initial: {{from: values, heading_deg: 30.0}}
noise: {{imu: vn100, dvl: a50_standard}}
parameters:
  initial_latitude_deg: {LATITUDE}
  initial_longitude_deg: {LONGITUDE}
  initial_height: 0.0
  reorder_window_s: 0.05
"""


class Rig:
    """A follower with a mapping file, drivers that publish best effort, and a listener."""

    running: ClassVar = []

    def __init__(self, path, *arguments, qos=BEST_EFFORT):
        self.running.append(self)
        args = ['--ros-args', '-r', '__ns:=/auv', '-p', f'sources:={path}', *arguments]
        rclpy.init(args=args, domain_id=DOMAIN)
        self.node = FollowerNode()
        self.peer = rclpy.create_node('peer', use_global_arguments=False)
        self.states, self.health, self.blocks, self.receipts = [], [], [], []
        listen = self.peer.create_subscription
        listen(NavState, '/auv/nav/state', self.states.append, DATA_QOS)
        listen(Inputs, '/auv/nav/inputs', self.blocks.append, DATA_QOS)
        listen(FixReceipt, '/auv/nav/receipt', self.receipts.append, DATA_QOS)
        listen(DiagnosticArray, '/diagnostics', lambda m: self.health.append(m.status[0]), 10)
        kinds = {
            '/xsens/imu': Imu,
            '/auv/dvl/twist': TwistWithCovarianceStamped,
            '/bar30/pressure': FluidPressure,
            '/ugps/fix': NavSatFix,
        }
        self.out = {
            name: self.peer.create_publisher(kind, name, qos) for name, kind in kinds.items()
        }
        self.sent = {name: [] for name in kinds}
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)

    def until(self, done, seconds=30.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def matched(self):
        return all(p.get_subscription_count() == 1 for p in self.out.values())

    def publish(self, name, message):
        data = bytes(serialize_message(message))  # padding has any value
        self.out[name].publish(data)
        self.sent[name].append(data)
        count = len(self.sent[name])
        self.until(lambda: self.node.taken_counts()[name] == count)

    def sail(self, stamp_ns, samples):
        """A vehicle at rest at 10 m depth, axes of the IMU forward, right, down."""
        for k in range(samples):
            now = to_msg(stamp_ns + k * 10_000_000)
            imu = Imu()
            imu.header.stamp = now
            a = imu.linear_acceleration
            a.x, a.y, a.z = 0.0, 1e-9 * (k % 2), -9.823
            self.publish('/xsens/imu', imu)
            if k % 20 == 10:
                twist = TwistWithCovarianceStamped()
                twist.header.stamp = now
                self.publish('/auv/dvl/twist', twist)
                pressure = FluidPressure(fluid_pressure=101325.0 + 1.01e5)
                pressure.header.stamp = now
                self.publish('/bar30/pressure', pressure)
            if k % 50 == 30:
                fix = NavSatFix(latitude=LATITUDE, longitude=LONGITUDE, altitude=math.nan)
                fix.header.stamp = now
                fix.status.status = 0 if k % 100 == 30 else -1
                self.publish('/ugps/fix', fix)

    def status(self):
        """Next status of the node."""
        self.health.clear()
        self.until(lambda: any(s.name == '/auv/follower_node' for s in self.health))
        return next(s for s in self.health if s.name == '/auv/follower_node')

    def end(self):
        self.node.destroy_node()
        self.peer.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def mapped(tmp_path):
    path = tmp_path / 'mapping.yaml'
    path.write_text(MAPPING, encoding='utf-8')
    return path


@pytest.fixture(autouse=True)
def _shut_down():
    yield
    for rig in Rig.running:
        rig.end()
    Rig.running.clear()
    rclpy.try_shutdown()


def test_a_vehicle_of_foreign_best_effort_drivers(mapped):
    rig = Rig(mapped)
    rig.until(rig.matched)
    params = rig.node.params
    assert params.initial_latitude_deg == LATITUDE
    assert params.initialize == 'parameters'
    # True heading of the file, less the convergence of a transverse grid: tan = sin lat tan lon.
    lat, lon = math.radians(LATITUDE), math.radians(LONGITUDE)
    convergence_deg = math.degrees(math.atan(math.sin(lat) * math.tan(lon)))
    assert params.initial_grid_heading_deg == pytest.approx(30.0 - convergence_deg, abs=1e-9)
    assert params.gyro_noise_density > 1e-6  # of the class, not of a navigation-grade IMU
    now = rig.node.get_clock().now().nanoseconds
    rig.sail(now, 200)
    rig.node.close()
    total = sum(len(m) for m in rig.sent.values())
    rig.until(lambda: sum(len(b.digest) for b in rig.blocks) == total and len(rig.receipts) > 1)
    # Flipped by `frd`: gravity points up, so the vehicle stays where it is.
    last = rig.states[-1]
    assert abs(last.latitude - math.radians(LATITUDE)) < 1e-6
    assert np.linalg.norm(last.v_g) < 0.5
    # Two fixes with a position, without a height; those of no fix are not counted.
    fused = [r for r in rig.receipts if r.source == 'ugps']
    assert [r.verdict for r in fused] == [FixReceipt.FUSED] * 2
    assert last.height == pytest.approx(-10.0, abs=1.0)
    # What was used, in its order.
    names = list(rig.blocks[0].topics)
    assert names == ['/xsens/imu', '/auv/dvl/twist', '/bar30/pressure', '/ugps/fix']
    for i, name in enumerate(names):
        found = [d for b in rig.blocks for s, d in zip(b.source, b.digest, strict=True) if s == i]
        assert found == [digest_of(data) for data in rig.sent[name]]
    assert [b.sequence for b in rig.blocks] == list(range(len(rig.blocks)))


def test_a_digest_is_that_of_a_recorder_in_another_process():
    """Between processes bytes are filled up to four; within one they are not."""
    assert digest_of(b'\x00\x01\x00\x00\x07') == digest_of(b'\x00\x01\x00\x00\x07\x00\x00\x00')
    assert digest_of(b'\x00\x01\x00\x00') != digest_of(b'\x00\x01\x00\x00\x00\x00\x00\x00')


def test_an_imu_above_base_link(mapped):
    """All that is published is of base_link, at which depth and fixes are; /tf has the IMU."""
    high = 'rotation: frd, lever_b: [0.0, 0.0, 5.0]'
    mapped.write_text(MAPPING.replace('rotation: frd', high), encoding='utf-8')
    rig = Rig(mapped)
    now = []
    rig.peer.create_subscription(Depth, '/auv/odometry/depth', now.append, DATA_QOS)
    rig.until(rig.matched)
    rig.until(lambda: rig.node.count_subscribers('/auv/odometry/depth') == 1)
    rig.sail(rig.node.get_clock().now().nanoseconds, 200)
    rig.node.close()
    rig.until(lambda: len(rig.receipts) > 1 and len(rig.states) > 15)
    assert rig.states[-1].height == pytest.approx(-10.0, abs=1.0)
    assert now[-1].depth == pytest.approx(10.0, abs=1.0)
    live = rig.node._ports._live
    [imu] = [t for t in live._mounted() if t.child_frame_id == 'auv/imu']
    assert imu.transform.translation.z == 5.0


def test_what_led_to_an_output_is_published_before_it(mapped):
    """A node that is killed has published what it used for all that it published."""
    rig = Rig(mapped)
    rig.until(rig.matched)
    now = rig.node.get_clock().now().nanoseconds
    order, publish = [], rig.node._ports._outputs[STATE].publish
    rig.node._ports._outputs[STATE].publish = lambda data: (order.append(data), publish(data))
    ports = rig.node._ports._sources
    record = ports._inputs.publish
    ports._inputs.publish = lambda block: (order.append(block), record(block))
    rig.sail(now, 60)  # less than the second after which a block is published in any case
    known = set()
    states = 0
    for one in order:
        if isinstance(one, Inputs):
            known.update(zip(one.source, one.mapped, strict=True))
            continue
        states += 1
        stamp_ns = to_ns(deserialize_message(one, NavState).header.stamp)
        first_ns = min(stamp for source, stamp in known if source == 0)
        used = {stamp for source, stamp in known if source == 0 and stamp <= stamp_ns}
        assert len(used) == (stamp_ns - first_ns) // 10_000_000 + 1
    assert states >= 5


def test_a_reliable_publisher_is_heard_reliably_and_an_absent_one_is_named(mapped):
    rig = Rig(mapped, '-r', '/ugps/fix:=/topside/fix', qos=DATA_QOS)
    heard = ('/xsens/imu', '/auv/dvl/twist', '/bar30/pressure')
    rig.until(lambda: all(rig.out[n].get_subscription_count() == 1 for n in heard))
    status = rig.status()
    assert status.level >= b'\x01'
    assert 'nobody publishes /topside/fix' in status.message
    values = {v.key: v.value for v in status.values}
    assert values['source /xsens/imu'] == 'sensor_msgs/msg/Imu, reliable'
    health = []
    rig.node._ports._outputs[HEALTH].publish = health.append
    rig.sail(rig.node.get_clock().now().nanoseconds, 25)
    last = deserialize_message(health[-1], NavHealth)
    assert (last.level, last.status) == (NavHealth.WARN, NavHealth.STATUS_DEGRADED)
    assert list(last.conditions) == ['WARN: nobody publishes /topside/fix']
    assert last.culprit == NavHealth.FIXES


def test_what_is_wrong_with_a_source_is_in_the_log_too(mapped, monkeypatch):
    """Who starts a node by hand reads its log, and no diagnostics."""
    rig = Rig(mapped, '-r', '/ugps/fix:=/topside/fix', qos=DATA_QOS)
    heard = ('/xsens/imu', '/auv/dvl/twist', '/bar30/pressure')
    rig.until(lambda: all(rig.out[n].get_subscription_count() == 1 for n in heard))
    said = []
    log = SimpleNamespace(warning=said.append, info=said.append)
    monkeypatch.setattr(rig.node, 'get_logger', lambda: log)
    sources = rig.node._ports._sources
    for _ in range(20):
        sources.health.look()
    assert said == ['nobody publishes /topside/fix']
    publisher = rig.peer.create_publisher(NavSatFix, '/topside/fix', DATA_QOS)
    rig.until(lambda: publisher.get_subscription_count() == 1)
    sources.health.look()
    assert said[1:] == ['/topside/fix is as the mapping file states it']
    rig.node._ports._start._published = None
    rig.node._ports._start.publish()
    assert said[2:] == ['waiting for: IMU samples']


def test_two_publishers_of_one_sensor_are_named(mapped):
    rig = Rig(mapped)
    rig.until(rig.matched)
    assert 'publishers' not in rig.status().message
    second = rclpy.create_node('second', use_global_arguments=False)
    other = second.create_publisher(Imu, '/xsens/imu', BEST_EFFORT)
    rig.until(lambda: other.get_subscription_count() == 1)
    rig.until(lambda: len(rig.node.get_publishers_info_by_topic('/xsens/imu')) == 2)
    assert '/xsens/imu has 2 publishers (/peer, /second)' in rig.status().message
    second.destroy_node()


def test_a_fix_of_a_clock_a_little_ahead_is_used(mapped):
    """Two computers with NTP, or /clock in steps: the fix came when it was valid."""
    mapped.write_text(MAPPING.replace(', delay_s: 0.3', ''), encoding='utf-8')
    rig = Rig(mapped)
    rig.until(rig.matched)
    clock = SimpleNamespace(now=lambda: Time(nanoseconds=rig.now_ns), ros_time_is_active=False)
    rig.node.get_clock = lambda: clock
    start_ns = 1_772_323_200_000_000_000
    rig.now_ns = start_ns + 10**9
    rig.sail(start_ns, 100)
    for ahead_ms in (30, 250):
        fix = NavSatFix(latitude=LATITUDE, longitude=LONGITUDE)
        fix.status.status = 0
        fix.header.stamp = to_msg(rig.now_ns + ahead_ms * 10**6)
        rig.publish('/ugps/fix', fix)
    rig.sail(start_ns + 10**9, 40)

    def verdicts():
        return {to_ns(r.validity_time) - start_ns: r.verdict for r in rig.receipts}

    rig.until(lambda: {1_030_000_000, 1_250_000_000} <= set(verdicts()))
    assert verdicts()[1_030_000_000] == FixReceipt.FUSED
    assert verdicts()[1_250_000_000] == FixReceipt.FROM_FUTURE


def test_a_source_that_never_has_a_position_is_named(mapped):
    rig = Rig(mapped)
    rig.until(rig.matched)
    for _ in range(10):
        rig.publish('/ugps/fix', NavSatFix())  # a driver that leaves the status as it is: unknown
    assert 'none of 10 messages of /ugps/fix holds a position' in rig.status().message
    assert not rig.receipts


def test_a_dvl_that_never_states_how_good_it_is_is_named(mapped):
    """Zeros as covariance: each ping has a receipt, and nobody reads receipts on deck."""
    mapped.write_text(MAPPING.replace('  sigma: 0.02\n', ''), encoding='utf-8')
    rig = Rig(mapped)
    rig.until(rig.matched)
    now = rig.node.get_clock().now().nanoseconds
    rig.sail(now, 220)
    text = rig.status().message
    assert 'messages of /auv/dvl/twist states a variance above zero' in text
    assert '`sigma`' in text
    assert 'ugps' not in text


def test_a_dvl_that_never_holds_a_velocity_is_named(mapped):
    rig = Rig(mapped)
    rig.until(rig.matched)
    for _ in range(10):
        twist = TwistWithCovarianceStamped()
        twist.twist.twist.linear.x = math.nan
        rig.publish('/auv/dvl/twist', twist)
    assert 'none of 10 messages of /auv/dvl/twist holds a velocity' in rig.status().message


def test_depths_above_the_surface_are_named(mapped):
    rig = Rig(mapped)
    rig.until(rig.matched)
    for k in range(10):  # gauge pressures
        rig.publish('/bar30/pressure', FluidPressure(fluid_pressure=1000.0 + k))
    text = rig.status().message
    assert '10 of 10 depths of /bar30/pressure are above the surface' in text


def test_qos_overrides_are_obeyed_and_what_does_not_match_is_named(mapped):
    override = 'qos_overrides./xsens/imu.subscription.reliability:=reliable'
    rig = Rig(mapped, '-p', override)
    others = [name for name in rig.out if name != '/xsens/imu']
    rig.until(lambda: all(rig.out[n].get_subscription_count() == 1 for n in others))
    text = rig.status().message
    assert 'the QoS of /xsens/imu is incompatible: its publisher offers best effort' in text
    assert rig.out['/xsens/imu'].get_subscription_count() == 0


@pytest.mark.parametrize(
    ('old', 'new', 'says'),
    [
        ('type: sensor_msgs/msg/Imu, ', '', '/xsens/imu: type is missing'),
        ('sensor_msgs/msg/Imu', 'acme_msgs/msg/Imu', 'needs the package acme_msgs'),
        (
            'sensor_msgs/msg/Imu',
            'sensor_msgs/msg/Imo',
            'mapping.yaml: /xsens/imu: package sensor_msgs has no message Imo; did you mean Imu',
        ),
        ('sensor_msgs/msg/Imu', 'sensor_msgs/msg/Range', 'has no adapter for imu'),
        ('sigma: 2.0', 'sigmas: 2.0', 'unknown key sigmas'),
        ('/ugps/fix', '/ugps-fix', "'/ugps-fix' is no name of a topic: topic name must not"),
        ('dvl/twist', 'dvl twist', "'dvl twist' is no name of a topic"),
        ('/bar30/pressure', '/xsens/imu', '/xsens/imu is stated as .*/Imu and as .*/FluidPress'),
    ],
)
def test_what_cannot_be_run_is_named_at_the_start(mapped, old, new, says):
    mapped.write_text(MAPPING.replace(old, new), encoding='utf-8')
    rclpy.init(args=['--ros-args', '-p', f'sources:={mapped}'], domain_id=DOMAIN)
    with pytest.raises(ConfigError, match=says):
        FollowerNode()


def test_without_a_place_to_start_from_the_node_aligns(mapped):
    mapped.write_text(MAPPING.replace(f'initial_latitude_deg: {LATITUDE}', ''), encoding='utf-8')
    rclpy.init(args=['--ros-args', '-p', f'sources:={mapped}'], domain_id=DOMAIN)
    node = FollowerNode()
    assert node.params.initialize == 'alignment'
    node.destroy_node()
