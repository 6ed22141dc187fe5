"""Real time: the truth waits for those it is told to expect, but not for ever. Ring 2."""

import time

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from polar_nav_core.params import NodeParams  # noqa: E402
from polar_nav_msgs.msg import VehicleTruth  # noqa: E402
from polar_nav_ros.node import PolarNode  # noqa: E402
from polar_nav_ros.stamps import to_ns  # noqa: E402
from polar_nav_sim.nodes.truth_node import TruthNode  # noqa: E402

pytestmark = pytest.mark.slow

SECONDS = 1.0
SAMPLES = 101


@pytest.fixture(autouse=True)
def context(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '65')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Listener(PolarNode[NodeParams]):
    """Takes truth; made as late as the test wants."""

    def __init__(self, **params):
        overrides = [Parameter(k, value=v) for k, v in params.items()]
        super().__init__('listener', NodeParams, parameter_overrides=overrides)
        self.stamps = []
        self.subscribe(
            VehicleTruth, '/follower/truth', lambda m: self.stamps.append(to_ns(m.header.stamp))
        )


def truth_node(**params):
    values = {'mission': 'demo', 'duration_s': SECONDS, 'exit_at_end': True, **params}
    return TruthNode(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])


def spin(executor, truth, seconds, until=lambda: False):
    """Spin until the mission is over, a condition holds, or the time is up; how long it took."""
    begin = time.monotonic()
    while truth.ended is None and time.monotonic() - begin < seconds and not until():
        executor.spin_once(timeout_sec=0.02)
    return time.monotonic() - begin


def test_nothing_is_published_before_everybody_is_there():
    truth = truth_node(expected_nodes=['/listener'], gather_s=60.0)
    executor = SingleThreadedExecutor()
    executor.add_node(truth)
    spin(executor, truth, 1.5)
    assert truth._next == 0
    listener = Listener(presence=True)
    executor.add_node(listener)
    spin(executor, truth, 30.0)
    # From the first sample to the last, although it came late.
    assert truth._next == len(listener.stamps) == SAMPLES
    assert listener.stamps[0] == truth._mission.start_ns
    assert listener.stamps == sorted(listener.stamps)
    executor.shutdown()
    for node in (truth, listener):
        node.destroy_node()


def test_the_wait_is_bounded_and_who_is_missing_is_named(capfd):
    truth = truth_node(expected_nodes=['/nobody'], gather_s=0.5)
    executor = SingleThreadedExecutor()
    executor.add_node(truth)
    took = spin(executor, truth, 20.0)
    assert truth._next == SAMPLES
    assert 0.5 + SECONDS < took < 10.0
    assert '/nobody has not been heard' in capfd.readouterr().err
    executor.shutdown()
    truth.destroy_node()


def test_without_anybody_to_expect_it_begins_at_once():
    truth = truth_node()
    executor = SingleThreadedExecutor()
    executor.add_node(truth)
    spin(executor, truth, 10.0, until=lambda: truth._next > 10)
    assert truth._next > 10
    spin(executor, truth, 10.0)
    assert truth._next == SAMPLES
    executor.shutdown()
    truth.destroy_node()


def test_presence_acknowledges_seldom():
    """In real time an acknowledgement of every message would cost more than the messages."""
    truth = truth_node(expected_nodes=['/listener'])
    listener = Listener(presence=True)
    executor = SingleThreadedExecutor()
    for node in (truth, listener):
        executor.add_node(node)
    spin(executor, truth, 30.0)
    assert len(listener.stamps) == SAMPLES
    assert 2 <= listener._ack_sequence < 30
    executor.shutdown()
    for node in (truth, listener):
        node.destroy_node()


def test_the_clock_waits_for_a_node_that_is_behind():
    truth = truth_node(expected_nodes=['/listener'], max_behind_s=0.1)
    listener = Listener(presence=True)
    together = SingleThreadedExecutor()
    for node in (truth, listener):
        together.add_node(node)
    spin(together, truth, 30.0, until=lambda: truth._next > 20)
    together.remove_node(listener)  # it takes nothing any more
    alone = SingleThreadedExecutor()
    alone.add_node(listener)
    spin(together, truth, 30.0, until=truth._some_node_is_behind)
    held = truth._next
    assert held < SAMPLES
    spin(together, truth, 0.5)
    assert truth._next == held
    together.add_node(listener)
    took = spin(together, truth, 30.0)
    assert truth._next == len(listener.stamps) == SAMPLES
    # What was waited is not made up for in a burst.
    assert took > (SAMPLES - held) / 100.0 - 0.6
    for executor in (together, alone):
        executor.shutdown()
    for node in (truth, listener):
        node.destroy_node()
