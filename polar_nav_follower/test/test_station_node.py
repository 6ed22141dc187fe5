"""The follower node in station mode, in process: topics, the service, the diagnostics. Ring 2."""

import os
import time

import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from polar_nav_follower.follower_node import FollowerNode  # noqa: E402
from polar_nav_msgs.msg import Command, NavState, VehicleModel  # noqa: E402
from polar_nav_ros.qos import DATA_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg  # noqa: E402

START_NS = 1_772_323_200_000_000_000


@pytest.fixture
def node(monkeypatch):
    monkeypatch.setitem(os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    args = [
        '--ros-args',
        '-r',
        '__ns:=/auv',
        '-p',
        'mode:=station',
        '-p',
        'configuration:=default',
        '-p',
        'initialize:=parameters',
    ]
    rclpy.init(args=args, domain_id=64)
    node = FollowerNode()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.slow
def test_it_listens_to_its_mode_s_topics_and_puts_the_service_call_into_their_order(node):
    topics = set(node.taken_counts())
    assert topics == {
        f'/auv/{t}' for t in ('imu/data', 'control/thrust', 'depth/data', 'acomms/rx')
    }
    assert '/auv/acomms/station_decoded' in node.published_counts()
    assert '/auv/acomms/decoded' not in node.published_counts()
    peer = rclpy.create_node('peer', use_global_arguments=False)
    states, models, commands, health = [], [], [], []
    listen = peer.create_subscription
    listen(NavState, '/auv/nav/state', states.append, DATA_QOS)
    listen(VehicleModel, '/auv/nav/model', models.append, DATA_QOS)
    listen(Command, '/auv/nav/command', commands.append, DATA_QOS)
    listen(DiagnosticArray, '/diagnostics', lambda m: health.append(m.status[0]), 10)
    imu = peer.create_publisher(Imu, '/auv/imu/data', DATA_QOS)
    identify = peer.create_client(Trigger, '/auv/follower_node/identify')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(peer)

    def until(done, seconds=20.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        assert done()

    def call():
        answer = identify.call_async(Trigger.Request())
        until(answer.done)
        return answer.result()

    until(lambda: imu.get_subscription_count() == 1 and identify.service_is_ready())
    early = call()
    assert not early.success
    assert 'no IMU sample yet' in early.message
    for k in range(150):
        message = Imu()
        message.header.stamp = to_msg(START_NS + 10_000_000 * k)
        message.linear_acceleration.z = 9.83
        imu.publish(message)
    until(lambda: len(states) >= 12 and len(models) >= 2)
    assert call().success
    until(lambda: commands)
    assert commands[0].kind == Command.IDENTIFY
    until(lambda: any('follower_node' in s.name for s in health))
    peer.destroy_node()
