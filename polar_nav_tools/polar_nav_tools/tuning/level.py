"""Fixes without a height: of their three rows only two say something."""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.level import is_level
from polar_nav_core.grid import ecef_to_grid


def larger(fix: Fix, covariance_e: Array, by: float) -> Array:
    """Covariance (3, 3) times the square of a factor; a height that is not known stays so."""
    wider = by * by * covariance_e
    if is_level(fix):
        up = _up(fix)
        wider = wider + (1.0 - by * by) * (up @ covariance_e @ up) * np.outer(up, up)
    return np.asarray(wider)


def _up(fix: Fix) -> Array:
    C_e_G: Array = np.asarray(ecef_to_grid(fix.r_e))
    up: Array = C_e_G[2]
    return up
