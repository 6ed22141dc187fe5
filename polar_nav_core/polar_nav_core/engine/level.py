"""Fixes without a height, as the engine judges them: by two numbers, and by level offsets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import Array
from ..grid import ecef_to_grid
from ..level import NO_HEIGHT
from .events import Fix
from .results import Outcome, chi2_gate


def is_level(fix: Fix) -> bool:
    """Whether a fix states that nothing is known of its height."""
    if fix.polar is not None or not np.trace(fix.covariance_e) > NO_HEIGHT:
        return False
    up = np.asarray(ecef_to_grid(fix.r_e))[2]
    return bool(up @ fix.covariance_e @ up > NO_HEIGHT)


def size_of(fix: Fix) -> int:
    """How many numbers a fix is: two from a station or without a height, else three."""
    return 2 if fix.polar is not None or is_level(fix) else 3


def in_its_size(outcome: Outcome, fix: Fix, gate_probability: float) -> Outcome:
    """Outcome of a fix with the degrees of freedom, and the gate, of as many numbers as it is."""
    if outcome.dof != 3 or not is_level(fix):
        return outcome
    return replace(outcome, dof=2, gate=chi2_gate(gate_probability, 2))


def levelled(offset_G: Array, fix: Fix) -> Array:
    """Offset (3,) from an estimate, grid axes [m]; of a fix without a height it has none."""
    if not is_level(fix):
        return offset_G
    level_G: Array = offset_G * np.array([1.0, 1.0, 0.0])
    return level_G
