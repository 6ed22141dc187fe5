"""Most probable noise: Fisher scoring on logarithms, with the information that the data hold.

Derivation: docs/derivations/tuning.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError

from .likelihood import Problem, Rows

MOST_STEPS = 20
_STEP = 0.01
"""Differences of the logarithm of a factor."""
_LARGEST = math.log(5.0)
"""Of one step, of the logarithm of a factor."""
_LEAST = 0.04
"""Of a variance, in one step, as a share."""
_HALVES = 4
_ENOUGH, _AT_LAST = 0.1, 1.0
"""Another step is made until its square, in sigmas, is below this; the last one's below that."""
_JUMP = 5.0
"""Difference of slopes to both sides, in what curvature makes of it, from which on one jumps."""
_NOTHING = 1e-4
"""Share of the prior's information below which a parameter has none where it is now."""


@dataclass(frozen=True)
class Fit:
    """Most probable noise of a recording.

    Attributes
    ----------
    at : (k,) array
        Logarithms of factors on what is stated.
    prior_mean, prior : (k,) arrays
        What was known before: mean and 1-sigma.
    information : (k, k) array
        Fisher information of the data, without the prior.
    ln_likelihood : float
        Of the data there.
    rows : Rows
        Of the run there.
    settled : bool
    """

    at: Array
    prior_mean: Array
    prior: Array
    information: Array
    ln_likelihood: float
    rows: Rows
    settled: bool

    @property
    def covariance(self) -> Array:
        """Of the logarithms, with the prior, shape (k, k)."""
        return np.asarray(np.linalg.inv(self.information + np.diag(self.prior**-2)))

    @property
    def sigma(self) -> Array:
        """Cramér-Rao 1-sigma of each by the data alone, the others as known as they are, (k,)."""
        return data_sigma(self.covariance, self.prior)


def data_sigma(covariance: Array, prior: Array) -> Array:
    """1-sigma (k,) that the data leave of each, its own prior taken out of a covariance."""
    left = np.maximum(1.0 / np.diag(covariance) - prior**-2, 0.0)
    with np.errstate(divide='ignore'):
        return np.asarray(1.0 / np.sqrt(left))


def fit(problem: Problem, start: Array, prior_mean: Array, prior: Array) -> Fit:
    """Most probable noise, from a start.

    Parameters
    ----------
    problem : Problem
    start, prior_mean, prior : (k,) arrays
        Logarithms of factors; where to begin, mean and 1-sigma of what was known before.

    Raises
    ------
    ConfigError
        Where the filter is lost at the start.
    """
    at, rows = start.copy(), problem.rows(start)
    if rows is None:
        raise ConfigError('the filter diverges with the noise that is stated: nothing to tune')
    settled, last = False, False
    idle = np.zeros(len(at), dtype=bool)
    information = np.zeros((len(at), len(at)))
    for _ in range(MOST_STEPS):
        if last:
            idle[:] = False
        gradient, information = _slopes(problem, at, rows, idle, both_sides=last)
        J = information + np.diag(prior**-2)
        slope = gradient - (at - prior_mean) / prior**2
        step = np.asarray(np.linalg.solve(J, slope), dtype=np.float64)
        idle = np.diag(information) < _NOTHING / prior**2
        small = float(slope @ step) < (_AT_LAST if last else _ENOUGH)
        moved = _moved(problem, at, rows, step, slope, prior_mean, prior)
        if moved is not None:
            at, rows = moved
        if last and (small or moved is None):
            # No run is better either way: where the likelihood is rough that is the end, too.
            settled = True
            break
        last = last or small or moved is None
    value = float(rows.ln_density().sum())
    return Fit(at, prior_mean, prior, information, value, rows, settled)


def _moved(
    problem: Problem, at: Array, rows: Rows, step: Array, slope: Array, mean: Array, prior: Array
) -> tuple[Array, Rows] | None:
    """Place with a greater posterior density in the direction of a step; None without.

    Where a whole step gains less than half of what it should, half of it is tried, too.
    """
    expected = 0.25 * float(slope @ step)
    # Of one variance alone ln(1 + 2 step) / 2 is the whole way, however far.
    step = 0.5 * np.log(np.maximum(1.0 + 2.0 * step, _LEAST))
    step = np.clip(step, -_LARGEST, _LARGEST)
    here = _posterior(at, rows, mean, prior)
    best, greatest = None, here
    for half in range(_HALVES):
        there = at + step * 0.5**half
        found = problem.rows(there)
        value = -math.inf if found is None else _posterior(there, found, mean, prior)
        if found is not None and value > greatest:
            best, greatest = (there, found), value
            if value > here + expected:
                break
        elif best is not None:
            break
    return best


def _posterior(at: Array, rows: Rows, mean: Array, prior: Array) -> float:
    return float(rows.ln_density().sum() - 0.5 * np.sum(((at - mean) / prior) ** 2))


def _slopes(
    problem: Problem, at: Array, rows: Rows, idle: Array, *, both_sides: bool
) -> tuple[Array, Array]:
    """Gradient (k,) of the logarithm of the likelihood, and its Fisher information (k, k).

    With whitened rows u = T z and sigmas s of them, d ln p = -sum(d ln s + u du), and the
    information is the sum of du du' + d ln s d ln s' over the rows. Parameters that are idle have
    no slope.
    """
    U, D = [], []
    for k in range(len(at)):
        u, d = np.zeros(rows.white.size), np.zeros(rows.white.size)
        if not idle[k]:
            by = np.zeros(len(at))
            by[k] = _STEP
            sides = [_side(problem, at, rows, by)]
            if both_sides or sides[0] is None:
                sides.append(_side(problem, at, rows, -by))
            u, d = _together([s for s in sides if s is not None], rows, (u, d))
        U.append(u)
        D.append(d)
    u, d = np.array(U), np.array(D)
    return -(d.sum(axis=1) + u @ rows.white.ravel()), u @ u.T + d @ d.T


def _side(problem: Problem, at: Array, rows: Rows, by: Array) -> tuple[Array, Array] | None:
    """Slopes of whitened rows and of logarithms of their sigmas by a difference to one side."""
    there = problem.rows(at + by)
    if there is None or not there.same_measurements(rows):
        return None
    length = by.sum()
    white = (there.white - rows.white).ravel() / length
    return white, (there.log_sigma - rows.log_sigma).ravel() / length


def _together(
    sides: list[tuple[Array, Array]], rows: Rows, nothing: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Mean of slopes to both sides, or the smaller one where the likelihood jumps on one side.

    The filter has terms that begin at a threshold (`kernels.sins.bend`).
    """
    if len(sides) < 2:
        return sides[0] if sides else nothing
    slopes = [float(d.sum() + u @ rows.white.ravel()) for u, d in sides]
    information = min(float(u @ u + d @ d) for u, d in sides)
    if abs(slopes[0] - slopes[1]) > _JUMP * (1.0 + information * _STEP):
        return sides[int(np.argmin(np.abs(slopes)))]
    (u, d), (v, e) = sides
    return 0.5 * (u + v), 0.5 * (d + e)
