"""CRC-32 as MCAP uses it."""

from __future__ import annotations

try:
    from isal.isal_zlib import crc32
except ModuleNotFoundError:  # a ROS 2 from apt: the same numbers, slower
    from zlib import crc32

__all__ = ['crc32']
