"""The small bag that comes with the sources: opens, is whole, and replays to what was recorded."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message

from polar_nav_msgs.msg import FixReceipt, NavState
from polar_nav_ros.stamps import to_ns
from polar_nav_tools.bags import open_bag
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import load_inputs

REFERENCE = Path(__file__).parents[1] / 'bags' / 'reference'


def test_reference_bag_replays_to_what_was_recorded():
    """To a millionth of sigma: another CPU model may round otherwise."""
    bag = open_bag(REFERENCE)
    assert bag.problems == []
    inputs = load_inputs(bag)
    result = replay(inputs)
    states = result.of('nav/state')
    # By the definition in the bag, which may be of an earlier version.
    live = [message for _, message in bag.read('/follower/nav/state')]
    assert len(states) == len(live) > 100
    for a, replayed in zip(live, states, strict=True):
        b = deserialize_message(replayed, NavState)
        assert to_ns(a.header.stamp) == to_ns(b.header.stamp)
        sigma = np.sqrt(np.diagonal(np.reshape(a.position_covariance_g, (3, 3))))
        assert np.linalg.norm(a.r_e - b.r_e) < 1e-6 * sigma.min()
        np.testing.assert_allclose(a.position_covariance_g, b.position_covariance_g, rtol=1e-6)
    verdicts = [
        [deserialize_message(d, FixReceipt).verdict_text for d in messages]
        for messages in (inputs.live['nav/receipt'], result.of('nav/receipt'))
    ]
    assert verdicts[0] == verdicts[1]
    assert 'FUSED' in verdicts[0]
