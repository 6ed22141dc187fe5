"""The circle that holds a horizontal position with 95 %."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array

_CONFIDENCE = 0.95
_LINE, _CIRCLE = 1.959963984540054, 2.447746830680816
"""Radius in sigmas for a position on a line (the two-sided normal quantile), and for equal sigmas
in all directions (sqrt(-2 ln 0.05)); every other shape lies between."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_ANGLES = 0.25 * np.pi * (_NODES + 1.0)
_SINES, _COSINES = np.sin(_ANGLES), np.cos(_ANGLES)
_STEPS = 6


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
    return math.sqrt(large) * _sigmas(math.sqrt(max(small, 0.0) / large))


def _sigmas(ratio: float) -> float:
    """Radius in units of the larger sigma, for a ratio of the smaller sigma to the larger one.

    Secants of `_inside`, which grows smoothly with the radius.
    """
    before, radius = _LINE, _CIRCLE
    off_before, off = (_inside(r, ratio) - _CONFIDENCE for r in (before, radius))
    for _ in range(_STEPS):
        if off == off_before:
            break
        step = off * (radius - before) / (off - off_before)
        before, off_before = radius, off
        radius -= step
        off = _inside(radius, ratio) - _CONFIDENCE
    return radius


def _inside(radius: float, ratio: float) -> float:
    """Probability within a circle for sigmas 1 and ``ratio``.

    The integral over the larger axis at x = R sin t of the normal density of x, times the
    probability of the other axis within R cos t; Gauss-Legendre on [0, pi/2].
    """
    x, y = radius * _SINES, radius * _COSINES
    other = np.ones(len(y)) if ratio == 0.0 else _erf(y / (ratio * math.sqrt(2.0)))
    values = np.exp(-0.5 * x * x) * other * y
    return float(0.25 * np.pi * (_WEIGHTS @ values) * math.sqrt(2.0 / np.pi))


def _erf(values: Array) -> Array:
    return np.array([math.erf(v) for v in values])
