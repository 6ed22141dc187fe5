"""Verdict on an identification: whether it may be used, or a manoeuvre that would improve it.

Two separations are necessary: of current and drag, which needs different headings, and
of the linear and the quadratic share of the drag, which needs different speeds.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from .params import IdentificationParams
from .published import Minimum
from .result import IdentificationVerdict as Verdict
from .robust import SHARE_NAME, Fit
from .window import Window

ENOUGH_TURN = math.radians(90.0)
"""Least spread of headings that separates a current from a drag."""
_LEAST_CHANGE = 0.2
"""Least change of speed [m/s] that a sentence recommends."""
_WANDERING = 1.5
"""Least correlation of the residuals that a sentence reports: white ones rarely exceed 1.4."""


def turned_through(psi: Array) -> float:
    """Range of the heading, at most a full turn [rad]; its rarest two percent do not count.

    Parameters
    ----------
    psi : (n,) array
        Heading without jumps [rad].
    """
    low, high = np.percentile(psi, [1.0, 99.0])
    return min(float(high - low), 2.0 * math.pi)


def judge_fit(window: Window, fit: Fit, params: IdentificationParams) -> tuple[Verdict, str]:
    """Verdict on a robust fit, and the reason as a sentence."""
    if not (np.isfinite(fit.values).all() and np.isfinite(fit.covariance).all()):
        return Verdict.NOT_CONVERGED, f'no finite minimum in {fit.iterations} evaluations'
    if fit.misfit > params.identify_misfit:
        return Verdict.UNPHYSICAL, (
            f'the residuals are {fit.misfit:.1f} times the stated errors of the fixes (limit '
            f'{params.identify_misfit:.1f}): no constant current and drag explain {fit.fixes} '
            f'fixes in {window.duration:.0f} s'
        )
    wander = ''
    if fit.current_walk > 0.0:
        wander = (
            f'; a current that walks by {fit.current_walk:.0e} m^2/s^3 explains the fixes best'
        )
    if fit.correlation > _WANDERING:
        wander += (
            '; the residuals wander, which raised these sigmas '
            f'{math.sqrt(fit.correlation):.1f} times'
        )
    weak = _not_excited(window, fit, params)
    if weak:
        return Verdict.NOT_EXCITED, weak + wander
    if not fit.converged:
        return Verdict.NOT_CONVERGED, f'no minimum was found in {fit.iterations} evaluations'
    if fit.at_bound:
        helps = ''
        if SHARE_NAME in fit.at_bound:
            helps = f': {_vary_thrust(fit, params)}'
        return Verdict.UNPHYSICAL, (
            f'{" and ".join(fit.at_bound)} ended at the limit of the search{helps}'
        )
    return Verdict.ACCEPTED, (
        f'{fit.fixes} fixes in {window.duration:.0f} s: drag at {fit.speed:.2f} m/s known to '
        f'{100.0 * fit.log_drag_sigma:.1f} %, its quadratic share to {fit.share_sigma:.3f}, '
        f'current to {_current_sigma(fit):.4f} m/s{wander}'
    )


def judge_minimum(minimum: Minimum, params: IdentificationParams) -> tuple[Verdict, str]:
    """Verdict on the published method: only whether it converged to possible values."""
    values = minimum.values
    if not (minimum.converged and np.isfinite(values).all()):
        return Verdict.NOT_CONVERGED, (
            f'Levenberg-Marquardt ended after {minimum.iterations} iterations away from a minimum '
            f'(gradient {minimum.gradient_norm:.2g})'
        )
    current = float(np.hypot(values[2], values[3]))
    if current > params.identify_current_limit:
        return Verdict.UNPHYSICAL, (
            f'current of {current:.2f} m/s (limit {params.identify_current_limit:.2f} m/s)'
        )
    speed = params.model_speed
    nominal = params.vehicle_model().total_drag(speed)
    drag = (values[0] + values[1] * speed) * speed
    ratio = params.identify_drag_ratio
    if values[1] <= 0.0 or not nominal / ratio <= drag <= nominal * ratio:
        return Verdict.UNPHYSICAL, (
            f'drag of {drag:.1f} N at {speed:.2f} m/s, nominal {nominal:.1f} N (limit: a factor '
            f'of {ratio:.1f}), with d1 {values[0]:.1f} N s/m and d2 {values[1]:.1f} N s^2/m^2'
        )
    return Verdict.ACCEPTED, (
        f'converged in {minimum.iterations} iterations to a sum of squares of '
        f'{minimum.cost:.4g} m^2'
    )


def _current_sigma(fit: Fit) -> float:
    return math.sqrt(float(np.linalg.eigvalsh(fit.covariance[2:4, 2:4])[-1]))


def _not_excited(window: Window, fit: Fit, params: IdentificationParams) -> str:
    """Sentence about parameters that are not excited, with a manoeuvre; empty if all are."""
    weak, wishes = [], []
    limits = params.identify_current_sigma, params.identify_drag_sigma, params.identify_share_sigma
    current = _current_sigma(fit)
    if current > limits[0]:
        weak.append(f'current known to {current:.3g} m/s only (limit {limits[0]:.3g} m/s)')
    if fit.log_drag_sigma > limits[1]:
        known = _known(fit.log_drag_sigma, f'{100.0 * fit.log_drag_sigma:.0f} %')
        weak.append(f'drag at {fit.speed:.2f} m/s {known} (limit {100.0 * limits[1]:.0f} %)')
    turned = turned_through(window.psi)
    if weak and turned < ENOUGH_TURN:
        weak[-1] += f', for the heading turned through {math.degrees(turned):.0f} degrees'
        wishes.append('turn through at least 90 degrees')
    if fit.share_sigma > limits[2]:
        known = _known(fit.share_sigma, f'{fit.share_sigma:.2f}')
        weak.append(f'quadratic share of the drag {known} (limit {limits[2]:.2f})')
        if _wanted_change(fit, params) <= fit.speed:
            weak[-1] += f', for the speed varied by {fit.speed_span:.2f} m/s'
            wishes.append(_vary_thrust(fit, params))
    if weak and not wishes:
        wishes.append(f'collect more than {fit.fixes} fixes, turning and with changing thrust')
    return f'{"; ".join(weak)}: {" and ".join(wishes)}' if weak else ''


def _known(sigma: float, text: str) -> str:
    return f'known to {text} only' if sigma < 1.0 else 'unknown'


def _wanted_change(fit: Fit, params: IdentificationParams) -> float:
    """Change of speed that brings the share's sigma to its limit [m/s]: they are inverse."""
    wanted = fit.speed_span * fit.share_sigma / params.identify_share_sigma
    return max(wanted, _LEAST_CHANGE)


def _vary_thrust(fit: Fit, params: IdentificationParams) -> str:
    change = math.ceil(10.0 * _wanted_change(fit, params)) / 10.0
    return f'vary the thrust so that the speed changes by at least {change:.1f} m/s'
