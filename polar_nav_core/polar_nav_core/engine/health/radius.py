"""The circle that holds a horizontal position with 95 %."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...kernels.radius import radius_in_sigmas

_CONFIDENCE = 0.95
_LINE, _CIRCLE = 1.959963984540054, 2.447746830680816
"""Radius in sigmas for a position on a line (the two-sided normal quantile), and for equal sigmas
in all directions (sqrt(-2 ln 0.05))."""


def _nodes(count: int) -> Array:
    """Sines, cosines and weights of Gauss-Legendre on [0, pi/2], (3, count)."""
    places, weights = np.polynomial.legendre.leggauss(count)
    angles = 0.25 * np.pi * (places + 1.0)
    return np.array([np.sin(angles), np.cos(angles), weights])


_NODES = _nodes(64)


def radius_95(P: Array) -> float:
    """Radius of the circle about the estimate that holds the position with 95 % [m].

    Exact for a Gaussian error with this covariance (to 1e-6 of the radius); NaN where the matrix
    is no covariance.

    Parameters
    ----------
    P : (2, 2) array
        Covariance of the horizontal position [m^2].
    """
    mean, half = 0.5 * (P[0, 0] + P[1, 1]), 0.5 * (P[0, 0] - P[1, 1])
    spread = math.hypot(half, 0.5 * (P[0, 1] + P[1, 0]))
    large, small = mean + spread, mean - spread
    if not math.isfinite(large) or large < 0.0 or small < -1e-9 * large:
        return math.nan
    if large == 0.0:
        return 0.0
    ratio = math.sqrt(max(small, 0.0) / large)
    return math.sqrt(large) * radius_in_sigmas(ratio, _CONFIDENCE, _LINE, _CIRCLE, _NODES)
