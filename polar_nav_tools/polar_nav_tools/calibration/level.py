"""Fixes without a height: of their three rows only two say something."""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array, Ints
from polar_nav_core.engine.events import Fix, Rank
from polar_nav_core.engine.innovations import Innovations
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.level import is_level
from polar_nav_core.grid import ecef_to_grid


def larger(fix: Fix, covariance_e: Array, by: float) -> Array:
    """Covariance (3, 3) times the square of a factor; a height that is not known stays so."""
    wider = by * by * covariance_e
    if is_level(fix):
        up = _up(fix)
        wider = wider + (1.0 - by * by) * (up @ covariance_e @ up) * np.outer(up, up)
    return np.asarray(wider)


def numbers(run: Innovations, inputs: Inputs) -> Ints:
    """How many numbers each measurement of a run is (n,): its rows, of a fix without height two.

    A measurement stands in the log with the stamp of the IMU sample that it was fused after.
    """
    level = [f.validity_ns for f in inputs.fixes if f.refusal is None and is_level(f)]
    stamps_ns = np.array(level, dtype=np.int64)
    before = np.searchsorted(inputs.imu_stamps_ns, stamps_ns, side='right') - 1
    at = inputs.imu_stamps_ns[np.maximum(before, 0)]
    flat = np.isin(run.stamps_ns, at) | np.isin(run.stamps_ns, stamps_ns)
    flat &= (run.ranks == Rank.FIX) & (run.sizes == 3)
    return np.asarray(run.sizes - flat, dtype=np.int64)


def _up(fix: Fix) -> Array:
    C_e_G: Array = np.asarray(ecef_to_grid(fix.r_e))
    up: Array = C_e_G[2]
    return up
