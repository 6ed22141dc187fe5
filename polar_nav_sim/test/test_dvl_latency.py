"""dvl_node with latency: what was valid earlier, sent and stamped later."""

import os

import pytest
from numpy.testing import assert_array_equal

rclpy = pytest.importorskip('rclpy')

from rclpy.parameter import Parameter  # noqa: E402

from polar_nav_sim.mission import load_mission  # noqa: E402
from polar_nav_sim.nodes.dvl_node import DvlNode  # noqa: E402
from polar_nav_sim.truth_cdr import encode  # noqa: E402


def sent(**values):
    """What the node publishes during one second of the racetrack."""
    parameters = [Parameter(name, value=value) for name, value in values.items()]
    node = DvlNode(namespace='follower', parameter_overrides=parameters)
    out = []
    node._data.publish = out.append
    for data in encode(load_mission('racetrack').truth('follower').samples(0, 101)):
        node._on_truth(data)
    node.destroy_node()
    return out


@pytest.fixture(autouse=True)
def _ros():
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    rclpy.init(domain_id=43)
    yield
    rclpy.try_shutdown()


def test_latency_moves_the_stamp_and_nothing_else():
    prompt, late = sent(), sent(latency_s=0.15)
    assert len(prompt) == 6
    assert len(late) == 5  # the ping at 1.0 s is still under way
    for a, b in zip(prompt, late, strict=False):
        earlier, later = (m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in (a, b))
        assert later - earlier == 150_000_000
        assert_array_equal(
            [a.velocity.x, a.velocity.y, a.velocity.z], [b.velocity.x, b.velocity.y, b.velocity.z]
        )
    assert {m.sound_speed for m in late} == {1440.0}
    assert {m.sound_speed for m in sent(assumed_sound_speed=1500.0)} == {1500.0}


def test_the_clock_moves_stamps_alone():
    prompt, late = sent(), sent(clock_offset_s=-2.0, clock_drift_ppm=100.0)
    for k, (a, b) in enumerate(zip(prompt, late, strict=True)):
        earlier, later = (m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in (a, b))
        assert later - earlier == -2 * 10**9 + 20_000 * k
        assert a.velocity == b.velocity
