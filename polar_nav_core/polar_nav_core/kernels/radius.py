"""Radius of the circle that holds a Gaussian error in the plane with a given probability."""

from __future__ import annotations

import math

from ..arrays import Array
from .cache import entry, kernel, routine

_STEPS = 6


@kernel
def _inside(radius: float, ratio: float, nodes: Array) -> float:
    """Probability within a circle for sigmas 1 and ``ratio``.

    The integral over the larger axis at x = R sin t of the normal density of x, times the
    probability of the other axis within R cos t; Gauss-Legendre on [0, pi/2].
    """
    total = 0.0
    for k in range(nodes.shape[1]):
        x, y = radius * nodes[0, k], radius * nodes[1, k]
        other = 1.0
        if ratio > 0.0:
            other = math.erf(y / (ratio * math.sqrt(2.0)))
        total += nodes[2, k] * math.exp(-0.5 * x * x) * other * y
    return 0.25 * math.pi * total * math.sqrt(2.0 / math.pi)


@entry
@routine
def radius_in_sigmas(
    ratio: float, confidence: float, least: float, most: float, nodes: Array
) -> float:
    """Return the radius in units of the larger sigma.

    Secants of `_inside`, which grows smoothly with the radius.

    Parameters
    ----------
    ratio : float
        Of the smaller sigma to the larger one.
    confidence : float
        Probability within the circle.
    least, most : float
        The radius for ratios of 0 and 1; every other one lies between.
    nodes : (3, n) array
        Sines and cosines of the angles t, and their weights on [-1, 1].
    """
    before, radius = least, most
    off_before = _inside(before, ratio, nodes) - confidence
    off = _inside(radius, ratio, nodes) - confidence
    for _ in range(_STEPS):
        if off == off_before:
            break
        step = off * (radius - before) / (off - off_before)
        before, off_before = radius, off
        radius -= step
        off = _inside(radius, ratio, nodes) - confidence
    return radius
