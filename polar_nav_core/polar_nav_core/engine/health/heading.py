"""A heading that was unknown at the start: an error until fixes have shown it."""

from __future__ import annotations

import math

from .conditions import Condition, Culprit, Level

UNKNOWN = math.radians(45.0)
"""Sigma at the start from which on a heading counts as unknown [rad]: none for a linear filter."""
_KNOWN = math.radians(10.0)
_FEWEST = 10
"""Fixes used before a small sigma is believed."""


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
