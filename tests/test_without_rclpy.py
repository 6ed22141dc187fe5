"""The stand-in for rclpy that emulated processors are tried with reads and writes the same."""

from collections import Counter
from importlib import import_module
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

import without_rclpy
from rclpy.serialization import deserialize_message

from polar_nav_ros.cdr import to_bytes
from polar_nav_tools.bags import open_bag

BAGS = Path(__file__).resolve().parents[1] / 'bags'


@pytest.mark.parametrize('name', ['reference_11', 'station'])
def test_messages_of_a_bag_are_read_and_written_as_rclpy_does(name):
    bag, seen = open_bag(BAGS / name), Counter()
    for record in bag.records(set(bag.topics)):
        seen[record.topic] += 1
        if seen[record.topic] > 20:
            continue
        package, _, kind = bag.channel(record.topic).type.split('/')
        kind = getattr(import_module(f'{package}.msg'), kind)
        message = deserialize_message(record.data, kind)
        again = without_rclpy.deserialize(record.data, kind)
        assert repr(again) == repr(message)
        assert without_rclpy.serialize(again) == to_bytes(message)
    assert len(seen) > 15
