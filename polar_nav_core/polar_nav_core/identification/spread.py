"""Covariance of the minimum of a robust cost, and sigmas derived from it.

docs/derivations/identification.md, eqs (11)-(14).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array

_CORRELATED = 10
"""Fixes over which residuals may be correlated."""
_LEAST_EIGENVALUE = 1e-14
"""Least eigenvalue of the scaled normal matrix that differs from zero despite rounding."""


def whitening_of(covariance: Array) -> Array:
    """Matrices W with W R W' = 1, rows along the axes of each error ellipse, shape (n, 2, 2)."""
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes.transpose(0, 2, 1) / np.sqrt(variances)[:, :, None])


def drag_sigmas(drag: Array, covariance: Array, speed: float) -> tuple[float, float]:
    """1-sigma of ln(d1 U + d2 U^2) and of the share f = d2 U / (d1 + d2 U) at the speed U."""
    per_speed = drag[0] + drag[1] * speed
    if per_speed <= 0.0:
        return math.inf, math.inf
    by_log = np.array([1.0, speed]) / per_speed
    by_share = np.array([-drag[1] * speed, drag[0] * speed]) / per_speed**2
    log_variance, share_variance = by_log @ covariance @ by_log, by_share @ covariance @ by_share
    return math.sqrt(max(log_variance, 0.0)), math.sqrt(max(share_variance, 0.0))


def scaled_condition(normal: Array) -> float:
    """Condition number of J'J with columns of J scaled to length one."""
    lengths = np.sqrt(np.diag(normal))
    if not (lengths > 0.0).all():
        return math.inf
    return float(np.linalg.cond(normal / np.outer(lengths, lengths)))


@dataclass(frozen=True)
class Spread:
    """Covariance (p, p) of theta, and the gain (p, rows) from residuals to theta at a minimum."""

    covariance: Array
    gain: Array
    misfit: float
    correlation: float
    log_determinant: float


def spread_of(jacobian: Array, white: Array, scale: float, priors: int) -> Spread:
    """How uncertain the minimum of a soft L1 cost is.

    With s = r / scale, the score of a residual is r / sqrt(1 + s^2) and its slope
    (1 + s^2)^(-3/2); A = J' slope J, and the covariance is A^-1 J' J A^-1 times the mean squared
    score, raised by the correlation that the residuals show. The last rows are priors.

    Parameters
    ----------
    jacobian, white : (2 n + priors, p), (2 n + priors,) arrays
        Two rows for each fix.
    scale : float
    priors : int
    """
    below = 1.0 + (white / scale) ** 2
    score, slope = white / np.sqrt(below), below**-1.5
    slope[-priors:] = 1.0
    freedom = max(len(white) - jacobian.shape[1], 1)
    expected = _expected_square(scale)
    mean_square = float(score[:-priors] @ score[:-priors]) / freedom
    correlation = correlation_of(score[:-priors].reshape(-1, 2))
    # Luck with the residuals is no knowledge: never less than the stated errors of the fixes.
    weights = np.full(len(white), max(mean_square * correlation, expected))
    weights[-priors:] = 1.0
    lengths = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / lengths
    inverse, log_determinant = _inverse((scaled.T * slope) @ scaled)
    gain = -(inverse @ (scaled.T * slope)) / lengths[:, None]
    root = (inverse @ (scaled.T * np.sqrt(weights))) / lengths[:, None]
    return Spread(
        root @ root.T,
        gain,
        math.sqrt(mean_square / expected),
        correlation,
        log_determinant + 2.0 * float(np.sum(np.log(lengths))),
    )


def correlation_of(series: Array) -> float:
    """How much more a sum over a series varies than if it were white, at least 1.

    1 + 2 sum of the correlations at lags 1.. with Bartlett's weights, columns pooled; slow
    residuals (a current that changes) say that there are fewer independent fixes than it seems.
    """
    power = float(np.sum(series**2))
    lags = min(_CORRELATED, len(series) - 1)
    if power <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, lags + 1):
        weight = 1.0 - lag / (lags + 1.0)
        total += 2.0 * weight * float(np.sum(series[lag:] * series[:-lag])) / power
    return max(total, 1.0)


def _inverse(normal: Array) -> tuple[Array, float]:
    """Inverse of a symmetric matrix, and the logarithm of its determinant.

    Directions that the matrix does not determine are large, not zero.
    """
    values, vectors = np.linalg.eigh(normal)
    values = np.maximum(values, _LEAST_EIGENVALUE)
    return np.asarray((vectors / values) @ vectors.T), float(np.sum(np.log(values)))


def _expected_square(scale: float) -> float:
    """Mean squared score of a unit normal residual."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    square = nodes**2 / (1.0 + (nodes / scale) ** 2)
    return float(weights @ square / weights.sum())
