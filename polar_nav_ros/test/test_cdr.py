"""Bytes that depend on content only: gaps are zero, content is untouched, in all our messages."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message

import polar_nav_msgs.msg as messages
from polar_nav_msgs.msg import Command, FixReceipt, NavState
from polar_nav_ros.cdr import _steps_of, to_bytes

ALL = [
    getattr(messages, n)
    for n in sorted(dir(messages))
    if not n.startswith('_') and n[0].isupper() and 'Metaclass' not in n
]


def filled(message_type):
    """Strings of odd lengths everywhere, so that gaps appear."""
    message = message_type()
    for i, (name, kind) in enumerate(message.get_fields_and_field_types().items()):
        if kind == 'string':
            setattr(message, name, 'x' * (i % 7 + 1))
        elif kind == 'std_msgs/Header':
            message.header.frame_id = 'odd'
        elif kind == 'sequence<string>':
            setattr(message, name, ['a', 'bcd', 'ef'])
        elif kind in ('sequence<uint64>', 'sequence<int64>', 'sequence<uint16>'):
            setattr(message, name, [1, 2, 3])
        elif kind == 'sequence<uint8>':
            setattr(message, name, b'12345')
    return message


@pytest.mark.parametrize('message_type', [*ALL, Odometry])
def test_content_survives_and_the_walk_ends_with_the_message(message_type):
    message = filled(message_type)
    data = to_bytes(message)
    assert repr(deserialize_message(data, message_type)) == repr(message)
    end = 4 + _steps_of(message_type)(bytearray(data), 0)
    assert len(data) - 4 < end <= len(data)


@pytest.mark.parametrize('message_type', [NavState, FixReceipt, Command])
def test_garbage_in_the_gaps_is_removed(message_type):
    clean = to_bytes(filled(message_type))
    dirty = bytearray(clean)
    base = bytearray(serialize_message(filled(message_type)))
    assert len(base) == len(clean)
    content = repr(filled(message_type))
    flipped = 0
    for i in range(4, len(clean)):
        one = bytearray(clean)
        one[i] ^= 0xFF
        try:
            same = repr(deserialize_message(bytes(one), message_type)) == content
        except Exception:  # noqa: BLE001 - whatever a decoder says of a broken length
            same = False
        if same and clean[i] == 0:
            dirty[i] ^= 0xFF
            flipped += 1
    assert flipped > 0
    _steps_of(message_type)(dirty, 0)
    assert bytes(dirty) == clean


def test_the_same_content_gives_the_same_bytes_whatever_memory_held():
    seen = set()
    for i in range(200):
        np.random.default_rng(i).bytes(1000)
        seen.add(to_bytes(filled(FixReceipt)))
    assert len(seen) == 1
