"""A node in process: parameters, draining, acknowledgements, description. Ring 2."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.duration import Duration  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from polar_nav_core.engine.version import ENGINE_VERSION  # noqa: E402
from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_core.params import NodeParams, param  # noqa: E402
from polar_nav_msgs.msg import Depth, LockstepAck  # noqa: E402
from polar_nav_ros import node as ros_node  # noqa: E402
from polar_nav_ros import process, topics  # noqa: E402
from polar_nav_ros.diagnostics import Level  # noqa: E402
from polar_nav_ros.node import PolarNode  # noqa: E402
from polar_nav_ros.qos import BEST_EFFORT, DATA_QOS, LATCHED_QOS, QUEUE_DEPTH  # noqa: E402
from polar_nav_ros.stamps import stamp_ns_of_cdr, to_msg, to_ns  # noqa: E402


@dataclass(frozen=True)
class EchoParams(NodeParams):
    gain: float = param(2.0, 'm', 0.0, 10.0, 'Factor')


class Echo(PolarNode[EchoParams]):
    def __init__(self, **kwargs):
        super().__init__('echo', EchoParams, **kwargs)
        self.out = self.advertise(Depth, 'out')
        self.subscribe(Depth, 'in', self.on_depth)

    def on_depth(self, msg):
        self.out.publish(Depth(header=msg.header, depth=msg.depth * self.params.gain))


@pytest.fixture(autouse=True)
def _ros(monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init(domain_id=60 + os.getpid() % 20)
    yield
    rclpy.try_shutdown()


@pytest.fixture(params=[SingleThreadedExecutor, process._executor], ids=['asks', 'is told'])
def executor(request):
    """Executor of rclpy, and the one of processes, whose signal handlers are taken back."""
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    executor = request.param()
    yield executor
    executor.shutdown()
    for number, handler in handlers.items():
        signal.signal(number, handler)


def spin_until(executor, done, seconds=15.0):
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    assert done()


def test_takes_everything_publishes_and_acknowledges(executor):
    echo = Echo(parameter_overrides=[Parameter('lockstep', value=True)])
    peer = rclpy.create_node('peer')
    acks, got, infos = [], [], []
    peer.create_subscription(LockstepAck, ros_node.ACK_TOPIC, acks.append, DATA_QOS)
    peer.create_subscription(Depth, 'out', got.append, DATA_QOS)
    peer.create_subscription(String, topics.RUN_INFO, infos.append, LATCHED_QOS)
    source = peer.create_publisher(Depth, 'in', DATA_QOS)
    executor.add_node(echo)
    executor.add_node(peer)
    spin_until(
        executor,
        lambda: acks and acks[-1].taken_matched[0] == 1 and acks[-1].published_matched[0] == 1,
    )
    for i in range(500):
        source.publish(Depth(depth=float(i)))
    spin_until(executor, lambda: len(got) == 500 and acks[-1].taken_counts[0] == 500)
    assert [m.depth for m in got] == [2.0 * i for i in range(500)]
    assert list(acks[-1].published_counts) == [500]
    assert acks[-1].node == '/echo'
    spin_until(executor, lambda: bool(infos))
    assert json.loads(infos[0].data)['engine_version'] == ENGINE_VERSION
    assert json.loads(infos[0].data)['params'] == {
        'gain': 2.0,
        'lockstep': True,
        'presence': False,
    }
    echo.destroy_node()
    peer.destroy_node()


def test_what_moves_time_on_is_taken_last(executor):
    """A node that was held up does not find one of its inputs seconds ahead of the others."""
    node = ros_node.PolarNode('late', NodeParams)
    got = []
    # Made first, so that the executor would take it first.
    node.subscribe(Depth, 'clock', lambda m: got.append(('clock', m.depth)), after_others=True)
    node.subscribe(Depth, 'slow', lambda m: got.append(('slow', m.depth)))
    peer = rclpy.create_node('peer')
    clock, slow = (peer.create_publisher(Depth, t, DATA_QOS) for t in ('clock', 'slow'))
    executor.add_node(node)
    spin_until(
        executor, lambda: clock.get_subscription_count() == slow.get_subscription_count() == 1
    )
    for k in range(3):
        clock.publish(Depth(depth=float(k)))
        slow.publish(Depth(depth=float(k)))
    time.sleep(0.5)  # held up: all of it waits
    spin_until(executor, lambda: len(got) == 6)
    assert got == [(t, float(k)) for t in ('slow', 'clock') for k in range(3)]
    assert node.taken_counts() == {'/slow': 3, '/clock': 3}
    node.destroy_node()
    peer.destroy_node()


@pytest.mark.parametrize('lockstep', [False, True])
def test_a_best_effort_publisher_is_heard_but_in_lockstep(lockstep, executor):
    echo = Echo(parameter_overrides=[Parameter('lockstep', value=lockstep)])
    peer = rclpy.create_node('peer')
    executor.add_node(echo)
    executor.add_node(peer)
    source = peer.create_publisher(Depth, 'in', DATA_QOS)
    spin_until(executor, lambda: source.get_subscription_count() == 1)
    source.publish(Depth(depth=1.0))
    spin_until(executor, lambda: echo.taken_counts() == {'/in': 1})
    weak = peer.create_publisher(Depth, 'in', BEST_EFFORT)
    if lockstep:
        found = []
        peer.create_timer(1.0, lambda: found.append(weak.get_subscription_count()))
        spin_until(executor, lambda: bool(found))
        assert found == [0]
    else:
        spin_until(executor, lambda: weak.get_subscription_count() == 1)
        spin_until(executor, lambda: source.get_subscription_count() == 1)
        weak.publish(Depth(depth=2.0))
        source.publish(Depth(depth=3.0))
        spin_until(executor, lambda: echo.taken_counts() == {'/in': 3})  # the count goes on
    echo.destroy_node()
    peer.destroy_node()


def test_both_subscriptions_of_one_topic_hear_a_best_effort_publisher(executor):
    """An IMU whose orientation is a heading, too."""
    node, peer, got = ros_node.PolarNode('twice', NodeParams), rclpy.create_node('peer'), []
    for name in ('rates', 'heading'):
        node.subscribe(Depth, 'in', lambda _, n=name: got.append(n))
    weak = peer.create_publisher(Depth, 'in', BEST_EFFORT)
    executor.add_node(node)
    executor.add_node(peer)
    spin_until(executor, lambda: weak.get_subscription_count() == 2)
    weak.publish(Depth(depth=1.0))
    spin_until(executor, lambda: len(got) == 2)
    assert sorted(got) == ['heading', 'rates']
    node.destroy_node()
    peer.destroy_node()


@pytest.mark.parametrize(
    ('name', 'value', 'says'),
    [
        ('publish_decoded', True, 'publish_decoded of echo was retired .* are always published'),
        ('gian', 1.0, 'unknown parameter gian of echo; .*gain'),
        ('gain', 11.0, 'gain.*11.0'),
        ('gain', 3, 'write 5.0, not 5'),
    ],
)
def test_a_bad_parameter_is_named(name, value, says):
    with pytest.raises(ConfigError, match=says):
        Echo(parameter_overrides=[Parameter(name, value=value)])


@pytest.mark.parametrize(
    ('name', 'value', 'says'),
    [
        ('use_sim_time', 1, 'use_sim_time.*true or false'),
        ('qos_overrides./in.subscription.reliability', 'relaible', "'relaible' is refused"),
        ('qos_overrides./in.subscription.history', 'all', 'keep_last or keep_all'),
        ('qos_overrides./in.subscription.depth', 0, 'a whole number above 0'),
        ('qos_overrides./in.subscription.deadline', 1, 'deadline cannot be overridden'),
    ],
)
def test_what_rclpy_would_end_a_node_for_is_named(name, value, says):
    with pytest.raises(ConfigError, match=says):
        Echo(parameter_overrides=[Parameter(name, value=value)])


def test_qos_of_a_topic_that_is_not_there_is_named(monkeypatch):
    names = [f'qos_overrides.{topic}.subscription.depth' for topic in ('/in', '/inn')]
    echo = Echo(parameter_overrides=[Parameter(name, value=5) for name in names])
    said = []
    monkeypatch.setattr(echo, 'get_logger', lambda: SimpleNamespace(warning=said.append))
    for _ in range(20):
        echo._beat()
    assert said == [f'parameter {names[1]}: there is no such subscription']
    assert DATA_QOS.depth == QUEUE_DEPTH, 'of all other topics'
    echo.destroy_node()


def published_status(node, monkeypatch):
    """Status that a node publishes now."""
    published = []
    with monkeypatch.context() as patched:
        patched.setattr(node, '_diagnostics', SimpleNamespace(publish=published.append))
        node._publish_diagnosis()
    (status,) = published[0].status
    return status


def test_simulated_time_without_a_clock_is_named(monkeypatch):
    """Nothing has a time of arrival then; the graph looks as if it were well."""
    echo = Echo(parameter_overrides=[Parameter('use_sim_time', value=True)])
    said, status = [], published_status(echo, monkeypatch)
    assert status.level == bytes([Level.WARN])
    assert 'no /clock has come' in status.message
    monkeypatch.setattr(echo, 'get_logger', lambda: SimpleNamespace(warning=said.append))
    for _ in range(60):
        echo._beat()
    assert said == ['use_sim_time is true and no /clock has come: this node has no time']
    echo.destroy_node()
    echo = Echo()
    assert published_status(echo, monkeypatch).level == bytes([Level.OK])
    echo.destroy_node()


@pytest.mark.parametrize(
    ('args', 'says'),
    [
        (['--params-file', 'none.yaml'], 'none.yaml'),
        (['-p', 'gain:='], 'gain:='),
        (['-r', '__ns:=auv'], '__ns:=auv'),
        (['--loud'], 'unknown'),
    ],
)
def test_arguments_that_ros_does_not_take_are_a_sentence(args, says, capfd):
    rclpy.shutdown()
    assert process.run(Echo, ['--ros-args', *args]) == 2
    err = capfd.readouterr().err
    [said] = [line for line in err.splitlines() if line.startswith('after --ros-args: ')]
    assert says in said
    assert '/src/' not in said
    assert 'Traceback' not in err


def test_descriptor_tells_range_and_text():
    echo = Echo()
    about = echo.describe_parameter('gain')
    assert about.read_only
    assert about.description == 'Factor [m]'
    assert about.floating_point_range[0].to_value == 10.0
    echo.destroy_node()


def test_stamps_round_trip_and_are_read_from_bytes():
    for ns in (0, 1, 999_999_999, 1_772_323_200_123_456_789):
        assert to_ns(to_msg(ns)) == ns
        message = Depth()
        message.header.stamp = to_msg(ns)
        assert stamp_ns_of_cdr(bytes(serialize_message(message))) == ns


@pytest.mark.slow
def test_run_gives_exit_codes():
    code = (
        'import sys; sys.path.insert(0, sys.argv[1])\n'
        'from test_ros_node import Echo\n'
        'from polar_nav_ros.process import run\n'
        'sys.exit(run(Echo, sys.argv[2:]))'
    )
    here = str(Path(__file__).parent)
    bad = subprocess.run(
        [sys.executable, '-c', code, here, '--ros-args', '-p', 'gain:=99.0'],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert bad.returncode == 2
    assert 'gain' in bad.stderr
    assert 'Traceback' not in bad.stderr
    good = subprocess.Popen(
        [sys.executable, '-c', code, here],
        env={**os.environ, ros_node.SUPERVISED: '1'},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert good.stdout.readline().startswith('ready ')  # its handlers are in place
    good.send_signal(signal.SIGINT)
    _, err = good.communicate(timeout=30)
    assert good.returncode == 0, err
    assert 'Traceback' not in err


class Stuck(Echo):
    """Its middleware never shuts down."""

    def destroy_node(self):
        threading.Event().wait()


def test_a_middleware_that_does_not_shut_down_is_left_behind():
    code = (
        'import sys; sys.path.insert(0, sys.argv[1])\n'
        'from test_ros_node import Stuck\n'
        'from polar_nav_ros import process\n'
        'process.PATIENCE_S = 0.1\n'
        'sys.exit(process.run(Stuck, sys.argv[2:]))'
    )
    stuck = subprocess.Popen(
        [sys.executable, '-c', code, str(Path(__file__).parent)],
        env={**os.environ, ros_node.SUPERVISED: '1'},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert stuck.stdout.readline().startswith('ready ')
    stuck.send_signal(signal.SIGINT)
    _, err = stuck.communicate(timeout=60)
    assert stuck.returncode == 0, err
    assert 'the middleware did not shut down within 0.1 s' in err


def test_a_long_burst_does_not_keep_other_topics_waiting(executor):
    """What comes on another topic within the burst is taken within it."""
    order = []

    class Two(PolarNode[EchoParams]):
        def __init__(self):
            super().__init__('two', EchoParams)
            self.out = self.create_publisher(String, 'other', DATA_QOS)
            self.subscribe(String, 'other', lambda _: order.append('other'))
            self.subscribe(Depth, 'burst', self.on_burst, after_others=True, then=self.at_end)

        def on_burst(self, _):
            order.append('burst')
            if len(order) == 1:
                self.out.publish(String())
                assert self.out.wait_for_all_acked(Duration(seconds=10))

        def at_end(self):
            order.append('end')

    two, peer = Two(), rclpy.create_node('peer')
    burst = peer.create_publisher(Depth, 'burst', DATA_QOS)
    executor.add_node(two)
    executor.add_node(peer)
    spin_until(executor, lambda: burst.get_subscription_count() == 1)
    spin_until(executor, lambda: two.out.get_subscription_count() == 1)
    for _ in range(50):
        burst.publish(Depth())
    assert burst.wait_for_all_acked(Duration(seconds=10))
    spin_until(executor, lambda: order.count('burst') == 50)
    assert order.index('other') <= 12
    assert order.index('end') == 51
    two.destroy_node()
    peer.destroy_node()


def test_last_messages_reach_a_reader_that_was_held_up(capfd):
    """A stopped reader is named; one that goes on is told by a heartbeat what it has missed."""
    domain = str(60 + os.getpid() % 20)
    code = (
        'import sys, rclpy\n'
        'from polar_nav_msgs.msg import Depth\n'
        'from polar_nav_ros.qos import DATA_QOS\n'
        'rclpy.init()\n'
        'node, taken = rclpy.create_node("reader"), []\n'
        'node.create_subscription(Depth, "out", taken.append, DATA_QOS)\n'
        'while len(taken) < 20:\n'
        '    rclpy.spin_once(node)\n'
        'print([int(m.depth) for m in taken] == list(range(20)))'
    )
    reader = subprocess.Popen(
        [sys.executable, '-c', code],
        env={**os.environ, 'ROS_DOMAIN_ID': domain},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        echo = Echo()
        assert echo.out.wait_for_subscription(30.0)
        for depth in range(10):
            echo.out.publish(Depth(depth=float(depth)))
        assert echo.flush(30.0) == []
        reader.send_signal(signal.SIGSTOP)
        for depth in range(10, 20):
            echo.out.publish(Depth(depth=float(depth)))
        assert echo.flush(0.1) == ['/out']
        assert 'not all readers have the last messages of /out' in capfd.readouterr().err
        reader.send_signal(signal.SIGCONT)
        assert echo.flush(30.0) == []
        echo.destroy_node()
        assert reader.communicate(timeout=30.0)[0] == 'True\n'
    finally:
        reader.kill()
        reader.communicate()


@pytest.mark.parametrize('args', [['--help'], ['-h', '--ros-args', '-p', 'x:=1']])
def test_a_node_says_what_it_is_and_does_not_start(args, capsys):
    def unwanted():
        raise AssertionError('started')

    assert process.run(unwanted, args) == 0
    assert 'docs/parameters.md' in capsys.readouterr().out


def test_a_module_that_was_started_is_still_of_its_package(monkeypatch):
    """`python -m` calls it __main__; a replay looks for the node's package in /run_info."""
    monkeypatch.setitem(sys.modules, 'started', SimpleNamespace(__spec__=None))
    assert ros_node._package_of('started') == 'started'
    spec = SimpleNamespace(name='polar_nav_follower.follower_node')
    monkeypatch.setitem(sys.modules, '__main__', SimpleNamespace(__spec__=spec))
    assert ros_node._package_of('__main__') == 'polar_nav_follower'
