"""Growth of a covariance over the time that a vehicle was not navigated.

The velocity is held. What the vehicle may have done meanwhile is an acceleration that was constant
over that time, so that its effects on velocity and position go together; and a turn.
"""

from __future__ import annotations

import numpy as np

from .events import Array

TURN_RATE = 0.02
"""1-sigma of the mean rate of turn while away [rad/s]."""
SWING_TILT, SWING_HEADING, SWING_S = 0.1, 0.05, 0.5
"""1-sigma by which a vehicle in waves swings about its mean attitude [rad], and how long it takes
until where it was in that says nothing [s]."""
ACCELERATION = 0.02
"""1-sigma of the mean acceleration along the way and up [m/s^2]."""
MOST_TURN = 0.5
"""A larger sigma of heading is none of a filter of small angles [rad]."""


def grow(P: Array, v: slice, r: slice, turn_to_r: Array, speed: float, away_s: float) -> None:
    """Add the variances of an unknown acceleration to velocity and position, in place.

    Parameters
    ----------
    P : (n, n) array
        Covariance, its position already carried on by the velocity.
    v, r : slice
        Three states of velocity [m/s] and three of position [m].
    turn_to_r : (3, 3) array
        Axes of the velocity to axes of the position.
    speed : float
        Of the vehicle over ground [m/s].
    away_s : float
        [s].
    """
    sigma = np.hypot(ACCELERATION, speed * TURN_RATE)
    P[v, v] += np.eye(3) * (sigma * away_s) ** 2
    P[r, r] += np.eye(3) * (0.5 * sigma * away_s**2) ** 2
    cross = 0.5 * sigma**2 * away_s**3 * turn_to_r
    P[r, v] += cross
    P[v, r] += cross.T


def attitude_variances(away_s: float) -> Array:
    """Variances (3,) of tilt and heading that are added [rad^2]."""
    swung = -np.expm1(-away_s / SWING_S)
    tilt = SWING_TILT * swung
    turn = min(float(np.hypot(SWING_HEADING * swung, TURN_RATE * away_s)), MOST_TURN)
    return np.array([tilt**2, tilt**2, turn**2])
