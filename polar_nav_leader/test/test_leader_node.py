"""The leader node in process: it navigates, publishes odometry, and says who else does. Ring 2."""

import os
import time
from dataclasses import replace

import pytest

rclpy = pytest.importorskip('rclpy')

import leader_messages as messages  # noqa: E402
from closed_loop import World  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import Imu, NavSatFix  # noqa: E402

from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_core.params import to_mapping  # noqa: E402
from polar_nav_leader.leader_node import LeaderNode  # noqa: E402
from polar_nav_leader.params import LeaderParams  # noqa: E402
from polar_nav_msgs.msg import AcousticPacket, Command, Depth, Dvl, NavState, UsblFix  # noqa: E402
from polar_nav_ros.qos import DATA_QOS  # noqa: E402

KINDS = {'imu/data_raw': Imu, 'dvl/data': Dvl, 'depth/data': Depth, 'usbl/fix': UsblFix}
HEARD = {
    'nav/state': NavState,
    'odometry': Odometry,
    'acomms/tx': AcousticPacket,
    'nav/command': Command,
}


@pytest.fixture(autouse=True)
def _surroundings(monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    yield
    rclpy.try_shutdown()


class Rig:
    """A leader node, someone who feeds it, and someone who listens."""

    def __init__(self, params):
        usual = to_mapping(LeaderParams())
        changed = {k: v for k, v in to_mapping(params).items() if v != usual[k]}
        args = ['--ros-args', '-r', '__ns:=/leader', '-p', 'initialize:=parameters']
        for name, value in changed.items():
            args += ['-p', f'{name}:={value}']
        rclpy.init(args=args, domain_id=60 + os.getpid() % 20)
        self.node = LeaderNode()
        self.peer = rclpy.create_node('peer', namespace='/leader', use_global_arguments=False)
        self.got = {topic: [] for topic in HEARD}
        self.health = []
        for topic, kind in HEARD.items():
            self.peer.create_subscription(kind, topic, self.got[topic].append, DATA_QOS)
        self.peer.create_subscription(
            DiagnosticArray, '/diagnostics', lambda m: self.health.append(m.status[0]), 10
        )
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)

    def until(self, done, seconds=30.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()


MAPPING = """
version: 2
imu: {topic: /ship/imu, type: sensor_msgs/msg/Imu}
dvl: {topic: /ship/dvl, type: polar_nav_msgs/msg/Dvl}
depth: {topic: /ship/depth, type: polar_nav_msgs/msg/Depth}
fixes: {topic: /ship/gnss, type: sensor_msgs/msg/NavSatFix, source: gnss, sigma: 1.0}
"""


@pytest.fixture(scope='module')
def world():
    return World(4)


def test_navigates_publishes_and_broadcasts(world):
    rig = Rig(world.params(LeaderParams, navigation='own'))
    pubs = {t: rig.peer.create_publisher(kind, t, DATA_QOS) for t, kind in KINDS.items()}
    rig.until(lambda: all(p.get_subscription_count() == 1 for p in pubs.values()))
    pubs['usbl/fix'].publish(messages.usbl(int(world.stamps[200])))
    counts = dict.fromkeys(KINDS, 0)
    for topic, message in messages.stream(world, 4.0):
        pubs[topic].publish(message)
        counts[topic] += 1
    counts['usbl/fix'] = 1
    rig.until(lambda: all(rig.node.taken_counts()[f'/leader/{t}'] == n for t, n in counts.items()))
    rig.until(lambda: len(rig.got['acomms/tx']) == 1)
    before = len(rig.got['nav/state'])
    rig.node.close()
    # The reorder window is flushed, and a command says where the run ended.
    rig.until(lambda: len(rig.got['nav/state']) == 40)
    assert before < 40
    rig.until(lambda: len(rig.got['odometry']) == 40)
    rig.until(lambda: rig.got['nav/command'])
    assert rig.got['nav/command'][-1].kind == Command.SHUTDOWN
    assert rig.node.diagnose().values['sent'] == 1


def test_inactive_it_navigates_and_is_silent_to_others(world):
    rig = Rig(world.params(LeaderParams, navigation='own', autostart=False))
    assert not rig.node.taken_counts()
    assert 'unconfigured: not navigating' in rig.node.diagnose().message
    rig.node.trigger_configure()
    pubs = {t: rig.peer.create_publisher(kind, t, DATA_QOS) for t, kind in KINDS.items()}
    rig.until(lambda: all(p.get_subscription_count() == 1 for p in pubs.values()))
    pubs['usbl/fix'].publish(messages.usbl(int(world.stamps[200])))
    for topic, message in messages.stream(world, 4.0):
        pubs[topic].publish(message)
    rig.until(lambda: rig.node.diagnose().values.get('sent') == 1)
    rig.until(lambda: len(rig.got['nav/state']) > 20)
    assert 'outputs are silent' in rig.node.diagnose().message
    published = rig.node.published_counts()
    assert not any(published[f'/leader/{t}'] for t in ('odometry', 'acomms/tx', 'broadcast'))
    rig.node.trigger_activate()
    rig.node.close()
    rig.until(lambda: rig.got['odometry'])


@pytest.mark.slow
def test_a_second_source_of_odometry_is_an_error(world):
    rig = Rig(world.params(LeaderParams, navigation='own'))
    rig.peer.create_publisher(Odometry, 'odometry', DATA_QOS)
    rig.until(
        lambda: any('odometry is also published by /leader/peer' in h.message for h in rig.health)
    )
    assert rig.health[-1].level == b'\x02'


def test_told_by_odometry_it_publishes_none():
    rig = Rig(LeaderParams())
    assert set(rig.node.taken_counts()) == {'/leader/odometry', '/leader/usbl/fix'}
    assert set(rig.node.published_counts()) == {'/leader/broadcast', '/leader/acomms/tx'}


def test_navigating_it_reads_none(world):
    rig = Rig(world.params(LeaderParams, navigation='own'))
    assert '/leader/odometry' not in rig.node.taken_counts()
    assert '/leader/odometry' in rig.node.published_counts()


def test_navigates_by_its_own_drivers(world, tmp_path):
    path = tmp_path / 'mapping.yaml'
    path.write_text(MAPPING, encoding='utf-8')
    rig = Rig(replace(world.params(LeaderParams, navigation='own'), sources=str(path)))
    names = dict(zip(KINDS, ('/ship/imu', '/ship/dvl', '/ship/depth', 'usbl/fix'), strict=True))
    kinds = {names[t]: kind for t, kind in KINDS.items()} | {'/ship/gnss': NavSatFix}
    pubs = {t: rig.peer.create_publisher(kind, t, DATA_QOS) for t, kind in kinds.items()}
    rig.until(lambda: all(p.get_subscription_count() > 0 for p in pubs.values()))
    stamp_ns = int(world.stamps[200])
    pubs['usbl/fix'].publish(messages.usbl(stamp_ns))
    counts = dict.fromkeys(('/ship/imu', '/ship/dvl', '/ship/depth'), 0)
    for topic, message in messages.stream(world, 4.0):
        pubs[names[topic]].publish(message)
        counts[names[topic]] += 1
    rig.until(lambda: all(rig.node.taken_counts()[t] == n for t, n in counts.items()))
    rig.until(lambda: len(rig.got['acomms/tx']) == 1)
    rig.node.close()
    rig.until(lambda: len(rig.got['nav/state']) == 40 and len(rig.got['odometry']) == 40)
    assert rig.node.diagnose().values['source /ship/gnss'] == 'sensor_msgs/msg/NavSatFix, reliable'


def test_a_leader_that_follows_odometry_takes_no_mapping(tmp_path):
    with pytest.raises(ConfigError, match='with `navigation: own`'):
        LeaderParams(sources=str(tmp_path / 'mapping.yaml'))


def test_a_leader_takes_no_packets(world, tmp_path):
    path = tmp_path / 'mapping.yaml'
    path.write_text(MAPPING.replace('sensor_msgs/msg/NavSatFix', 'std_msgs/msg/UInt8MultiArray'))
    with pytest.raises(ConfigError, match='a leader takes positions, no packets'):
        Rig(replace(world.params(LeaderParams, navigation='own'), sources=str(path)))
