"""Covariance added for a gap between IMU samples.

Over a gap the last rates are held, and decay, and the velocity is held (`bridge`). What the
vehicle does meanwhile is not known: the rate drifts off, so that the error of attitude grows with
the square of the time at first, and the error of velocity, an acceleration, with the time. After
HELD_S both go on as random walks. A vehicle rights itself and seldom turns about: the growth of
tilt and heading ends where a linear filter would, too.

After LONG_S the place is held as well: the vehicle may have gone on as it went, or the clock has
stepped and nothing has happened at all. The variance of the position has both.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel

HELD_S = 1.0
"""Time that rates and accelerations of a vehicle last; the stated variances are those after it."""
LONG_S = 60.0
"""After so long the position is held, too."""
LONG_NS = round(LONG_S * 1e9)
MOST_PATH = 1e6
"""Sigma up to which a gap makes the position uncertain [m]."""
MOST_TILT = 0.2
MOST_HEADING = 0.5
"""Sigmas up to which a gap makes the attitude uncertain [rad]."""
ATTITUDE, VELOCITY = 0, 1
"""Elements of Settings.gap_variances: after HELD_S, per axis [rad^2], [m^2/s^2]."""


@kernel
def _attitude_share(gap: float) -> float:
    """Variance of attitude after a gap [s], of that after HELD_S."""
    t = gap / HELD_S
    return t * t * t * t if t < 1.0 else 4.0 * t - 3.0


@kernel
def _velocity_share(gap: float) -> float:
    """Variance of velocity after a gap [s], of that after HELD_S."""
    t = gap / HELD_S
    return t * t if t < 1.0 else 2.0 * t - 1.0


@kernel
def add_gap_noise(q: Array, P: Array, variances: Array, before: float, after: float) -> None:
    """Add to q (24,) the variances of a step that leads from ``before`` to ``after`` in a gap [s].

    Parameters
    ----------
    q : (24,) array, in place
    P : (24, 24) array
        Covariance before the step.
    variances : (2,) array
        By ATTITUDE, VELOCITY.
    before, after : float
        Time since the last IMU sample [s].
    """
    turned = variances[ATTITUDE] * (_attitude_share(after) - _attitude_share(before))
    pushed = variances[VELOCITY] * (_velocity_share(after) - _velocity_share(before))
    for k in range(3):
        most = MOST_TILT if k < 2 else MOST_HEADING
        q[k] += min(turned, max(0.0, most * most - P[k, k]))
        q[3 + k] += pushed


@kernel
def add_path_not_known(P: Array, v_G: Array, before: float, after: float) -> None:
    """Add to P (24, 24) the path that is unknown from ``before`` to ``after`` in a gap [s].

    Both after LONG_S; a vehicle that went on at v_G [m/s] is one sigma away.
    """
    first, last = before - LONG_S, after - LONG_S
    square = v_G[0] * v_G[0] + v_G[1] * v_G[1] + v_G[2] * v_G[2]
    for k in range(6, 9):
        P[k, k] += min(square * (last * last - first * first), MOST_PATH * MOST_PATH)
