"""Fixes without a height: the one rule by which they are known, and what follows from it.

They are judged by two numbers, and their offsets are level. The rule asks for what a fix states:
once, before the filter adapts or enlarges its noise. From here on its degrees of freedom go with
it: into the streams of the filter, its outcome, its record and its receipt.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..grid import ecef_to_grid
from ..level import NO_HEIGHT
from .events import Fix


def is_level(fix: Fix) -> bool:
    """Whether a fix states that nothing is known of its height."""
    stated_e = fix.stated_covariance_e
    # As numbers: NumPy takes ten times as long for three.
    trace = stated_e.item(0, 0) + stated_e.item(1, 1) + stated_e.item(2, 2)
    if fix.polar is not None or not trace > NO_HEIGHT:
        return False
    up = np.asarray(ecef_to_grid(fix.r_e))[2]
    return bool(up @ stated_e @ up > NO_HEIGHT)


def degrees_of_freedom(fix: Fix) -> int:
    """How many numbers a fix is: two from a station or without a height, else three."""
    return 2 if fix.polar is not None or is_level(fix) else 3


def levelled(offset_G: Array, fix: Fix) -> Array:
    """Offset (3,) from an estimate, grid axes [m]; of a fix without a height it has none."""
    if not is_level(fix):
        return offset_G
    level_G: Array = offset_G * np.array([1.0, 1.0, 0.0])
    return level_G
