"""Least squares over constants: what white innovations show of them, with what was known before.

Derivation: docs/derivations/calibration.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from polar_nav_core.arrays import Array

EXCITED = 0.3
"""A constant is estimated where the data leave less than this share of its prior sigma."""
RESOLVED = 1e-3
"""Least eigenvalue of information, all constants scaled to one, that is more than rounding."""
TIED = 0.98
"""Correlation from which on two constants are one sum."""
LOOSE, LOOSE_SHARE = 0.95, 0.05
"""The same where the data leave this share of its prior sigma of one of them."""
KNOWN_SHARE = 0.005
"""A constant of which no more is left is known, whatever it correlates with."""


@dataclass(frozen=True)
class Normal:
    """A normal distribution.

    Attributes
    ----------
    mean, covariance : (n,), (n, n) arrays
    """

    mean: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """1-sigma of each, shape (n,)."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.covariance), 0.0, None)))


def least_squares(M: Array, white: Array, at: Array, prior: Array) -> Normal:
    """Change of constants by which innovations are smallest, with its covariance.

    Parameters
    ----------
    M : (n, k) array
        Change of the whitened innovations per unit by which a constant is not as stated.
    white : (n,) array
        Whitened innovations, white + M b with b what the constants are off by.
    at : (k,) array
        Where the constants have been moved to already; their priors are about zero.
    prior : (k,) array
        1-sigma.
    """
    scaled = M * prior
    J, h = _resolved(scaled.T @ scaled, scaled.T @ white)
    P = np.linalg.inv(J + np.eye(len(prior)))
    return Normal(prior * (P @ (h - at / prior)), P * np.outer(prior, prior))


def _resolved(J: Array, h: Array) -> tuple[Array, Array]:
    """Information and its vector without combinations that only errors of the rows resolve.

    Rows are first order and partly differences: of constants whose rows are alike to some per
    cent, what is left between them is no information.
    """
    size = np.sqrt(np.diag(J))
    size = np.where(size > 0.0, size, 1.0)
    values, V = np.linalg.eigh(J / np.outer(size, size))
    V = V[:, values > RESOLVED]
    values = values[values > RESOLVED]
    half = size[:, None] * V
    return (half * values) @ half.T, half @ (V.T @ (h / size))


def with_states(found: Normal, mean: Array, P: Array, S: Array) -> Normal:
    """Distribution of constants and, behind them, of states of the filter.

    Parameters
    ----------
    found : Normal
        Of the k constants.
    mean, P : (m,), (m, m) arrays
        Estimate of the states and their covariance, the constants given.
    S : (m, k) array
        Change of state minus estimate per unit of each constant.
    """
    cross = S @ found.covariance
    return Normal(
        np.concatenate([found.mean, mean + S @ found.mean]),
        np.block([[found.covariance, cross.T], [cross, P + cross @ S.T]]),
    )


def excited(u: Normal, prior: Array) -> Array:
    """Mean (n,) without the combinations of constants that the data do not show."""
    values, V = np.linalg.eigh(u.covariance / np.outer(prior, prior))
    V = V[:, values < EXCITED**2]
    return np.asarray(prior * (V @ (V.T @ (u.mean / prior))))


@dataclass(frozen=True)
class Sum:
    """Two constants of which the data show ``first + weight * second`` only.

    Attributes
    ----------
    first, second : int
    weight : float
    value, sigma : float
        Of the sum, SI of the first.
    """

    first: int
    second: int
    weight: float
    value: float
    sigma: float


def sums(u: Normal, prior: Array) -> list[Sum]:
    """Pairs of constants of which the data show a sum, and little of each.

    The sum is the one that is least uncertain, in units of the priors.
    """
    scaled = u.covariance / np.outer(prior, prior)
    sigma = np.sqrt(np.diag(scaled))
    out = []
    for i, j in combinations(range(len(sigma)), 2):
        if min(sigma[i], sigma[j]) < KNOWN_SHARE:
            continue
        limit = LOOSE if max(sigma[i], sigma[j]) >= LOOSE_SHARE else TIED
        if abs(scaled[i, j]) < limit * sigma[i] * sigma[j]:
            continue
        least = np.linalg.eigh(scaled[np.ix_([i, j], [i, j])])[1][:, 0]
        weight = float(least[1] / least[0] * prior[i] / prior[j])
        row = np.zeros(len(prior))
        row[i], row[j] = 1.0, weight
        deviation = float(np.sqrt(row @ u.covariance @ row))
        if deviation < EXCITED * prior[i]:
            out.append(Sum(i, j, weight, float(row @ u.mean), deviation))
    return out
