"""`polar map --live`: a running graph is mapped by the code that maps a recording. Ring 2."""

import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.context import Context
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import FluidPressure, Imu

from polar_nav_ros import transforms
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.stamps import to_msg
from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.cli import main
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.listen import Listening

pytestmark = pytest.mark.slow

BEST_EFFORT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)


class Drivers(threading.Thread):
    """Drivers of a vehicle: IMU forward-right-down, a pressure, the position of a filter."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = rclpy.create_node('drivers', context=self.context)
        offer = self.node.create_publisher
        self.imu = offer(Imu, '/auv/imu', BEST_EFFORT)
        self.pressure = offer(FluidPressure, '/auv/pressure', BEST_EFFORT)
        self.pose = offer(PoseWithCovarianceStamped, '/auv/usbl/pose', 10)
        offer(Imu, '/auv/imu_spare', 10)
        self.mounted = transforms.Broadcaster(self.node) if transforms.HAS_TF else None
        if self.mounted is not None:  # once, before anybody listens
            lever = np.array([0.2, 0.0, 0.4])
            self.mounted.fix([transforms.transform('base_link', 'bar30', lever, np.eye(3))])
        self.done = threading.Event()

    def run(self) -> None:
        k = 0
        while not self.done.wait(0.01):
            stamp = to_msg(time.time_ns())
            imu = Imu()
            imu.header.stamp = stamp
            imu.linear_acceleration.z = -9.82 + 1e-6 * (k % 3)
            imu.angular_velocity.x = 1e-5 * (k % 2 + 1)
            self.imu.publish(imu)
            if k % 10 == 0:
                pressure = FluidPressure(fluid_pressure=2.0e5 + k)
                pressure.header.stamp = stamp
                pressure.header.frame_id = 'bar30'
                self.pressure.publish(pressure)
                pose = PoseWithCovarianceStamped()
                pose.header.stamp = stamp
                pose.header.frame_id = 'map'
                self.pose.publish(pose)
            k += 1

    def end(self) -> None:
        self.done.set()
        self.join()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def _domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(40 + os.getpid() % 20))


@pytest.fixture
def drivers(_domain: None) -> Iterator[Drivers]:
    found = Drivers()
    found.start()
    yield found
    found.end()


@pytest.mark.usefixtures('drivers')
def test_a_running_graph_is_mapped() -> None:
    with Listening() as listening:
        heard = listening.hear(3.0)
        text = guess(heard.source, None, heard.notes)
        folder = heard.source.path
        assert folder.exists()
    assert not folder.exists()
    assert '# A mapping for `follower_node' in text
    assert 'topic: /auv/imu\n  type: sensor_msgs/msg/Imu\n' in text
    assert 'rotation: frd' in text
    assert 'topic: /auv/pressure\n  type: sensor_msgs/msg/FluidPressure' in text
    if transforms.HAS_TF:
        assert '# by /tf_static: bar30 in base_link\n  lever_b: [0.2, 0.0, 0.4]' in text
    assert '- topic: /auv/usbl/pose' in text
    assert 'correlation_s: FILL_IN' in text  # a pose comes out of somebody's filter
    assert '# /auv/imu_spare: sensor_msgs/msg/Imu, nothing came' in text
    rate = next(n for n in heard.notes if n.startswith('/auv/imu: '))
    assert float(rate.split()[-3]) > 20.0
    filled = text
    for name, value in {
        'correlation_s': '5.0',
        'frame': 'earth',
        'imu': 'bmi088',
        'heading_deg': '0',
    }.items():
        filled = filled.replace(f'{name}: FILL_IN', f'{name}: {value}')
    mapping = mapping_file.parse(filled, 'heard')
    assert mapping.imu.stream.type == 'sensor_msgs/msg/Imu'
    assert mapping.fixes[0].correlation_s == 5.0


@pytest.mark.usefixtures('drivers')
def test_the_command_prints_a_mapping(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ['polar', 'map', '--live', '--seconds', '4', '--imu', 'bmi088']
    monkeypatch.setattr(sys, 'argv', arguments)
    assert main() == 0
    out, err = capsys.readouterr()
    assert 'topic: /auv/imu\n' in out
    assert 'imu: bmi088' in out
    assert '/auv/imu_spare: sensor_msgs/msg/Imu, nothing came' in err


@pytest.mark.usefixtures('_domain')
def test_a_graph_without_publishers_is_named() -> None:
    with (
        Listening() as listening,
        pytest.raises(
            BagError, match=r'nothing was heard in 1 s: no topic is published in ROS domain \d+'
        ),
    ):
        listening.hear(1.0)


@pytest.mark.parametrize('arguments', [[], ['--live', str(Path(__file__))]])
def test_a_bag_or_the_graph(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, 'argv', ['polar', 'map', *arguments])
    assert main() == 2
    assert 'give a bag, or --live' in capsys.readouterr().err
