"""The follower node in process: lost definiteness and displaced fixes as diagnostics. Ring 2."""

import os
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import Imu, TimeReference  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from polar_nav_core import earth, grid  # noqa: E402
from polar_nav_core.engine.params import EngineParams  # noqa: E402
from polar_nav_core.link import packet  # noqa: E402
from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_msgs.msg import AcousticPacket, NavState  # noqa: E402
from polar_nav_ros.qos import DATA_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg, to_ns  # noqa: E402

pytestmark = pytest.mark.slow

START_NS = 1_772_323_200_000_000_000
OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


class Rig:
    """A follower node, someone who feeds it, and someone who listens."""

    def __init__(self, *parameters):
        args = ['--ros-args', '-r', '__ns:=/follower', '-p', 'initialize:=parameters']
        for parameter in parameters:
            args += ['-p', parameter]
        rclpy.init(args=args, domain_id=63)
        self.node = FollowerNode()
        self.peer = rclpy.create_node('peer', use_global_arguments=False)
        self.states, self.health, self.steps, self.odometry = [], [], [], []
        listen = self.peer.create_subscription
        listen(NavState, '/follower/nav/state', self.states.append, DATA_QOS)
        listen(TimeReference, '/follower/nav/clock', self.steps.append, DATA_QOS)
        listen(Odometry, '/follower/odometry', self.odometry.append, DATA_QOS)
        listen(DiagnosticArray, '/diagnostics', lambda m: self.health.append(m.status[0]), 10)
        self._imu = self.peer.create_publisher(Imu, '/follower/imu/data_raw', DATA_QOS)
        self._packets = self.peer.create_publisher(AcousticPacket, '/follower/acomms/rx', DATA_QOS)
        self._sent = 0
        self.reset = self.peer.create_client(Trigger, '/follower/follower_node/reset')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.stamp_ns = START_NS
        self._taken = 0
        self.until(lambda: self._imu.get_subscription_count() == 1)
        self.until(lambda: self._packets.get_subscription_count() == 1)
        self.until(self.reset.service_is_ready)

    def until(self, done, seconds=20.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def rest(self, samples, f_b=(0.0, 0.0, 9.83)):
        """Give IMU samples of a vehicle at rest, all taken when this returns."""
        for k in range(samples):
            self.stamp_ns += 10_000_000
            message = Imu()
            message.header.stamp = to_msg(self.stamp_ns)
            a = message.linear_acceleration
            a.x, a.y, a.z = f_b
            a.y += 1e-12 * (k % 2)  # a sensor has noise: one that repeats itself hangs
            self._imu.publish(message)
        self._taken += samples
        topic = '/follower/imu/data_raw'
        self.until(lambda: self.node.taken_counts()[topic] == self._taken)

    def fix(self, away_G=(0.0, 0.0, 0.0)):
        """Give a packet that puts the vehicle where it started, or so far from there."""
        p = EngineParams()
        lat, lon = np.deg2rad([p.initial_latitude_deg, p.initial_longitude_deg])
        r_e = earth.ecef_from_geodetic(lat, lon, p.initial_height)
        broadcast = packet.Broadcast(
            source=1,
            target=2,
            sequence=self._sent,
            validity_ns=self.stamp_ns,
            return_ns=self.stamp_ns,
            leader_r_e=r_e + grid.ecef_to_grid(r_e).T @ np.array(away_G),
            leader_sigma_horizontal=1.0,
            leader_sigma_vertical=1.0,
            leader_v_G=np.zeros(3),
            leader_sigma_velocity=0.01,
            leader_grid_heading=0.0,
            leader_sigma_heading=1e-3,
            r_lf_G=np.zeros(3),
            r_lf_covariance_G=np.eye(3),
            sound_speed=1440.0,
        )
        message = AcousticPacket(source='leader', destination='follower', sequence=self._sent)
        message.data = packet.encode(broadcast)
        message.transmit_time = message.header.stamp = to_msg(self.stamp_ns + 1_000_000)
        message.receive_time = to_msg(self.stamp_ns + 100_000_000)
        self._packets.publish(message)
        self._sent += 1
        topic = '/follower/acomms/rx'
        self.until(lambda: self.node.taken_counts()[topic] == self._sent)

    def status(self):
        """Next status of the node."""
        self.health.clear()
        self.until(lambda: any('follower_node' in s.name for s in self.health))
        return next(s for s in self.health if 'follower_node' in s.name)

    def end(self):
        self.node.destroy_node()
        self.peer.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def rig():
    made = []

    def make(*parameters):
        made.append(Rig(*parameters))
        return made[-1]

    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    yield make
    for one in made:
        one.end()


def lose_definiteness(rig):
    """A finite but absurd sample that no limit holds off: the state overflows."""
    rig.rest(1, f_b=(1e300, 0.0, 0.0))
    rig.rest(40)


def test_lost_definiteness_is_an_error_and_navigation_goes_on(rig):
    r = rig('configuration:=default', 'max_specific_force:=1.0e300')
    r.rest(100)
    r.until(lambda: len(r.states) >= 8)
    status = r.status()
    assert (status.level, status.message) == (OK, 'navigating, no fix was fused yet')

    lose_definiteness(r)
    before = len(r.states)
    r.rest(100)
    r.until(lambda: len(r.states) >= before + 8)
    status = r.status()
    assert status.level == ERROR
    assert 'restored from the newest sound state' in status.message
    assert all(np.isfinite(s.r_e).all() for s in r.states)

    answer = r.reset.call_async(Trigger.Request())
    r.until(answer.done)
    assert answer.result().success
    r.rest(100)
    r.until(lambda: len(r.states) >= before + 16)
    assert np.isfinite(r.states[-1].r_e).all()


def test_doubtful_parameters_stand_in_the_diagnostics(rig):
    r = rig('configuration:=default', 'delay_handling:=clone')
    values = {v.key: v.value for v in r.status().values}
    assert 'parameter delay_handling: clone is not used' in values['parameter_warnings']


def test_displaced_fixes_are_an_error_in_the_diagnostics_of_a_follower_without_a_dvl(rig):
    """At once, and by another sentence where they last: what to do."""
    r = rig('configuration:=default', 'max_gated_s:=4.0')
    r.rest(50)
    for _ in range(4):
        r.fix()
        r.rest(50)
    status = r.status()
    assert status.level == OK
    assert 'navigating, last fix fused' in status.message
    for _ in range(5):
        r.fix(away_G=(300.0, 400.0, 0.0))
        r.rest(50)
    status = r.status()
    assert status.level == ERROR
    assert 'displaced by about 500 m; no DVL vouches for the estimate' in status.message
    for _ in range(6):
        r.fix(away_G=(300.0, 400.0, 0.0))
        r.rest(50)
    status = r.status()
    assert status.level == ERROR
    assert 'longer than max_gated_s 4 s' in status.message
    values = {v.key: v.value for v in status.values}
    assert (values['FUSED'], values['GATED']) == ('4', '11')
    assert float(values['gated_offset_m']) == pytest.approx(500.0, abs=5.0)


def test_a_clock_that_steps_is_followed_reported_and_recorded(rig):
    r = rig('configuration:=default')
    r.rest(200)
    stepped_ns = r.stamp_ns + 10_000_000
    r.stamp_ns += 3600 * 10**9
    r.rest(200)
    r.until(lambda: len(r.states) >= 39)
    status = r.status()
    assert status.level == WARN
    assert 'the clock of imu/data_raw stepped by +3600.000 s' in status.message
    assert {v.key: v.value for v in status.values}['clock_offset_s imu/data_raw'] == '+3600.000'
    start, step = r.steps
    assert start.source == 'imu/data_raw 0'  # the first message that it took
    assert start.time_ref == start.header.stamp
    assert step.source == 'imu/data_raw 200'
    assert to_ns(step.header.stamp) == stepped_ns
    assert to_ns(step.time_ref) == stepped_ns + 3600 * 10**9
    # Navigation time goes on; the rest of the vehicle gets the stamps of its clock.
    stamps = np.array([to_ns(s.header.stamp) for s in r.states])
    assert set(np.diff(stamps)[1:]) == {100_000_000}
    r.until(lambda: len(r.odometry) == len(r.states))
    assert to_ns(r.odometry[-1].header.stamp) == stamps[-1] + 3600 * 10**9
    assert to_ns(r.odometry[5].header.stamp) == stamps[5]
