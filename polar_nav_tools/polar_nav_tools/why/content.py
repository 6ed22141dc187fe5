"""What a packet can say: a leader a position, a station range and bearing."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from polar_nav_core.link import packet, station_packet
from polar_nav_core.link.packet import Broadcast, PacketError
from polar_nav_core.link.station_packet import StationReport

Content: TypeAlias = Broadcast | StationReport

LEAST_WRAP = 256
"""Of the numbers in a station's packets; those in a leader's wrap at a multiple of it."""


def read_content(data: bytes, near_ns: int) -> Content:
    """Content of bytes; which kind they are, their length tells.

    Raises
    ------
    PacketError
        For damaged bytes, or those of no packet that is known.
    """
    if len(data) == station_packet.SIZE:
        return station_packet.decode(data, near_ns)
    return packet.decode(data, near_ns)


def wrap_of(content: Content) -> int:
    """Where the number in the bytes wraps."""
    return LEAST_WRAP if isinstance(content, StationReport) else 65536


def distance_of(content: Content) -> float:
    """From the sender to the transponder [m]."""
    if isinstance(content, StationReport):
        return content.range
    return float(np.linalg.norm(content.r_lf_G))


__all__ = [
    'LEAST_WRAP',
    'Content',
    'PacketError',
    'distance_of',
    'read_content',
    'wrap_of',
]
