"""Second-order terms of a large attitude error, added as noise: the filter itself is linear.

After a gap between IMU samples the attitude may be uncertain by half a radian. A body velocity
C_b_G^T v_G then depends on it by more than the rows of a ping say: by phi x (phi x v)/2, which is
decimetres per second where a DVL states millimetres. Taken at its word, a ping fixes the speed
along a wrong heading, and every later one repeats it: the covariance closes over a wrong attitude,
and good fixes are refused. The same remainder, of the turn that was really made, stays behind a
correction: the velocity is moved by phi x v and not round the arc.

Both are below 1e-4 of the velocity where the attitude is known to LARGE, and are left out there:
nothing changes in a filter that knows its attitude. So is what a tilt takes from gravity along up,
5e-5 of it there.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .reopen import GRAVITY
from .update import innovation_covariance

LARGE = 0.01
"""Attitude error from which on the remainder counts: root of the sum of squares [rad]."""
_TILTED_S = 5.0
"""A tilt lasts for so long, before fixes correct it."""


@kernel
def _square(v: Array) -> float:
    """Sum of the squares of the first three elements."""
    square: float = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    return square


@kernel
def add_bend_of_ping(R: Array, P: Array, v_G: Array) -> None:
    """Add to a ping's R (3, 3) [m^2/s^2] the second-order variance by an uncertain attitude.

    Half the square of the trace of P's attitude block, times v^2: an upper bound of the second
    term of the second-order filter, tr(H'' P H'' P)/2, in every direction.

    Parameters
    ----------
    R : (3, 3) array, in place
    P : (24, 24) array
    v_G : (3,) array
        Grid axes [m/s].
    """
    p = _attitude(P)
    if p > LARGE * LARGE:
        _add_bend(R, p, _square(v_G))


@kernel
def add_bend_of_carried_ping(
    R: Array, P: Array, v_G: Array, H: Array, PHt: Array, S: Array
) -> None:
    """`add_bend_of_ping`, by that part of the heading which the velocity does not turn with.

    A heading of which nothing is known turns the velocity, too, and does nothing to a ping, in
    the second order as in the first (carried). So its variance counts as p at most, with
    p v^2 = tr(H P H^T), what the rows leave uncertain.

    Parameters
    ----------
    R : (3, 3) array, in place
        [m^2/s^2].
    P : (24, 24) array
    v_G : (3,) array
        Grid axes [m/s].
    H : (3, 24) array
        Rows of the ping.
    PHt, S : (3, 24), (3, 3) scratch
    """
    p = _attitude(P)
    if p > LARGE * LARGE:
        innovation_covariance(S, PHt, P, H, R, 3)
        square = _square(v_G)
        own = max(S[0, 0] - R[0, 0] + S[1, 1] - R[1, 1] + S[2, 2] - R[2, 2], 0.0)
        if own < P[2, 2] * square:
            p += own / square - P[2, 2]
        _add_bend(R, p, square)


@kernel
def add_bend_of_gravity(q: Array, P: Array, dt: float) -> None:
    """Add to q (24,) what an uncertain tilt makes of gravity along up in a step of dt [s].

    A tilt of phi takes g phi^2/2 from the vertical force, where the transition, along the force
    that is felt, has up to twice as much: at its word, a depth sensor tells a tilt within seconds,
    and a wrong one. Half the square of the trace of P's tilt block, times g^2, is the mean square
    of that acceleration; as noise of a density it counts twice the time that the tilt lasts.
    """
    p: float = P[0, 0] + P[1, 1]
    if p > LARGE * LARGE:
        q[5] += _TILTED_S * GRAVITY * GRAVITY * p * p * dt


@kernel
def _attitude(P: Array) -> float:
    """Trace of the attitude's covariance [rad^2]."""
    p: float = P[0, 0] + P[1, 1] + P[2, 2]
    return p


@kernel
def _add_bend(R: Array, p: float, square: float) -> None:
    """Add the variance by an attitude of p [rad^2] and a velocity of this square [m^2/s^2]."""
    variance = 0.5 * p * p * square
    for k in range(3):
        R[k, k] += variance


@kernel
def add_bend_of_correction(P: Array, v_G: Array, x: Array) -> None:
    """Add to P (24, 24) the second-order remainder of a correction of the attitude.

    |phi|^2/2 is the 1-sigma added to the attitude, and with v that of the velocity.

    Parameters
    ----------
    P : (24, 24) array, in place
        Covariance after the update.
    v_G : (3,) array
        Grid axes [m/s], before the correction.
    x : (24,) array
        Estimated error.
    """
    turn = _square(x)
    if turn > LARGE * LARGE:
        variance = 0.25 * turn * turn
        pushed = variance * _square(v_G)
        for k in range(3):
            P[k, k] += variance
            P[3 + k, 3 + k] += pushed
