"""An IMU sample that differs from the one before by far more than is usual: half believed.

Something struck the vehicle, or the sample is wrong. A blow that is shorter than the IMU can
follow comes as one sample, whose integral may be off by as much as it says; so is a single rate or
force that never was. Nobody knows which, and the sample is integrated: attitude and velocity
become as uncertain as it may be off, so that a ping or a fix finds what it did, and no gate
closes.

What is usual is the running mean square of the changes, in which one that is far off counts no
more than the limit: an IMU on a vehicle that begins to shake is soon as usual as it is then.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from . import state as fs
from .enlarged import hold_covariance, tell_enlarged
from .rings import Log
from .settings import Settings
from .state import State
from .work import Work

_RATE, _TURN = 0.1, 3.0
_FORCE, _JERK = 3.0, 20.0
"""A smaller change is none, whatever is usual: so much [rad/s], [m/s^2], and what a vehicle does
by itself in the time between two samples [rad/s^2], [m/s^3]."""
_OVER_S = 10.0
"""Time over which the mean square is taken."""
_FEWEST = 100
"""Samples before anything is unusual."""


@kernel
def doubt_shock(
    s: State, c: Settings, w: Work, log: Log, stamp_ns: int, omega_ib_b: Array, f_b: Array
) -> None:
    """Let attitude and velocity be as uncertain as a sample that leaps may be off."""
    interval_ns = stamp_ns - s.counters[fs.IMU_NS]
    missing = 2 * interval_ns > 3 * s.counters[fs.USUAL_NS]  # more time, more change
    if s.counters[fs.HAS_PREVIOUS] == 0 or missing:
        return
    dt = interval_ns * 1e-9
    s.counters[fs.CHANGES] += 1
    number = s.counters[fs.CHANGES]
    weight = max(1.0 / number, dt / _OVER_S)
    rates = _leaps(s, c, 0, _RATE + _TURN * dt, weight, omega_ib_b)
    forces = _leaps(s, c, 1, _FORCE + _JERK * dt, weight, f_b)
    if number < _FEWEST or not (rates or forces):
        return
    hold_covariance(s, w)
    if rates:
        _doubt(s, 0, 0, dt, omega_ib_b)
    if forces:
        _doubt(s, 1, 3, dt, f_b)
    tell_enlarged(s, w, log)
    s.counters[fs.SHOCK_NS] = stamp_ns


@kernel
def _leaps(s: State, c: Settings, row: int, least: float, weight: float, values: Array) -> bool:
    """Whether the change of rates or forces is unusual; notes it among those that are usual."""
    far = 0.0
    for k in range(3):
        far = max(far, abs(values[k] - s.previous[row, k]))
    limit = max(c.shock * math.sqrt(s.usual[row]), least)
    taken = min(far, limit)
    s.usual[row] += (taken * taken - s.usual[row]) * weight
    return bool(far > limit)


@kernel
def _doubt(s: State, row: int, first: int, dt: float, values: Array) -> None:
    """Add to P from a state on what the change of a sample moves it by, in grid axes."""
    for k in range(3):
        off = (values[k] - s.previous[row, k]) * dt
        for i in range(3):
            for j in range(3):
                s.P[first + i, first + j] += off * off * s.C_b_G[i, k] * s.C_b_G[j, k]
