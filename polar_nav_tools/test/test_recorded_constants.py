"""Bags whose definitions number a DVL's modes otherwise: read rightly; other changes: refused."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message

from polar_nav_msgs.msg import Dvl
from polar_nav_ros.cdr import to_bytes
from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.bags.decode import constants_of
from polar_nav_tools.replay.arrays_from_bag import load_arrays
from polar_nav_tools.replay.by_array import replay_arrays
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.recorded import load_inputs

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
DVL = '/follower/dvl/data'
PACKET = '/follower/acomms/rx'
EVERY = 7
MODES = ('DVL_MODE_BOTTOM', 'DVL_MODE_WATER')


def recorded_with(target, numbers, constants=()):
    """The reference bag as if it had been recorded with these mode numbers and constants.

    Every seventh ping says that it is one through the water.
    """
    source = open_bag(REFERENCE)
    given = constants_of(source.channel(DVL))
    count = 0
    with BagWriter(target, source.run_info) as writer:
        for topic in source.topics:
            described = source.definition(topic)
            text = described.text
            for name, value in [*zip(MODES, numbers, strict=True), *constants]:
                text = re.sub(rf'\b{name}\s*=\s*\d+', f'{name}={value}', text)
            described = dataclasses.replace(described, text=text)
            writer.add_topic(topic, described.type, described=described, counted=False)
        for m in source.records():
            data = m.data
            if m.topic == DVL:
                message = deserialize_message(data, Dvl)
                assert message.velocity_mode == given['DVL_MODE_BOTTOM']
                message.velocity_mode = numbers[count % EVERY == 1]
                data = to_bytes(message)
                count += 1
            writer.write(m.topic, data, m.log_time_ns, m.publish_time_ns)
    assert count > 100
    return open_bag(target)


@pytest.fixture(scope='module')
def own(tmp_path_factory):
    """Recorded with the installed numbers."""
    numbers = (Dvl.DVL_MODE_BOTTOM, Dvl.DVL_MODE_WATER)
    return recorded_with(tmp_path_factory.mktemp('bags') / 'own', numbers)


@pytest.mark.parametrize('numbers', [(0, 1), pytest.param((2, 1), marks=pytest.mark.slow)])
def test_modes_are_those_of_the_bag(own, tmp_path, numbers):
    other = recorded_with(tmp_path / 'other', numbers)
    assert constants_of(other.channel(DVL))['DVL_MODE_BOTTOM'] == numbers[0]
    expected, found = replay(load_inputs(own)), replay(load_inputs(other))
    assert found.sha256 == expected.sha256
    fast, slow = replay_arrays(load_arrays(other)), replay_arrays(load_arrays(own))
    np.testing.assert_array_equal(fast.estimates.r_e, slow.estimates.r_e)
    modes = load_arrays(other).columns['dvl/data']['velocity_mode']
    water = np.arange(len(modes)) % EVERY == 1
    np.testing.assert_array_equal(modes == Dvl.DVL_MODE_BOTTOM, ~water)


def test_another_constant_with_another_value_is_refused(tmp_path):
    numbers = (Dvl.DVL_MODE_BOTTOM, Dvl.DVL_MODE_WATER)
    bag = recorded_with(tmp_path / 'b', numbers, [('DVL_TYPE_PISTON', 5)])
    for load in (load_inputs, load_arrays):
        with pytest.raises(BagError, match=r'dvl/data .* DVL_TYPE_PISTON = 5 .* is 0 here'):
            load(bag)
