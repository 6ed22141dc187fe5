"""A small bag played to subscribers in process."""

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import (  # noqa: E402
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)
from sensor_msgs.msg import Imu  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from polar_nav_tools.bags import BagWriter, open_bag  # noqa: E402
from polar_nav_tools.bags.qos import Qos  # noqa: E402
from polar_nav_tools.foreign.sources import open_source  # noqa: E402
from polar_nav_tools.play.order import Message  # noqa: E402
from polar_nav_tools.play.player import Player, wait_for_listeners  # noqa: E402
from polar_nav_tools.play.run import Options, prepared, rounds_of  # noqa: E402
from polar_nav_tools.play.tracks import Track  # noqa: E402

from bag_samples import IMU, START_NS, STEP_NS, imu, make  # noqa: E402  # isort: skip

COUNT = 20
TEXT, BEST = '/words', '/best_effort/imu'


@pytest.fixture(autouse=True)
def context(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '44')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def source(tmp_path):
    writer = BagWriter(tmp_path / 'bag', {})
    writer.add_topic(IMU, 'sensor_msgs/msg/Imu')
    writer.add_topic(BEST, 'sensor_msgs/msg/Imu', offered=[Qos(reliability='best_effort')])
    latched = Qos(durability='transient_local', depth=1)
    writer.add_topic(TEXT, 'std_msgs/msg/String', offered=[latched])
    writer.write(TEXT, make('std_msgs/msg/String', data='first'), START_NS)
    for k in range(COUNT):
        writer.write(IMU, imu(k), START_NS + k * STEP_NS)
        writer.write(BEST, imu(k), START_NS + k * STEP_NS)
    writer.finish()
    return open_source(tmp_path / 'bag')


def test_the_bytes_of_the_bag_arrive_with_its_qos(source):
    names = {IMU: '/a/imu', BEST: BEST, TEXT: TEXT}
    options = Options(start_s=0.05, clock_hz=50.0)
    played = prepared(source, names, options, say=pytest.fail)
    node = rclpy.create_node('both')
    player = Player(node, played.tracks.playable, clock=True)
    assert player.refused == {}
    got = []
    node.create_subscription(Imu, '/a/imu', got.append, 100, raw=True)
    # A reliable subscription does not match what is offered best effort.
    node.create_subscription(Imu, BEST, print, QoSProfile(depth=100))
    asking = {
        node.create_subscription(Imu, BEST, print, qos_profile_sensor_data): 1,
        node.create_subscription(Imu, '/a/imu', print, qos_profile_sensor_data): 1,
    }
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spin_until(executor, lambda: all(s.get_publisher_count() == n for s, n in asking.items()))
    spin_until(executor, lambda: player.matched()[IMU] == 2)
    assert player.matched()[BEST] == 1
    assert player.listeners() == {IMU, BEST, '/both'}
    (messages,) = rounds_of(source, options, played)
    ticks = 0
    for message in messages:
        ticks += message.topic == '/clock'
        player.publish(message)
    spin_until(executor, lambda: len(got) == COUNT - 5)
    recorded = list(open_bag(source.path).payloads(IMU))
    assert got == recorded[5:]
    assert ticks == 8  # of 20 ms in 0.14 s
    # Latched, and before the start: who comes late gets it all the same.
    words = []
    profile = QoSProfile(
        depth=1,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        reliability=ReliabilityPolicy.RELIABLE,
    )
    node.create_subscription(String, TEXT, words.append, profile)
    spin_until(executor, lambda: words)
    assert words[0].data == 'first'
    assert player.published == {IMU: COUNT - 5, BEST: COUNT - 5, TEXT: 1}


def test_what_is_no_cdr_is_counted_and_not_published(source):
    player = Player(
        rclpy.create_node('n'),
        prepared(source, {IMU: IMU}, Options(), say=pytest.fail).tracks.playable,
    )
    for data in (b'', b'\0\1', b'junk and more'):
        player.publish(Message(IMU, 0, data))
    assert player.published == {IMU: 0}
    assert player.unusable == {IMU: 3}


def test_a_type_without_support_is_refused_and_the_rest_plays(source):
    played = prepared(source, {IMU: IMU}, Options(), say=pytest.fail)
    (track,) = played.tracks.playable
    odd = Track('/odd', '/odd', 'std_msgs/msg/NoSuchThing', track.offer)
    player = Player(rclpy.create_node('n'), [odd, track])
    assert list(player.refused) == ['/odd']
    assert player.published == {IMU: 0}


class Hours:
    """Steady clock that passes only in pauses."""

    def __init__(self):
        self.now = 0

    def wait(self, matched, wanted, timeout_s):
        counts = lambda: matched(self.now / 1e9)  # noqa: E731
        return wait_for_listeners(
            lambda: {name for name, count in counts().items() if count},
            counts,
            wanted,
            timeout_s,
            now_ns=lambda: self.now,
            pause=self.pause,
            stopped=lambda: False,
        )

    def pause(self, seconds):
        self.now += round(seconds * 1e9)


def test_waiting_ends_when_subscribers_are_there_and_no_more_come():
    def matched(now_s):
        return {'/a': int(now_s > 2.0), '/b': int(now_s > 2.3)}

    for wanted in (['/a'], []):
        hours = Hours()
        assert hours.wait(matched, wanted, 10.0) == []
        assert 2.8e9 < hours.now < 2.9e9


def test_waiting_is_bounded():
    hours = Hours()
    assert hours.wait(lambda _: {'/a': 0, '/b': 1}, ['/a', '/b'], 10.0) == ['/a']
    assert hours.now < 11e9
    assert hours.wait(lambda _: {'/a': 0}, [], 1.0) == ['any topic']
    start, counts = hours.now, iter(range(10**9))
    assert hours.wait(lambda _: {'/a': next(counts)}, None, 1.0) == []  # always another one
    assert hours.now - start < 3.1e9


def spin_until(executor, condition):
    for _ in range(600):
        if condition():
            return
        executor.spin_once(timeout_sec=0.05)
    pytest.fail('it did not happen')
