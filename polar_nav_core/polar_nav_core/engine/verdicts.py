"""Verdicts on messages, and the refusal of one."""

from __future__ import annotations

from enum import IntEnum
from typing import TypeAlias


class Verdict(IntEnum):
    """Verdict on a message; the numbers are those of polar_nav_msgs/FixReceipt."""

    FUSED = 0
    GATED = 1
    DUPLICATE = 2
    TOO_OLD = 3
    TOO_LATE = 4
    FROM_FUTURE = 5
    NOT_FINITE = 6
    BAD_CRC = 7
    BAD_MAC = 8
    UNKNOWN_SOURCE = 9
    IN_FLIGHT = 10
    NOT_READY = 11
    BAD_FORMAT = 12
    IMPLAUSIBLE = 13
    REPLAYED = 14
    SWITCHED_OFF = 15


Refusal: TypeAlias = tuple[Verdict, str]
"""Verdict on a message that is not used, and the reason."""
