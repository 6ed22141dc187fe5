"""Pose and twist of a vehicle in a local frame, with covariances, and a dead-reckoned frame."""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from .columns import QUATERNION, _quaternion
from .present import C_B_G, C_E_G, MOVED, R_E, RATE, V_G, Scratch

# Places in the numbers of a nav_msgs/Odometry, in their order.
POSITION, ORIENTATION, POSE_COVARIANCE, LINEAR, ANGULAR, TWIST_COVARIANCE = 0, 3, 7, 43, 46, 49
NUMBERS = 85
_PHI, _DV, _DR, _GYRO = 0, 3, 6, 9


@entry
@kernel
def to_map(
    C_e_m: Array, origin_e: Array, now: Array, r_m: Array, C_b_m: Array, moved_m: Array
) -> None:
    """Fill position, attitude and way in map axes from the values of a `Now` (`present`)."""
    C_b_G, C_e_G = now[C_B_G : C_B_G + 9].reshape(3, 3), now[C_E_G : C_E_G + 9].reshape(3, 3)
    for i in range(3):
        r_m[i] = 0.0
        moved_m[i] = 0.0
        for k in range(3):
            r_m[i] += C_e_m[i, k] * (now[R_E + k] - origin_e[k])
            moved_m[i] += C_e_m[i, k] * now[MOVED + k]
        for j in range(3):
            C_b_m[i, j] = 0.0
            for k in range(3):
                C_b_e = C_e_G[0, k] * C_b_G[0, j] + C_e_G[1, k] * C_b_G[1, j]
                C_b_m[i, j] += C_e_m[i, k] * (C_b_e + C_e_G[2, k] * C_b_G[2, j])


@entry
@kernel
def move_on(
    r_m: Array,
    C_b_m: Array,
    moved_m: Array,
    C_turn_b: Array,
    begun: bool,
    position: Array,
    C_b_o: Array,
    origin: Array,
    C_o_m: Array,
    last: Array,
    turn: Array,
) -> None:
    """Move a vehicle on in a dead-reckoned frame `odom`, and that frame in the map.

    Parameters
    ----------
    r_m, C_b_m, moved_m, C_turn_b : arrays
        As of `local_frame.DeadReckoning.move`.
    begun : bool
        Whether there was a call before.
    position, C_b_o : (3,), (3, 3) arrays, in place
        Pose of the vehicle in odom [m].
    origin, C_o_m : (3,), (3, 3) arrays, in place
        Pose of odom in the map [m].
    last, turn : (3, 3), (1,) arrays, in place
        ``C_b_m`` of the call before; heading of odom in the map [rad].
    """
    if begun:
        x, y = 0.0, 0.0  # of the turn R = C_b_m (last C_turn_b)^T about up
        for k in range(3):
            first = last[0, 0] * C_turn_b[0, k] + last[0, 1] * C_turn_b[1, k]
            first += last[0, 2] * C_turn_b[2, k]
            second = last[1, 0] * C_turn_b[0, k] + last[1, 1] * C_turn_b[1, k]
            second += last[1, 2] * C_turn_b[2, k]
            x += C_b_m[0, k] * first + C_b_m[1, k] * second
            y += C_b_m[1, k] * first - C_b_m[0, k] * second
        for i in range(3):
            for k in range(3):
                position[i] += C_o_m[k, i] * moved_m[k]
        turn[0] += math.atan2(y, x)
    else:
        for i in range(3):
            position[i] = r_m[i]
    c, s = math.cos(turn[0]), math.sin(turn[0])
    C_o_m[0, 0], C_o_m[0, 1], C_o_m[1, 0], C_o_m[1, 1] = c, -s, s, c
    for i in range(3):
        origin[i] = r_m[i]
        for j in range(3):
            last[i, j] = C_b_m[i, j]
            C_b_o[i, j] = 0.0
            for k in range(3):
                C_b_o[i, j] += C_o_m[k, i] * C_b_m[k, j]
        for k in range(3):
            origin[i] -= C_o_m[i, k] * position[k]


@kernel
def _moment(P: Array, A: Array, a: int, B: Array, b: int, i: int, j: int) -> float:
    """Element (i, j) of A P_ab B^T for blocks of three of P."""
    total = 0.0
    for k in range(3):
        x, y, z = P[a + k, b], P[a + k, b + 1], P[a + k, b + 2]
        total += A[i, k] * (B[j, 0] * x + B[j, 1] * y + B[j, 2] * z)
    return total


@entry
@routine
def pose_and_twist(
    r: Array,
    C_b: Array,
    C_e: Array,
    now: Array,
    P: Array,
    gyro_variance: float,
    out: Array,
    w: Scratch,
) -> None:
    """Fill the numbers (NUMBERS,) of a nav_msgs/Odometry.

    Parameters
    ----------
    r, C_b : (3,), (3, 3) arrays
        Position [m] and attitude in the frame.
    C_e : (3, 3) array
        Takes ECEF components to the frame's.
    now : (VALUES,) array
        Of a `Now` (`present`).
    P : (15, 15) array
        Covariance as of `present.covariance_now`.
    gyro_variance : float
        Of the noise in the rate [rad^2/s^2].
    out : (NUMBERS,) array
    w : Scratch
    """
    C_b_G = now[C_B_G : C_B_G + 9].reshape(3, 3)
    turn, C_G_b = w.rotations[0], w.rotations[1]
    _quaternion(C_b, w.row)
    for k in range(4):
        out[ORIENTATION + k] = w.row[QUATERNION + k]
    for i in range(3):
        out[POSITION + i] = r[i]
        out[ANGULAR + i] = now[RATE + i]
        out[LINEAR + i] = 0.0
        for k in range(3):
            C_G_b[i, k] = C_b_G[k, i]
            out[LINEAR + i] += C_b_G[k, i] * now[V_G + k]
            # Estimate minus truth, as of the position.
            turn[i, k] = -(
                C_b[i, 0] * C_b_G[k, 0] + C_b[i, 1] * C_b_G[k, 1] + C_b[i, 2] * C_b_G[k, 2]
            )
    pose = out[POSE_COVARIANCE : POSE_COVARIANCE + 36].reshape(6, 6)
    twist = out[TWIST_COVARIANCE : TWIST_COVARIANCE + 36].reshape(6, 6)
    for i in range(3):
        for j in range(3):
            pose[i, j] = _moment(P, C_e, _DR, C_e, _DR, i, j)
            pose[i, 3 + j] = _moment(P, C_e, _DR, turn, _PHI, i, j)
            pose[3 + j, i] = pose[i, 3 + j]
            pose[3 + i, 3 + j] = _moment(P, turn, _PHI, turn, _PHI, i, j)
            twist[i, j] = _moment(P, C_G_b, _DV, C_G_b, _DV, i, j)
            twist[i, 3 + j] = 0.0
            twist[3 + i, j] = 0.0
            twist[3 + i, 3 + j] = P[_GYRO + i, _GYRO + j]
        twist[3 + i, 3 + i] += gyro_variance
