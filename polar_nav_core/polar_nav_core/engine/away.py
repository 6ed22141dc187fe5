"""Growth of a covariance over the time that a vehicle was not navigated.

Where pings after it show how the vehicle turns then (`first_seconds`), its rate of turn went from
that before to that after, and the covariance grows by what is not known of it. Else a vehicle that
was turning goes on turning, and ends that some time; another one may begin to. It goes where it
points: heading, velocity and path are off together, so that the first fixes after the restart
correct the heading, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..arrays import Array

TURN_OVER_S = 2.0
"""The rate of turn is the mean of so long before the state was saved [s]."""
TURN_LASTS_S = 20.0
"""Mean time that a turn still lasts [s]: a quarter turn of 30 m at 2 m/s takes 24 s."""
TURN_RATE = 0.02
"""1-sigma of the mean rate of a turn that nothing announced [rad/s]. Not more: a linear filter
with a heading that is uncertain by half a radian becomes sure of a wrong one."""
MOST_TURN = 1.0
"""A larger sigma of heading is none of a filter of small angles [rad]."""
HIDDEN_TURN = 2e-4
"""1-sigma of a turn that began and ended unseen, by the square of the time away [rad/s^2].

Turns at 0.07 rad/s that begin once in ten minutes and last 20 s, as those of a survey.
"""
WANDER_OVER_S = 60.0
"""How restless a track is, is found from so long before the state was saved [s]."""
SWING_TILT, SWING_HEADING, SWING_S = 0.1, 0.05, 0.5
"""1-sigma by which a vehicle in waves swings about its mean attitude [rad], and how long it takes
until where it was in that is no information [s]."""
ACCELERATION = 0.02
"""1-sigma of the mean acceleration along the way and up [m/s^2]."""
_LEAST_SPEED = 0.3
_LEAST_WINDOWS = 4
_MOST_RATE = 0.3
_JUMP_RATE = 0.5
"""No track turns faster [rad/s]: a step of the estimate that does is a correction."""
_PIECES = 100


@dataclass(frozen=True)
class Seen:
    """Motion of a vehicle from a stamp on, in level axes with x along its course.

    Attributes
    ----------
    begin_ns : int
        First sample of the restarted node [ns].
    rate : float
        Rate of turn of the track at `begin_ns`, about up [rad/s].
    turned : float
        What it turned since [rad].
    sigma_rate : float
        1-sigma of `rate` where that changes: a turn that begins is no parabola [rad/s].
    watched_s : float
        Time from `begin_ns` to now [s].
    path : (2,) array
        Way since `begin_ns`, along the course that the vehicle had then and to port of it [m].
    speed, up : float
        Over ground, horizontal and upwards, now [m/s].
    C_b_c : (3, 3) array
        Attitude: body axes to the level axes of the course, now.
    sigma_tilt : float
        1-sigma of what was level [rad].
    sigma_speed : float
        1-sigma of `speed` and `up`, slow errors of the DVL included [m/s].
    """

    begin_ns: int
    rate: float
    turned: float
    sigma_rate: float
    watched_s: float
    path: Array
    speed: float
    up: float
    C_b_c: Array
    sigma_tilt: float
    sigma_speed: float


class Rows(NamedTuple):
    """States of attitude [rad], velocity [m/s] and position [m] in a covariance."""

    phi: slice
    v: slice
    r: slice


def turn_rate(time_s: Array, v_G: Array) -> float:
    """Mean rate of turn of a track [rad/s] about up; at most 0.3.

    A fix that corrects the heading turns the estimated track, too, but at once: such steps are
    left out. 0 for a vehicle slower than 0.3 m/s, whose velocity does not show its heading.

    Parameters
    ----------
    time_s : (n,) array
        Of the velocities [s].
    v_G : (n, 3) array
        Estimated velocities, grid axes [m/s].
    """
    if len(v_G) < 2 or np.hypot(v_G[:, 0], v_G[:, 1]).min() < _LEAST_SPEED:
        return 0.0
    x, y = v_G[:, 0], v_G[:, 1]
    turned = np.arctan2(x[:-1] * y[1:] - y[:-1] * x[1:], x[:-1] * x[1:] + y[:-1] * y[1:])
    dt = np.diff(time_s)
    kept = np.abs(turned) <= _JUMP_RATE * dt
    total_s = float(dt[kept].sum())
    if total_s <= 0.0:
        return 0.0
    return float(np.clip(turned[kept].sum() / total_s, -_MOST_RATE, _MOST_RATE))


def wander(time_s: Array, v_G: Array, before: Array) -> Array:
    """Restlessness of a track (2,): 1-sigma of its rate of turn [rad/s] and acceleration [m/s^2].

    The RMS change from one window of 2 s to the next.

    Parameters
    ----------
    time_s : (n,) array
        Of the velocities [s].
    v_G : (n, 3) array
        Estimated velocities, grid axes [m/s].
    before : (2,) array
        What was found before, for a track that is too short or slow; zeros are nothing.
    """
    count = int((time_s[-1] - time_s[0]) / TURN_OVER_S) if len(time_s) else 0
    if count < _LEAST_WINDOWS or np.hypot(v_G[:, 0], v_G[:, 1]).min() < _LEAST_SPEED:
        return before
    ends = np.searchsorted(time_s, time_s[-1] - TURN_OVER_S * np.arange(count, -1, -1) - 1e-6)
    rates = [turn_rate(time_s[i : j + 1], v_G[i : j + 1]) for i, j in pairwise(ends)]
    speeds = np.stack([np.hypot(v_G[ends, 0], v_G[ends, 1]), v_G[ends, 2]])
    turned = float(np.mean(np.diff(rates) ** 2))
    pushed = np.mean((np.diff(speeds) / TURN_OVER_S) ** 2, axis=1)
    return np.sqrt([turned, float(pushed.max())])


def held_turn(rate: float, away_s: float) -> tuple[Array, Array]:
    """Rotation (3, 3) about up by a turn that dies out, and its integral over the time away [s].

    Parameters
    ----------
    rate : float
        Rate of turn at the begin [rad/s].
    away_s : float
        [s].
    """
    rate = float(np.clip(rate, -_MOST_RATE, _MOST_RATE))
    return _turn_and_path(-rate * TURN_LASTS_S * np.expm1(-_times(away_s) / TURN_LASTS_S), away_s)


def bridged_turn(before: float, after: float, away_s: float) -> tuple[Array, Array]:
    """Rotation and its integral as in `held_turn`, of a rate that changes evenly [rad/s]."""
    before, after = np.clip((before, after), -_MOST_RATE, _MOST_RATE)
    time_s = _times(away_s)
    return _turn_and_path((before + 0.5 * (after - before) * time_s / away_s) * time_s, away_s)


def bridged_variance(before: float, after: float, restless: float, away_s: float) -> float:
    """Variance of heading [rad^2] of a `bridged_turn` whose rates are known to ``restless``.

    A turn began or ended at any time between, and others did both.
    """
    rates = 6.0 * restless**2 + (after - before) ** 2
    sigma = min(HIDDEN_TURN * away_s**2, TURN_RATE * away_s)
    return float(min(rates * away_s**2 / 12.0 + sigma**2, MOST_TURN**2))


def _times(away_s: float) -> Array:
    """Middles of pieces of the time away, and its end [s]."""
    return np.append((np.arange(_PIECES) + 0.5) / _PIECES * away_s, away_s)


def _turn_and_path(turned: Array, away_s: float) -> tuple[Array, Array]:
    cosines, sines = np.cos(turned), np.sin(turned)
    return (
        _about_up(cosines[-1], sines[-1], 1.0),
        away_s * _about_up(cosines[:-1].mean(), sines[:-1].mean(), 1.0),
    )


def about_up(angle: float) -> Array:
    """Rotation (3, 3) by an angle about up [rad]."""
    return _about_up(np.cos(angle), np.sin(angle), 1.0)


def _about_up(c: float, s: float, up: float) -> Array:
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, up]])


def turn_variance(away_s: float) -> float:
    """Variance of heading [rad^2] by a turn that begins or ends while away."""
    return float(min(TURN_RATE * away_s, MOST_TURN) ** 2)


def add_turn(
    P: Array, rows: Rows, C_G_r: Array, v_G: Array, variance: float, away_s: float
) -> None:
    """Add the variances of an unknown turn to attitude, velocity and position, in place.

    The heading is a random walk h(t) whose variance at the end is V: the way abeam is the speed
    times the integral of h, with variance V t^2 / 3 and covariance V t / 2 with h(t). Velocity
    along the way is off by speed x h^2 / 2, which has the variance 3/4 V^2 speed^2.

    Parameters
    ----------
    P : (n, n) array
        Covariance, its position already carried on by the velocity.
    rows : Rows
    C_G_r : (3, 3) array
        Grid axes to the axes of the position.
    v_G : (3,) array
        Velocity at the end [m/s].
    variance : float
        V [rad^2].
    away_s : float
        t [s].
    """
    # Attitude and velocity are estimate minus truth: a vehicle turned by h has phi = h.
    abeam_G = np.array([v_G[1], -v_G[0], 0.0])
    bent_G = np.sqrt(0.75 * variance) * np.array([v_G[0], v_G[1], 0.0])
    for tilt, off_G in ((1.0, abeam_G), (0.0, bent_G)):
        now, path = np.zeros(len(P)), np.zeros(len(P))
        now[rows.phi.stop - 1] = tilt
        now[rows.v] = off_G
        path[rows.r] = C_G_r @ off_G * away_s
        both = np.outer(now, path)
        P += variance * (np.outer(now, now) + 0.5 * (both + both.T) + np.outer(path, path) / 3.0)


def add_swing(P: Array, phi: slice, away_s: float) -> None:
    """Add the variances by which a vehicle in waves swings meanwhile, in place."""
    swung = -np.expm1(-away_s / SWING_S)
    sigma = swung * np.array([SWING_TILT, SWING_TILT, SWING_HEADING])
    P[phi, phi] += np.diag(sigma**2)


def add_acceleration(
    P: Array, v: slice, r: slice, turn_to_r: Array, sigma: float, away_s: float
) -> None:
    """Add the variances of an unknown constant acceleration to velocity and position, in place.

    Parameters
    ----------
    P : (n, n) array
        Covariance, its position already carried on by the velocity.
    v, r : slice
        Three states of velocity [m/s] and three of position [m].
    turn_to_r : (3, 3) array
        Axes of the velocity to axes of the position.
    sigma : float
        Of the acceleration on each axis [m/s^2].
    away_s : float
        [s].
    """
    P[v, v] += np.eye(3) * (sigma * away_s) ** 2
    P[r, r] += np.eye(3) * (0.5 * sigma * away_s**2) ** 2
    cross = 0.5 * sigma**2 * away_s**3 * turn_to_r
    P[r, v] += cross
    P[v, r] += cross.T
