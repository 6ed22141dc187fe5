"""A heading that was unknown at the start, or was lost: an error until something has shown it."""

from __future__ import annotations

import math
from typing import NamedTuple

from .conditions import Condition, Culprit, Level

UNKNOWN = math.radians(45.0)
"""Sigma at the start from which on a heading counts as unknown [rad]: none for a linear filter."""
_KNOWN = math.radians(10.0)
_FEWEST = 10
"""Fixes used before a small sigma is believed."""


class LostHeading(NamedTuple):
    """A heading with which a navigation began anew.

    Attributes
    ----------
    anew_ns : int
        When [ns].
    shown_after_ns : int
        A DVL, an AHRS or a compass that was used after this has measured it [ns].
    """

    anew_ns: int
    shown_after_ns: int


def heading_unknown(at_start: float, now: float, fused: int) -> list[Condition]:
    """The condition that a heading is not known yet, if it is not.

    Parameters
    ----------
    at_start, now : float
        Sigma of the heading [rad]: stated, and published now.
    fused : int
        Position fixes that were used so far.
    """
    if at_start < UNKNOWN or (now < _KNOWN and fused >= _FEWEST):
        return []
    sentence = (
        f'heading is not known yet ({math.degrees(now):.0f} deg stated, {fused} fixes used): '
        'no estimate is to be trusted'
    )
    return [Condition('heading unknown', Level.ERROR, Culprit.HEADING, sentence)]


def heading_lost(now: float, since_s: float, *, measured: bool) -> list[Condition]:
    """The condition that a heading, with which a navigation began anew, is not known yet.

    Fixes alone show none on a straight course, and what a filter takes for news of it there may
    be its tilt's: small sigmas are believed once something has measured it.

    Parameters
    ----------
    now, since_s : float
        Published sigma of the heading [rad]; time since the navigation began anew [s].
    measured : bool
        Whether a DVL, an AHRS or a compass was used since.
    """
    if measured and now < _KNOWN:
        return []
    by = (
        f'{math.degrees(now):.0f} deg stated'
        if measured
        else 'no DVL, AHRS or compass has shown it'
    )
    sentence = f'heading is not known since the navigation began anew {since_s:.0f} s ago: {by}'
    return [Condition('heading unknown', Level.ERROR, Culprit.HEADING, sentence)]
