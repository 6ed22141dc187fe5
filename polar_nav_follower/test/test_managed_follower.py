"""A follower node in process: lifecycle, sensors off and on, places in the map. Ring 2."""

import os
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from geometry_msgs.msg import Point  # noqa: E402
from lifecycle_msgs.msg import State, Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402

from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_msgs.msg import Command, Depth, FixReceipt, NavState  # noqa: E402
from polar_nav_msgs.srv import FromLL, ToLL  # noqa: E402
from polar_nav_ros.diagnostics import Level  # noqa: E402
from polar_nav_ros.qos import DATA_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg  # noqa: E402

START_NS = 1_772_323_200_000_000_000
LISTENED = {
    'nav/state': NavState,
    'nav/receipt': FixReceipt,
    'nav/command': Command,
    'odometry': Odometry,
    'odometry/now': Odometry,
}


class Rig:
    """A follower node, someone who feeds it, calls its services and listens."""

    def __init__(self, *parameters):
        args = ['--ros-args', '-r', '__ns:=/auv', '-p', 'initialize:=parameters']
        for parameter in parameters:
            args += ['-p', parameter]
        rclpy.init(args=args, domain_id=40 + os.getpid() % 20)
        self.node = FollowerNode()
        self.peer = rclpy.create_node('peer', use_global_arguments=False)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.heard = {topic: [] for topic in LISTENED}
        for topic, kind in LISTENED.items():
            self.peer.create_subscription(
                kind, f'/auv/{topic}', self.heard[topic].append, DATA_QOS
            )
        self.imu = self.peer.create_publisher(Imu, '/auv/imu/data_raw', DATA_QOS)
        self.depth = self.peer.create_publisher(Depth, '/auv/depth/data', DATA_QOS)
        self.stamp_ns, self._sent, self._depths = START_NS, 0, 0

    def until(self, done, seconds=30.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def call(self, kind, name, **request):
        client = self.peer.create_client(kind, f'/auv/{name}')
        self.until(client.service_is_ready)
        answer = client.call_async(kind.Request(**request))
        self.until(answer.done)
        self.peer.destroy_client(client)
        return answer.result()

    def change(self, transition):
        request = {'transition': Transition(id=transition)}
        return self.call(ChangeState, 'follower_node/change_state', **request).success

    @property
    def state(self):
        return self.call(GetState, 'follower_node/get_state').current_state.id

    def sail(self, samples):
        """Give samples of a vehicle at rest, and a depth each ten; all are taken at the end."""
        self.until(lambda: self.imu.get_subscription_count() == 1)
        self.until(lambda: self.depth.get_subscription_count() == 1)
        for k in range(samples):
            self.stamp_ns += 10_000_000
            message = Imu()
            message.header.stamp = to_msg(self.stamp_ns)
            a = message.linear_acceleration
            a.x, a.y, a.z = 0.0, 1e-9 * (k % 2), 9.83
            if k % 10 == 0:
                depth = Depth(depth=100.0, variance=0.01)
                depth.header.stamp = message.header.stamp
                self.depth.publish(depth)
                self._depths += 1
            self.imu.publish(message)
        self._sent += samples
        taken = self.node.taken_counts
        self.until(lambda: taken()['/auv/imu/data_raw'] == self._sent)
        self.until(lambda: taken()['/auv/depth/data'] == self._depths)

    def quiet(self):
        """Take what is still on its way, then forget it."""
        for _ in range(20):
            self.executor.spin_once(timeout_sec=0.02)
        for found in self.heard.values():
            found.clear()

    def end(self):
        self.node.destroy_node()
        self.peer.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def rig(monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    made = []

    def make(*parameters):
        made.append(Rig(*parameters))
        return made[-1]

    yield make
    for one in made:
        one.end()


def test_it_is_active_at_once_and_inactive_it_navigates_in_silence(rig):
    r = rig()
    assert r.state == State.PRIMARY_STATE_ACTIVE
    r.sail(100)
    r.until(lambda: r.heard['odometry'] and r.heard['odometry/now'])
    assert r.change(Transition.TRANSITION_DEACTIVATE)
    assert r.state == State.PRIMARY_STATE_INACTIVE
    r.quiet()
    r.sail(300)
    r.until(lambda: len(r.heard['nav/state']) >= 28)
    assert r.heard['odometry'] == r.heard['odometry/now'] == []
    found = r.node.diagnose()
    assert found.values['lifecycle'] == 'inactive'
    assert 'outputs are silent' in found.message
    assert r.change(Transition.TRANSITION_ACTIVATE)
    r.sail(100)
    r.until(lambda: len(r.heard['odometry']) >= 8 and r.heard['odometry/now'])
    stamps = [m.header.stamp for m in r.heard['nav/state']]
    steps = np.diff([s.sec * 10**9 + s.nanosec for s in stamps])
    assert set(steps) == {100_000_000}, 'integration went on'


def test_without_autostart_it_waits_for_the_transitions(rig):
    r = rig('autostart:=false')
    assert r.state == State.PRIMARY_STATE_UNCONFIGURED
    assert 'not navigating' in r.node.diagnose().message
    assert r.imu.get_subscription_count() == 0
    assert r.change(Transition.TRANSITION_CONFIGURE)
    assert r.state == State.PRIMARY_STATE_INACTIVE
    r.sail(100)
    r.until(lambda: len(r.heard['nav/state']) >= 8)
    assert r.heard['odometry'] == []
    assert r.change(Transition.TRANSITION_ACTIVATE)
    r.sail(100)
    r.until(lambda: r.heard['odometry'])


def test_a_cleanup_is_refused_and_a_shutdown_ends_the_process(rig):
    r = rig()
    assert r.change(Transition.TRANSITION_DEACTIVATE)
    assert not r.change(Transition.TRANSITION_CLEANUP)
    assert r.state == State.PRIMARY_STATE_INACTIVE
    assert r.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
    r.until(lambda: r.node.ended is not None, seconds=5.0)
    assert r.node.ended == 0


def test_a_transition_that_the_state_has_not_is_refused_and_the_navigation_goes_on(rig):
    """rclpy's own service raises there, which ends the process: in the water, a lost vehicle."""
    r = rig()
    assert not r.change(Transition.TRANSITION_ACTIVATE)
    assert not r.change(Transition.TRANSITION_CLEANUP)
    assert not r.change(99)
    request = {'transition': Transition(label='descend')}
    assert not r.call(ChangeState, 'follower_node/change_state', **request).success
    assert r.change(Transition.TRANSITION_DEACTIVATE)
    assert not r.change(Transition.TRANSITION_DEACTIVATE)
    assert not r.change(Transition.TRANSITION_CONFIGURE)
    request = {'transition': Transition(label='activate')}
    assert r.call(ChangeState, 'follower_node/change_state', **request).success
    assert r.state == State.PRIMARY_STATE_ACTIVE
    r.sail(100)
    r.until(lambda: r.heard['odometry/now'])


def test_a_state_that_cannot_be_saved_is_a_warning(rig, tmp_path):
    """A full disk, a folder of another user: found out before the restart that needs it."""
    (tmp_path / 'file').write_bytes(b'')
    r = rig(f'state_file:={tmp_path}/file/state', 'state_period_s:=1.0')
    r.sail(300)
    found = r.node.diagnose()
    assert found.level >= Level.WARN
    assert f'{tmp_path}/file/state: not saved: ' in found.message


def test_two_publishers_of_a_sensor_are_named(rig):
    r = rig()
    r.sail(50)
    other = r.peer.create_publisher(Depth, '/auv/depth/data', DATA_QOS)
    r.until(lambda: other.get_subscription_count() == 1)
    r.until(lambda: len(r.node.get_publishers_info_by_topic('/auv/depth/data')) == 2)
    assert 'publishers' not in r.node.diagnose().message, 'one may have been killed'
    r.node._beats += 150
    assert '/auv/depth/data has 2 publishers (/peer)' in r.node.diagnose().message


def test_a_sensor_is_switched_off_and_on_by_recorded_commands(rig):
    r = rig()
    r.until(lambda: r.imu.get_subscription_count() == 1)
    early = r.call(SetBool, 'follower_node/use/depth/data', data=False)
    assert not early.success
    assert 'no IMU sample yet' in early.message
    r.sail(100)
    answer = r.call(SetBool, 'follower_node/use/depth/data', data=False)
    assert (answer.success, answer.message) == (True, '')
    r.sail(200)
    assert r.call(SetBool, 'follower_node/use/depth/data', data=True).success
    r.sail(100)
    r.until(lambda: len(r.heard['nav/command']) == 2)
    off, on = r.heard['nav/command']
    assert (off.kind, on.kind) == (Command.SENSOR_OFF, Command.SENSOR_ON)
    assert off.taken_topics == on.taken_topics == ['depth/data']
    assert (list(off.taken_counts), list(on.taken_counts)) == ([10], [30])
    r.until(lambda: len(r.heard['nav/receipt']) >= 20)
    assert {m.verdict_text for m in r.heard['nav/receipt']} == {'SWITCHED_OFF'}
    assert len(r.heard['nav/receipt']) == 20


def test_only_sensors_that_it_can_do_without_are_switched(rig):
    r = rig()
    prefix = '/auv/follower_node/use/'

    def switched():
        names = [name for name, _ in r.node.get_service_names_and_types()]
        return {name.removeprefix(prefix) for name in names if name.startswith(prefix)}

    r.until(lambda: switched() == {'dvl/data', 'depth/data', 'acomms/rx'})


def test_places_in_the_map_and_on_the_earth(rig):
    r = rig()
    assert 'no map frame yet' in r.call(FromLL, 'fromLL', latitude=80.0).message
    assert not r.call(ToLL, 'toLL').success
    r.sail(50)
    r.until(lambda: r.heard['odometry/now'])
    place = {'latitude': 80.01, 'longitude': 120.02, 'height': -40.0}
    there = r.call(FromLL, 'fromLL', **place)
    assert (there.success, there.frame_id) == (True, 'auv/map')
    # 0.01 deg of latitude, 0.02 deg of longitude at 80 degrees north: 1117 m and 388 m.
    p = there.map_point
    assert np.hypot(p.x, p.y) == pytest.approx(np.hypot(1117.0, 388.0), abs=2.0)
    back = r.call(ToLL, 'toLL', map_point=p)
    assert back.success
    assert (back.latitude, back.longitude) == pytest.approx((80.01, 120.02), abs=1e-9)
    assert back.height == pytest.approx(-40.0, abs=1e-4)
    assert not r.call(FromLL, 'fromLL', latitude=91.0).success
    assert not r.call(FromLL, 'fromLL', latitude=float('nan')).success
    far = r.call(ToLL, 'toLL', map_point=Point(x=1e300))
    assert (far.success, far.latitude) == (False, 0.0)
    far = r.call(FromLL, 'fromLL', latitude=80.0, height=1e300)
    assert not far.success
