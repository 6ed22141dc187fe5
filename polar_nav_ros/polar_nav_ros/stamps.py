"""Conversion of ROS time messages to and from integer nanoseconds."""

from __future__ import annotations

import struct

from builtin_interfaces.msg import Time

NS = 1_000_000_000
_STAMP = {0x01: struct.Struct('<iI'), 0x00: struct.Struct('>iI')}


def to_ns(stamp: Time) -> int:
    """Stamp [ns] of a builtin_interfaces/Time."""
    return int(stamp.sec) * NS + int(stamp.nanosec)


def to_msg(stamp_ns: int) -> Time:
    """builtin_interfaces/Time of a stamp [ns]."""
    sec, nanosec = divmod(stamp_ns, NS)
    return Time(sec=sec, nanosec=nanosec)


def stamp_ns_of_cdr(data: bytes) -> int:
    """Stamp [ns] of a serialized message whose first field is a std_msgs/Header.

    The rest is not decoded.
    """
    sec, nanosec = _STAMP[data[1]].unpack_from(data, 4)
    return int(sec) * NS + int(nanosec)
