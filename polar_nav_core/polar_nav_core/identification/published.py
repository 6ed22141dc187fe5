"""Levenberg-Marquardt identification as published, Eqs. (14)-(19).

Readings: docs/derivations/identification.md.

Surge in its steady state, no sway, heading for course; the track is a left Euler sum over the
times of the fixes and starts at a given place, by default at the first fix. Where the paper is not
definite, there is an argument: the next mu of eq. (19), and whether a negative d1 may be passed
through. docs/identification.md lists the readings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from .window import Window

NAMES = ('drag_linear', 'drag_quadratic', 'current_x', 'current_y')
_LEAST_MU, _MOST_MU = 1e-12, 1e12
_FLAT = 1e-6
"""Share of the cost that a further step may gain at a minimum."""


@dataclass(frozen=True)
class Samples:
    """The FIFO of eq. (17): force, heading and position at each fix.

    Attributes
    ----------
    seconds, force, psi : (n,) arrays
        Time of validity [s], surge force [N], heading [rad].
    position : (n, 2) array
        Fixes [m].
    start : (2,) array
        Start of the model's track [m].
    """

    seconds: Array
    force: Array
    psi: Array
    position: Array
    start: Array

    @classmethod
    def of(cls, window: Window, start: Array | None = None) -> Samples:
        """Samples of a window at its fixes; the track starts at the first by default."""
        at = window.node
        return cls(
            window.seconds[at],
            window.force[at],
            window.psi[at],
            window.position,
            window.position[0] if start is None else np.asarray(start, dtype=np.float64),
        )


@dataclass(frozen=True)
class Minimum:
    """Result of Levenberg-Marquardt.

    Attributes
    ----------
    values : (4,) array
        d1x, d2x, V_cx, V_cy.
    normal : (4, 4) array
        J^T J there.
    cost : float
        Sum of squared residuals [m^2].
    """

    values: Array
    normal: Array
    cost: float
    gradient_norm: float
    iterations: int
    converged: bool

    def covariance(self, fixes: int) -> Array:
        """(J^T J)^-1 times the mean square of the residuals, shape (4, 4); NaN if singular."""
        try:
            inverse = np.linalg.inv(self.normal)
        except np.linalg.LinAlgError:
            return np.full((4, 4), np.nan)
        return np.asarray(inverse * (self.cost / max(2 * fixes - 4, 1)))


def steady_speed_and_slopes(
    force: Array, drag_linear: float, drag_quadratic: float
) -> tuple[Array, Array, Array]:
    """Surge speed in equilibrium and its slopes with d1 and d2, each of force's shape.

    v = 2 tau / (d1 + root), dv/dd1 = -v / root, dv/dd2 = -v |v| / root with
    root = sqrt(d1^2 + 4 d2 |tau|): eqs (14) and (18).
    """
    root = np.sqrt(drag_linear * drag_linear + 4.0 * drag_quadratic * np.abs(force))
    with np.errstate(divide='ignore', invalid='ignore'):
        speed = 2.0 * force / (drag_linear + root)
        return speed, -speed / root, -speed * np.abs(speed) / root


def track_and_slopes(samples: Samples, values: Array) -> tuple[Array, Array]:
    """Positions of the model at the fixes (n, 2) and their slopes (n, 2, 4): eqs (16), (18)."""
    speed, by_linear, by_quadratic = steady_speed_and_slopes(samples.force, values[0], values[1])
    heading = np.stack([np.cos(samples.psi), np.sin(samples.psi)], axis=1)
    rate = speed[:, None] * heading + values[2:]
    slope = np.zeros((len(speed), 2, 4))
    slope[:, :, 0] = by_linear[:, None] * heading
    slope[:, :, 1] = by_quadratic[:, None] * heading
    slope[:, 0, 2] = slope[:, 1, 3] = 1.0
    steps = np.diff(samples.seconds)
    track = np.empty((len(speed), 2))
    slopes = np.zeros_like(slope)
    track[0] = samples.start
    track[1:] = samples.start + np.cumsum(steps[:, None] * rate[:-1], axis=0)
    slopes[1:] = np.cumsum(steps[:, None, None] * slope[:-1], axis=0)
    return track, slopes


def levenberg_marquardt(
    samples: Samples,
    initial: Array,
    *,
    adaptive: bool = True,
    mu: float = 1.0,
    epsilon: float = 1e-6,
    most_iterations: int = 200,
    keep_linear_positive: bool = False,
) -> Minimum:
    """Minimum of the sum of squared distances, P <- P - (J^T J + mu I)^-1 J^T E, eqs (17)-(19).

    Parameters
    ----------
    samples : Samples
    initial : (4,) array
        Initial values of d1x, d2x, V_cx, V_cy.
    adaptive : bool
        Whether mu falls by ten after a step that lowers the cost, and rises by ten, the step being
        refused, after one that does not; else it is constant and every step is made, halved only
        where it would lead to d2 <= 0.
    mu : float
        Its first value.
    epsilon : float
        Ends when a step is shorter.
    most_iterations : int
    keep_linear_positive : bool
        Refuse steps to d1 <= 0, as some would; it stalls far from the minimum.
    """
    values = np.array(initial, dtype=np.float64)
    error, slopes = _residuals(samples, values)
    cost = float(error @ error)
    ended = False
    iterations = 0
    while iterations < most_iterations and not ended:
        iterations += 1
        gradient = slopes.T @ error
        normal = slopes.T @ slopes
        try:
            step = np.linalg.solve(normal + mu * np.eye(4), gradient)
        except np.linalg.LinAlgError:
            break
        while not adaptive and values[1] <= step[1]:
            step *= 0.5  # there is no speed beyond d2 = 0, and nothing printed that leads back
        trial = values - step
        short = bool(np.linalg.norm(step) < epsilon)
        allowed = bool(trial[1] > 0.0 and (trial[0] > 0.0 or not keep_linear_positive))
        if allowed or not adaptive:
            trial_error, trial_slopes = _residuals(samples, trial)
            trial_cost = float(trial_error @ trial_error)
            if not adaptive or trial_cost <= cost:
                values, error, slopes, cost = trial, trial_error, trial_slopes, trial_cost
                mu = max(mu / 10.0, _LEAST_MU) if adaptive else mu
                ended = short
                continue
        ended = short or mu >= _MOST_MU
        mu *= 10.0
    normal, gradient = slopes.T @ slopes, slopes.T @ error
    # A large mu makes any step short: the criterion is the possible decrease of the cost.
    converged = ended and _decrement(normal, gradient) <= _FLAT * (1.0 + cost)
    return Minimum(
        values, normal, cost, float(np.linalg.norm(gradient)), iterations, bool(converged)
    )


def _decrement(normal: Array, gradient: Array) -> float:
    """Decrease of the cost by a full Gauss-Newton step, if it were quadratic [m^2]."""
    try:
        return float(gradient @ np.linalg.solve(normal, gradient))
    except np.linalg.LinAlgError:
        return math.inf


def _residuals(samples: Samples, values: Array) -> tuple[Array, Array]:
    track, slopes = track_and_slopes(samples, values)
    return (track - samples.position).ravel(), slopes.reshape(-1, 4)
