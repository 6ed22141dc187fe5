"""Identification by robust least squares: drag, current, start and heading bias with covariance.

The residuals are whitened by each fix's covariance, and large ones count linearly (soft L1). The
current may change within the window; of several densities of its walk the likeliest is used.
Equations: docs/derivations/identification.md, (8)-(15).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..vehicle_model import VehicleModel
from .spread import Spread, drag_sigmas, scaled_condition, spread_of, whitening_of
from .track import (
    BIAS,
    CURRENT,
    DRAG,
    LOG_DRAG,
    SHARE,
    SIZE,
    TrackModel,
    drag_of,
    drag_slopes,
)
from .window import Window

NAMES = (
    'drag_linear',
    'drag_quadratic',
    'current_x',
    'current_y',
    'start_x',
    'start_y',
    'heading_bias',
)
"""Names of the reported parameters; the fit itself has ln Dt and f in place of d1 and d2."""
SHARE_NAME = 'share of quadratic drag'
_AT_BOUND = ('total drag', SHARE_NAME, 'current x', 'current y', '', '', 'heading')
_LARGEST_BIAS = 0.6
"""Bound of the heading bias [rad], far beyond any compass."""
_MOST_EVALUATIONS = 100
_CHANGES = 3
"""Stretches of a window in each of which a current that changes goes linearly.

With more, BLAS would share its work on 300 fixes out among threads, which a busy machine punishes.
"""
_GATE = 25.0
"""Least squared whitened residual of an outlier; 4 of a million good fixes exceed it."""
_PASSES = 3
"""Number of fits, each without the outliers of the one before."""


@dataclass(frozen=True)
class Limits:
    """Bounds of the fit, and prior sigmas.

    Attributes
    ----------
    drag_ratio : float
        Total drag lies within the nominal one times and over this.
    current : float
        Largest, per axis [m/s].
    heading_bias_sigma : float
        [rad].
    current_walks : sequence of float
        Densities of the current's random walk to choose from [m^2/s^3]; 0 is a constant current.
    loss_scale : float
        Whitened residual at which soft L1 bends.
    """

    drag_ratio: float
    current: float
    heading_bias_sigma: float
    current_walks: Sequence[float]
    loss_scale: float


@dataclass(frozen=True)
class Fit:
    """Result of a robust fit.

    Attributes
    ----------
    fixes : int
        Used, outliers not counted.
    values, covariance : (7,), (7, 7) arrays
        In the order of `NAMES`; the current is that at the last fix.
    log_drag_sigma, share_sigma : float
        1-sigma of ln(total drag) and of its quadratic share at `speed`.
    speed, speed_span : float
        Root mean square and 5-95 % range of the surge speed through the water [m/s].
    current_walk : float
        The density that was chosen [m^2/s^3].
    condition_number : float
        Of the normal matrix whose columns have length one.
    misfit : float
        Size of the whitened residuals, large ones counted linearly; 1 if as stated.
    correlation : float
        Factor by which correlated residuals raised the covariance, at least 1.
    cost : float
        Sum of the losses.
    at_bound : tuple of str
        What ended at its bound.
    """

    fixes: int
    values: Array
    covariance: Array
    log_drag_sigma: float
    share_sigma: float
    speed: float
    speed_span: float
    current_walk: float
    condition_number: float
    misfit: float
    correlation: float
    cost: float
    iterations: int
    converged: bool
    at_bound: tuple[str, ...]


def fit(window: Window, model: VehicleModel, speed: float, limits: Limits) -> Fit:
    """Robust fit of drag, current, start and heading bias to a window of fixes.

    Parameters
    ----------
    window : Window
    model : VehicleModel
        Inertia, sway drag and the nominal surge drag, where the search starts.
    speed : float
        Speed at which total drag and its quadratic share are stated [m/s].
    limits : Limits
    """
    used = np.ones(window.fixes, dtype=bool)
    evaluations = 0
    walks = sorted(set(limits.current_walks), reverse=True)
    # The current that may change most decides what is an outlier: then all have the same fixes.
    for _ in range(_PASSES):
        best = _solve(window, model, speed, limits, walks[0], used)
        evaluations += best.evaluations
        outliers = used & _far_off(best.residuals[: 2 * window.fixes].reshape(-1, 2), used)
        if not outliers.any():
            break
        used = used & ~outliers
    for walk in walks[1:]:
        other = _solve(window, model, speed, limits, walk, used)
        evaluations += other.evaluations
        if other.surprise <= best.surprise:
            best = other
    return _fit_of(best, window, speed, evaluations, used)


@dataclass(frozen=True)
class _Solution:
    """A minimum for one density of the current's walk; rows of fixes that are not used are 0."""

    track: TrackModel
    whitening: Array
    walk: float
    theta: Array
    jacobian: Array
    residuals: Array
    spread: Spread
    surprise: float
    cost: float
    evaluations: int
    converged: bool
    active: NDArray[np.int_]


def _solve(
    window: Window,
    model: VehicleModel,
    speed: float,
    limits: Limits,
    walk: float,
    used: NDArray[np.bool_],
) -> _Solution:
    # Imported here, as it would slow every start of a node that never identifies.
    from scipy.optimize import least_squares

    knots_s = np.linspace(0.0, window.duration, _CHANGES + 1) if walk > 0.0 else np.empty(0)
    track = TrackModel(window, model, speed, knots_s)
    whitening = whitening_of(window.covariance)
    whitening[~used] = 0.0  # a row without weight or information
    priors = 1 + track.size - SIZE
    prior = np.zeros((priors, track.size))
    prior[0, BIAS] = 1.0 / limits.heading_bias_sigma
    if walk > 0.0:
        prior[1:, SIZE:] = np.eye(priors - 1) / math.sqrt(walk * knots_s[1])

    def residuals(theta: Array) -> Array:
        places, _ = track.positions(theta)
        white = np.einsum('nij,nj->ni', whitening, places - window.position)
        return np.concatenate([white.ravel(), prior @ theta])

    def slopes(theta: Array) -> Array:
        _, by_theta = track.positions(theta)
        return np.vstack([(whitening @ by_theta).reshape(-1, track.size), prior])

    begin = np.zeros(track.size)
    begin[DRAG] = model.logarithmic_drag(speed)
    low, high = _bounds(begin, limits)
    linear = slopes(begin)[:, DRAG.stop :]
    begin[DRAG.stop :] = np.linalg.lstsq(linear, -residuals(begin), rcond=None)[0]
    found = least_squares(
        residuals,
        np.clip(begin, low + 1e-6, high - 1e-6),
        jac=slopes,
        bounds=(low, high),
        method='trf',
        loss='soft_l1',
        f_scale=limits.loss_scale,
        x_scale='jac',
        max_nfev=_MOST_EVALUATIONS,
    )
    jacobian, white = slopes(found.x), residuals(found.x)
    rows = np.append(np.repeat(used, 2), np.ones(priors, dtype=bool))
    spread = spread_of(jacobian[rows], white[rows], limits.loss_scale, priors)
    log_det_prior = np.linalg.slogdet(prior[1:, SIZE:])[1] if walk > 0.0 else 0.0
    return _Solution(
        track=track,
        whitening=whitening,
        walk=walk,
        theta=found.x,
        jacobian=jacobian[rows],
        residuals=white,
        spread=spread,
        # -2 ln of the probability of these fixes, to second order around the minimum.
        surprise=2.0 * float(found.cost) + spread.log_determinant - 2.0 * float(log_det_prior),
        cost=2.0 * float(found.cost),
        evaluations=int(found.nfev),
        converged=bool(found.status > 0),
        active=found.active_mask[:SIZE],
    )


def _fit_of(
    s: _Solution, window: Window, speed: float, evaluations: int, used: NDArray[np.bool_]
) -> Fit:
    """Fit of a solution, its parameters those of `NAMES`."""
    about_station = window.position - window.station
    by_heading = np.einsum(
        'nij,nj->ni', s.whitening, np.stack([about_station[:, 1], -about_station[:, 0]], axis=1)
    )
    # The station's heading error is one and the same in all fixes: it does not average out.
    gain = s.spread.gain[:SIZE, : 2 * int(used.sum())]
    shift = gain @ (by_heading[used].ravel() * window.heading_sigma)
    covariance = s.spread.covariance[:SIZE, :SIZE] + np.outer(shift, shift)
    reported = np.eye(SIZE)
    reported[DRAG, DRAG] = drag_slopes(s.theta[LOG_DRAG], s.theta[SHARE], speed)
    drag = drag_of(s.theta[LOG_DRAG], s.theta[SHARE], speed)
    covariance = reported @ covariance @ reported.T
    surge = s.track.surge(s.theta)
    at_speed = max(float(np.sqrt(np.mean(surge**2))), 1e-3)
    log_drag_sigma, share_sigma = drag_sigmas(drag, covariance[DRAG, DRAG], at_speed)
    return Fit(
        fixes=int(used.sum()),
        values=np.concatenate([drag, s.theta[DRAG.stop : SIZE]]),
        covariance=0.5 * (covariance + covariance.T),
        log_drag_sigma=log_drag_sigma,
        share_sigma=share_sigma,
        speed=at_speed,
        speed_span=float(np.diff(np.percentile(surge, [5.0, 95.0]))[0]),
        current_walk=s.walk,
        condition_number=scaled_condition(s.jacobian.T @ s.jacobian),
        misfit=s.spread.misfit,
        correlation=s.spread.correlation,
        cost=s.cost,
        iterations=evaluations,
        converged=s.converged,
        at_bound=tuple(n for n, hit in zip(_AT_BOUND, s.active, strict=True) if hit),
    )


def _far_off(white: Array, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of outliers among whitened residuals (n, 2): beyond the gate, in the used ones' scale.

    The median of a squared residual of two dimensions is 2 ln 2.
    """
    squares = np.sum(white**2, axis=1)
    scale = max(float(np.median(squares[used])) / (2.0 * math.log(2.0)), 1.0)
    return np.asarray(squares > _GATE * scale)


def _bounds(nominal: Array, limits: Limits) -> tuple[Array, Array]:
    reach = math.log(limits.drag_ratio)
    low, high = np.full(len(nominal), -np.inf), np.full(len(nominal), np.inf)
    low[LOG_DRAG], high[LOG_DRAG] = nominal[LOG_DRAG] - reach, nominal[LOG_DRAG] + reach
    low[SHARE], high[SHARE] = 0.0, 1.0
    low[CURRENT], high[CURRENT] = -limits.current, limits.current
    low[BIAS], high[BIAS] = -_LARGEST_BIAS, _LARGEST_BIAS
    return low, high
