"""ROS time messages to and from integer nanoseconds, the only time keys of the project."""

from __future__ import annotations

import struct

from builtin_interfaces.msg import Time

NS = 1_000_000_000
_STAMP = {0x01: struct.Struct('<iI'), 0x00: struct.Struct('>iI')}


def to_ns(stamp: Time) -> int:
    """Nanoseconds of a time message."""
    return int(stamp.sec) * NS + int(stamp.nanosec)


def to_msg(stamp_ns: int) -> Time:
    """Time message of a number of nanoseconds."""
    sec, nanosec = divmod(stamp_ns, NS)
    return Time(sec=sec, nanosec=nanosec)


def stamp_ns_of_cdr(data: bytes) -> int:
    """``header.stamp`` of a serialized message whose first field is a std_msgs/Header.

    The rest is not decoded.
    """
    sec, nanosec = _STAMP[data[1]].unpack_from(data, 4)
    return int(sec) * NS + int(nanosec)
