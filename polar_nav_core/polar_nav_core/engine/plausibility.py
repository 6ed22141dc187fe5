"""Limits of what a sensor can say, for one value or for the columns of a whole run.

What lies beyond them is no measurement, whatever its stated covariance: it is refused with a
receipt (IMPLAUSIBLE) before any filter sees it. The limits of rates and forces are parameters;
those here are of the Earth, of numbers, and of covariances. Comparisons are written so that NaN
fails them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from ..arrays import Array, Bools
from ..earth import ecef_from_geodetic
from ..kernels.limits import AXIS
from .events import Fix, InitialState

LEAST_VARIANCE: Final = 1e-12
MOST_VARIANCE: Final = 1e12
"""Of any measurement, in the square of its unit: no sensor is good to a micrometre, and a sigma
of 1,000 km says nothing."""
LEAST_PING_VARIANCE: Final = 1e-6
"""No ping is better than 1 mm/s along an axis: what states less says nothing [m^2/s^2]."""
LEAST_ANTENNA_SIGMA: Final = 0.01
"""No antenna is better than what a base station and its phases give [m]."""
LEAST_HEIGHT_SIGMA: Final = 0.01
"""Nor is the height of a fix, from depth sensors or an antenna [m]."""
LEAST_DEPTH: Final = -50.0
"""A depth above it is none: air pressure, tide, geoid and heave are tens of metres at most [m]."""
NO_GRID_NORTH: Final = 'grid north is undefined on the equator at longitude +-90 deg'
MOST_RANGE: Final = 1e6
"""Farthest that an acoustic range can be [m]."""
_LEAST_PIVOT = 1e-12
"""Of the Cholesky factors of a correlation matrix."""
_ASYMMETRY = 1e-6
"""Largest difference of two correlations that are the same one."""
_ROUNDING = 1e-3
"""Share of a variance that is lost where it is turned to other axes, and by the vertical here."""
_ORTHOGONALITY = 1e-3
"""Largest element of C C^T - I of an attitude matrix."""

_INITIAL: Final = {
    'latitude': (-0.5 * math.pi, 0.5 * math.pi),
    'longitude': (-2.0 * math.pi, 2.0 * math.pi),
    'height': (-12000.0, 9000.0),
    'roll': (-math.pi, math.pi),
    'pitch': (-0.5 * math.pi, 0.5 * math.pi),
    'grid_heading': (-2.0 * math.pi, 2.0 * math.pi),
    'sigma_position_horizontal': (1e-3, 1e6),
    'sigma_position_vertical': (1e-3, 1e6),
    'sigma_velocity': (1e-6, 100.0),
    'sigma_tilt': (1e-9, 0.5 * math.pi),
    'sigma_heading': (1e-9, math.pi),
}
"""Limits of an initial state, those of the parameters initial_*, SI units and radians."""
_SLACK = 1.0 + 1e-9
"""A limit in degrees is still met after its conversion to radians."""
_INITIAL_SPEED = 50.0


def within(values: Array, limit: float) -> bool:
    """Whether each of three values is finite and at most ``limit`` in size."""
    # As numbers: NumPy takes several times as long for three.
    x, y, z = values.tolist()
    return bool(-limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit)


def all_within(values: Array, limit: float) -> Bools:
    """Mask (n,) of the rows of a (n, k) array whose values `within` accepts."""
    if not values.size or np.abs(values).max() <= limit:  # nearly always
        return np.ones(len(values), dtype=bool)
    return np.asarray((np.abs(values) <= limit).all(axis=1))


def is_covariance(P: Array) -> bool:
    """Whether a matrix (3, 3) is a covariance: symmetric, positive definite, of usual size."""
    ((a, ab, ac), (ba, b, bc), (ca, cb, c)) = P.tolist()
    least, most = LEAST_VARIANCE, MOST_VARIANCE
    if not (least <= a <= most and least <= b <= most and least <= c <= most):
        return False
    ra, rb, rc = math.sqrt(a), math.sqrt(b), math.sqrt(c)
    x, y, z = ab / (ra * rb), ac / (ra * rc), bc / (rb * rc)
    if not (
        abs(x - ba / (ra * rb)) <= _ASYMMETRY
        and abs(y - ca / (ra * rc)) <= _ASYMMETRY
        and abs(z - cb / (rb * rc)) <= _ASYMMETRY
    ):
        return False
    # The squares of the pivots of the correlation matrix (1, x, y; x, 1, z; y, z, 1).
    second = 1.0 - x * x
    if not second > _LEAST_PIVOT:
        return False
    rest = z - x * y
    return bool(1.0 - y * y - rest * rest / second > _LEAST_PIVOT)


def are_covariances(P: Array) -> Bools:
    """Mask (n,) of the matrices of a (n, 3, 3) array that `is_covariance` accepts."""
    with np.errstate(all='ignore'):
        variances = np.diagonal(P, axis1=1, axis2=2)
        good = ((variances >= LEAST_VARIANCE) & (variances <= MOST_VARIANCE)).all(axis=1)
        roots = np.sqrt(variances)
        scales = roots[:, [0, 0, 1]] * roots[:, [1, 2, 2]]
        x, y, z = (P[:, [0, 0, 1], [1, 2, 2]] / scales).T
        lower = (P[:, [1, 2, 2], [0, 0, 1]] / scales).T
        for upper, other in zip((x, y, z), lower, strict=True):
            good &= np.abs(upper - other) <= _ASYMMETRY
        second = 1.0 - x * x
        rest = z - x * y
        good &= second > _LEAST_PIVOT
        good &= 1.0 - y * y - rest * rest / second > _LEAST_PIVOT
    return np.asarray(good)


def are_too_sure(P: Array) -> Bools:
    """Whether each covariance (..., 3, 3) states less noise than the best pings have."""
    return np.asarray((np.diagonal(P, axis1=-2, axis2=-1) < LEAST_PING_VARIANCE).any(axis=-1))


def widened_pings(P: Array, sigma: float) -> Array:
    """Covariances (..., 3, 3) of pings; where an axis states less than the best have, with sigma.

    The same array where none does, as nearly always. Parameter ``sigma`` [m/s] is that of pings
    that state none.
    """
    if not are_too_sure(P).any():
        return P
    variances = np.diagonal(P, axis1=-2, axis2=-1)
    usual = max(sigma * sigma, LEAST_PING_VARIANCE)
    short = np.where(variances < LEAST_PING_VARIANCE, usual - variances, 0.0)
    return np.asarray(P + short[..., None] * np.eye(3))


def best_sigma(fix: Fix, min_fix_sigma: float) -> float:
    """1-sigma [m] of the best fix of this kind: the parameter, for an antenna a smaller one."""
    antenna = math.isfinite(fix.surface_depth)
    return min(min_fix_sigma, LEAST_ANTENNA_SIGMA) if antenna else min_fix_sigma


def believed(fix: Fix, min_fix_sigma: float) -> Fix:
    """The same fix, or one that is as good as the best of its kind in each horizontal direction.

    Its height, which may come from depth sensors, has LEAST_HEIGHT_SIGMA at least.
    """
    sigma = best_sigma(fix, min_fix_sigma)
    if sigma == 0.0 or fix.polar is not None:
        return fix
    least = sigma * sigma
    ((a, x, y), (_, b, z), (_, _, c)) = fix.covariance_e.tolist()
    # No variance in any direction is below the least of these (Gershgorin): nearly always enough.
    if min(a - abs(x) - abs(y), b - abs(x) - abs(z), c - abs(y) - abs(z)) >= least:
        return fix
    u, v, w = fix.r_e.tolist()
    square = u * u + v * v + w * w  # of the radius: up is along it, to 0.2 deg
    up = u * (a * u + 2.0 * x * v + 2.0 * y * w) + v * (b * v + 2.0 * z * w) + c * w * w
    up /= square
    # The sum of both horizontal eigenvalues, and their product: that of the adjugate along up.
    total = a + b + c - up
    product = u * ((b * c - z * z) * u + 2.0 * (y * z - x * c) * v + 2.0 * (x * z - y * b) * w)
    product += v * ((a * c - y * y) * v + 2.0 * (x * y - z * a) * w) + (a * b - x * x) * w * w
    product /= square
    smaller = 0.5 * total - math.sqrt(max(0.25 * total * total - product, 0.0))
    short = max(0.0, least - smaller)
    short_up = max(0.0, min(least, LEAST_HEIGHT_SIGMA**2) - up)
    if short <= _ROUNDING * least and short_up == 0.0:
        return fix
    along = np.outer(fix.r_e, fix.r_e) / square
    wider_e = fix.covariance_e + short * (np.eye(3) - along) + short_up * along
    return fix.believed_to(wider_e)


def is_variance(value: float) -> bool:
    """Whether a variance is of usual size."""
    return LEAST_VARIANCE <= value <= MOST_VARIANCE


def is_attitude(C: Array) -> bool:
    """Whether a matrix (3, 3) is orthogonal, in plain numbers: ten times as fast."""
    a, b, c = C.tolist()
    return (
        abs(_dot(a, a) - 1.0) <= _ORTHOGONALITY
        and abs(_dot(b, b) - 1.0) <= _ORTHOGONALITY
        and abs(_dot(c, c) - 1.0) <= _ORTHOGONALITY
        and abs(_dot(a, b)) <= _ORTHOGONALITY
        and abs(_dot(b, c)) <= _ORTHOGONALITY
        and abs(_dot(c, a)) <= _ORTHOGONALITY
    )


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def are_attitudes(C: Array) -> Bools:
    """Mask (n,) of the matrices of a (n, 3, 3) array that are orthogonal."""
    with np.errstate(all='ignore'):
        off = np.abs(np.einsum('nij,nkj->nik', C, C) - np.eye(3))
        return np.asarray((off <= _ORTHOGONALITY).all(axis=(1, 2)))


def initial_problem(s: InitialState) -> str:
    """Sentence about an initial state that cannot be used; empty if it can."""
    speeds = {f'v_G[{k}]': v for k, v in enumerate(s.v_G)}
    values = {**{name: getattr(s, name) for name in _INITIAL}, **speeds}
    for name, value in values.items():
        low, high = _INITIAL.get(name, (-_INITIAL_SPEED, _INITIAL_SPEED))
        if not math.isfinite(value):
            return f'{name} of the initial state is not finite'
        if name.startswith('sigma') and value <= 0.0:
            return f'{name} is {value}: it must be positive'
        slack = _SLACK if low <= 0.0 else 1.0 / _SLACK
        if not low * slack <= value <= high * _SLACK:
            return f'{name} is {value:g}: it must lie in [{low:g}, {high:g}]'
    x, _, z = ecef_from_geodetic(s.latitude, s.longitude, s.height).tolist()
    return NO_GRID_NORTH if math.hypot(x, z) < AXIS else ''
