"""The recorder as a node, with publishers in process and as a process that is killed. Ring 2."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_msgs.msg import Depth, LockstepAck  # noqa: E402
from polar_nav_ros.cdr import to_bytes  # noqa: E402
from polar_nav_ros.qos import DATA_QOS, LATCHED_QOS, RECORD_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg  # noqa: E402
from polar_nav_tools.bags import BagError, open_bag  # noqa: E402
from polar_nav_tools.record.recorder_node import RecorderNode  # noqa: E402

START_NS = 1_700_000_000_000_000_000


@pytest.fixture(autouse=True)
def context(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '43')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Bench:
    """A recorder and a node that talks, on one executor."""

    def __init__(self, output, **params):
        self.talker = rclpy.create_node('talker', namespace='/follower')
        values = {'output': str(output), 'quiet_time': 0.2, **params}
        self.recorder = RecorderNode(
            parameter_overrides=[Parameter(name, value=v) for name, v in values.items()]
        )
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.talker)
        self.executor.add_node(self.recorder)

    def spin_until(self, condition, seconds=15.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, 'it did not happen in time'
            self.executor.spin_once(timeout_sec=0.05)

    def count(self, topic):
        entry = self.recorder._recording.topics.get(topic)
        return entry.count if entry else 0

    def finish(self):
        self.recorder.close()
        path = self.recorder.bag_path
        self.executor.shutdown()
        self.recorder.destroy_node()
        self.talker.destroy_node()
        return open_bag(path)


def depth(k):
    message = Depth(depth=float(k), variance=0.01)
    message.header.stamp = to_msg(START_NS + k * 10_000_000)
    return message


@pytest.mark.slow
def test_everything_that_is_found_is_recorded(tmp_path):
    bench = Bench(tmp_path / 'b', run_info='{"seed": 5}')
    out = bench.talker.create_publisher(Depth, 'depth/data', DATA_QOS)
    quick = bench.talker.create_publisher(Depth, 'sonar', qos_profile_sensor_data)
    late = bench.talker.create_publisher(String, '/run_info', LATCHED_QOS)
    late.publish(String(data=json.dumps({'node': '/follower/talker', 'params': {'x': 1}})))
    bench.spin_until(
        lambda: out.get_subscription_count() == 1 and quick.get_subscription_count() == 1
    )
    for k in range(300):
        out.publish(to_bytes(depth(k)))
    for k in range(20):
        quick.publish(depth(k))
        bench.executor.spin_once(timeout_sec=0.01)
    bench.spin_until(lambda: bench.count('/follower/depth/data') == 300)
    bench.spin_until(lambda: bench.count('/follower/sonar') == 20)
    bench.spin_until(lambda: bench.count('/run_info') >= 2)
    bench.spin_until(lambda: bench.count('/diagnostics') >= 2)
    bag = bench.finish()
    assert bag.problems == []
    kept = [d for _, _, d in bag.messages(['/follower/depth/data'])]
    assert kept == [to_bytes(depth(k)) for k in range(300)]
    assert bag.node_params('/follower/talker') == {'x': 1}
    assert bag.node_params('/recorder_node')['quiet_time'] == 0.2
    assert bag.run_info['seed'] == 5
    assert bag.run_info['recorder']['log_time'] == 'reception'
    times = [t for _, t, _ in bag.messages()]
    assert times == sorted(times)
    assert abs(times[0] - time.time_ns()) < 60e9
    profiles = {t: bag.channel(t).metadata['offered_qos_profiles'] for t in bag.topics}
    assert 'best_effort' in profiles['/follower/sonar']
    assert 'transient_local' in profiles['/run_info']
    assert '/rosout' not in bag.topics
    status = [m for _, m in bag.read('/diagnostics')][-1].status[0]
    values = {v.key: v.value for v in status.values}
    assert {'messages', 'messages_per_s', 'bytes', 'file_bytes', 'lost'} <= values.keys()


@pytest.mark.parametrize('topic', ['nav/restore', 'nav/command', 'nav/clock', 'nav/inputs'])
def test_what_a_node_says_before_it_is_found_is_recorded(tmp_path, topic):
    """A follower that is started again, on a computer so busy that nobody finds it for a while."""
    talker = rclpy.create_node('follower_node', namespace='/follower')
    out = talker.create_publisher(Depth, topic, RECORD_QOS)
    for k in range(3):
        out.publish(depth(k))
    bench = Bench(tmp_path / 'b', topics=[f'/follower/{topic}:polar_nav_msgs/msg/Depth'])
    bench.spin_until(lambda: bench.count(f'/follower/{topic}') == 3)
    talker.destroy_node()
    kept = [d for _, _, d in bench.finish().messages([f'/follower/{topic}'])]
    assert kept == [to_bytes(depth(k)) for k in range(3)]


def test_lockstep_acknowledges_what_was_filed(tmp_path):
    topics = ['/follower/depth/data:polar_nav_msgs/Depth', '/run_info:std_msgs/msg/String']
    bench = Bench(tmp_path / 'b', lockstep=True, topics=topics)
    acks = []
    bench.talker.create_subscription(LockstepAck, '/lockstep/ack', acks.append, DATA_QOS)
    out = bench.talker.create_publisher(Depth, 'depth/data', DATA_QOS)
    bench.spin_until(lambda: acks and list(acks[-1].taken_matched) == [1])
    assert acks[-1].node == '/recorder_node'
    for k in range(50):
        out.publish(depth(k))
    bench.spin_until(lambda: list(acks[-1].taken_counts) == [50])
    # What nodes publish beside the lockstep is recorded, but not promised.
    assert list(acks[-1].taken_topics) == ['/follower/depth/data']
    bag = bench.finish()
    assert bag.run_info['recorder']['log_time'] == 'simulation'
    assert [t for _, t, _ in bag.messages(['/follower/depth/data'])] == [
        START_NS + k * 10_000_000 for k in range(50)
    ]
    assert bag.topics['/run_info'].count == 1
    assert bag.is_complete


def test_a_graph_in_which_nobody_publishes_is_named(tmp_path, monkeypatch):
    """Another ROS domain than that of the vehicle: the bag would have the recorder alone."""
    bench = Bench(tmp_path / 'b')
    said = []
    monkeypatch.setattr(bench.recorder, 'get_logger', lambda: SimpleNamespace(warning=said.append))
    found = [bench.recorder.diagnose() for _ in range(6)]
    text = 'no other node publishes anything in ROS domain 43: there is nothing to record'
    assert said == [text]
    assert [f.message == text for f in found] == [False] * 4 + [True] * 2
    monkeypatch.undo()
    out = bench.talker.create_publisher(Depth, 'depth/data', DATA_QOS)
    bench.spin_until(lambda: out.get_subscription_count() == 1)
    assert bench.recorder.diagnose().message != text
    out.publish(depth(0))
    bench.finish()


def test_last_words_are_kept(tmp_path):
    bench = Bench(tmp_path / 'b', topics=['/follower/depth/data:polar_nav_msgs/msg/Depth'])
    out = bench.talker.create_publisher(Depth, 'depth/data', DATA_QOS)
    bench.spin_until(lambda: out.get_subscription_count() == 1)
    for k in range(40):
        out.publish(depth(k))
    bag = bench.finish()  # nobody span since
    assert bag.topics['/follower/depth/data'].count == 40


def test_subscription_gives_way_to_a_best_effort_publisher(tmp_path):
    bench = Bench(tmp_path / 'b', topics=['/follower/sonar:polar_nav_msgs/msg/Depth'])
    out = bench.talker.create_publisher(Depth, 'sonar', qos_profile_sensor_data)
    bench.spin_until(lambda: out.get_subscription_count() == 1)
    out.publish(depth(1))
    bench.spin_until(lambda: bench.count('/follower/sonar') == 1)
    assert bench.finish().is_complete


@pytest.mark.parametrize(
    ('params', 'error', 'sentence'),
    [
        ({'topics': ['/x:whales/msg/Song']}, ConfigError, 'whales/msg/Song is not installed here'),
        ({'output': '/proc/version/b'}, BagError, 'cannot make this bag'),
        ({'depth': 3}, ConfigError, 'unknown parameter depth'),
    ],
)
def test_what_stops_it_at_the_start(tmp_path, params, error, sentence):
    values = {'output': str(tmp_path / 'b'), **params}
    with pytest.raises(error, match=sentence):
        RecorderNode(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
    assert not (tmp_path / 'b').exists()


def start(tmp_path, *arguments):
    return subprocess.Popen(
        [
            sys.executable,
            '-m',
            'polar_nav_tools.record.recorder_node',
            '--ros-args',
            '-p',
            f'output:={tmp_path / "b"}',
            *arguments,
        ],
        env={**os.environ, 'HOME': str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    )


def talk(process, seconds):
    """Publish at 500 Hz for a while to a recorder process; returns the number sent."""
    node = rclpy.create_node('talker', namespace='/follower')
    out = node.create_publisher(Depth, 'depth/data', DATA_QOS)
    end = time.monotonic() + 30
    while out.get_subscription_count() == 0:
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.02)
    sent, begin = 0, time.monotonic()
    while time.monotonic() - begin < seconds:
        message = depth(sent)
        message.variance = time.monotonic()
        out.publish(message)
        sent += 1
        time.sleep(max(0.0, begin + sent / 500 - time.monotonic()))
    return node, sent


@pytest.mark.live
def test_killed_recorder_leaves_a_bag_that_lacks_two_seconds_at_most(tmp_path):
    process = start(tmp_path)
    try:
        node, _ = talk(process, 3.0)
    finally:
        killed = time.monotonic()
        process.kill()
        process.wait(10)
        process.stderr.close()
    bag = open_bag(tmp_path / 'b')
    last = [m for _, m in bag.read('/follower/depth/data')][-1]
    assert killed - last.variance < 2.0
    assert not bag.is_complete
    node.destroy_node()


@pytest.mark.live
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_in_order(tmp_path, number):
    process = start(tmp_path)
    node, sent = talk(process, 0.5)
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors
    bag = open_bag(tmp_path / 'b')
    assert bag.is_complete
    assert bag.topics['/follower/depth/data'].count == sent
    node.destroy_node()


@pytest.mark.live
@pytest.mark.parametrize('what', ['b', 'b/b_0.mcap'])
def test_a_bag_that_is_removed_under_it_ends_it(tmp_path, what):
    process = start(tmp_path)
    node, _ = talk(process, 0.5)
    lost = tmp_path / what
    shutil.rmtree(lost) if lost.is_dir() else lost.unlink()
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 1
    assert 'b_0.mcap was removed or moved while it was being written' in errors
    assert 'Traceback' not in errors
    node.destroy_node()


@pytest.mark.live
def test_bad_parameter_is_one_sentence(tmp_path):
    process = start(tmp_path, '-p', 'flush_period:=7.0')
    _, errors = process.communicate(timeout=20)
    assert process.returncode != 0
    assert 'flush_period' in errors
    assert 'Traceback' not in errors
