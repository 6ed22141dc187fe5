"""Content of a packet: the position from a leader, or range and bearing from a station."""

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
    """Content of a packet's bytes; their length distinguishes the two kinds.

    Raises
    ------
    PacketError
        For damaged bytes, or bytes of an unknown format.
    """
    if len(data) == station_packet.SIZE:
        return station_packet.decode(data, near_ns)
    return packet.decode(data, near_ns)


def wrap_of(content: Content) -> int:
    """Modulus of the sequence number in the bytes."""
    return LEAST_WRAP if isinstance(content, StationReport) else 65536


def distance_of(content: Content) -> float:
    """Distance [m] from the sender to the transponder."""
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
