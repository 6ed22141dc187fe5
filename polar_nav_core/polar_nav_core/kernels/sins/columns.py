"""Quantities derived from state and covariance for nav/state: angles, headings, sigmas.

One row of numbers for each state; `polar_nav_core.nav_columns` names them. The live node calls
this for one row, a replay for thousands: the same code, so the same bits.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from ..frames.earth import up_and_height
from ..frames.grid import delta, fill_C_e_G
from .update import N

LATITUDE = 0
LONGITUDE = 1
HEIGHT = 2
ROLL = 3
PITCH = 4
GRID_HEADING = 5
TRUE_HEADING = 6
TRUE_HEADING_SIGMA = 7
CONVERGENCE = 8
QUATERNION = 9
POSITION_COVARIANCE = 13
VELOCITY_COVARIANCE = 22
ATTITUDE_COVARIANCE = 31
SIGMA = 40
DELTA = SIGMA + N
"""How far from singular the place is (`grid.delta`)."""
WIDTH = DELTA + 1

SIGMA_CAP = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known (uniform over the circle) [rad]."""
_TURN = 2.0 * math.pi
_VERTICAL = 1e-12
_VELOCITY = 3
_POSITION = 6
_HEADING = 2
_ROUNDING = 64.0 * 2.0**-52
"""Share of a covariance's trace within which a rotation of it is sure of a variance: each of the
two products rounds to some four units in the last place, and readers rotate once more."""


@kernel
def _euler(C: Array, row: Array) -> None:
    """Grid heading, roll and pitch; see `attitude.euler_from_matrix`."""
    cos_theta = math.hypot(C[0, 0], C[1, 0])
    row[PITCH] = math.atan2(-C[2, 0], cos_theta)
    if cos_theta < _VERTICAL:
        psi = math.atan2(-C[0, 1], C[1, 1])
        row[ROLL] = 0.0
    else:
        psi = math.atan2(C[1, 0], C[0, 0])
        row[ROLL] = math.atan2(C[2, 1], C[2, 2])
    row[GRID_HEADING] = (0.5 * math.pi - psi) % _TURN


@kernel
def _quaternion(C: Array, row: Array) -> None:
    """Unit quaternion x, y, z, w with w >= 0, by the largest of the four (Shepperd)."""
    xx = C[0, 0]
    yy = C[1, 1]
    zz = C[2, 2]
    if xx >= yy and xx >= zz and xx >= xx + yy + zz:
        x = 1.0 + xx - yy - zz
        y = C[0, 1] + C[1, 0]
        z = C[0, 2] + C[2, 0]
        w = C[2, 1] - C[1, 2]
    elif yy >= zz and yy >= xx + yy + zz:
        x = C[0, 1] + C[1, 0]
        y = 1.0 - xx + yy - zz
        z = C[1, 2] + C[2, 1]
        w = C[0, 2] - C[2, 0]
    elif zz >= xx + yy + zz:
        x = C[0, 2] + C[2, 0]
        y = C[1, 2] + C[2, 1]
        z = 1.0 - xx - yy + zz
        w = C[1, 0] - C[0, 1]
    else:
        x = C[2, 1] - C[1, 2]
        y = C[0, 2] - C[2, 0]
        z = C[1, 0] - C[0, 1]
        w = 1.0 + xx + yy + zz
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    row[QUATERNION] = x * scale
    row[QUATERNION + 1] = y * scale
    row[QUATERNION + 2] = z * scale
    row[QUATERNION + 3] = w * scale


@kernel
def _covariances(P: Array, C_e_G: Array, product: Array, row: Array) -> None:
    """Fill covariances of position (C_e_G P_e C_e_G'), velocity and attitude, and all sigmas."""
    for k in range(N):
        row[SIGMA + k] = math.sqrt(P[k, k])
    for i in range(3):
        for j in range(3):
            product[i, j] = (
                C_e_G[i, 0] * P[_POSITION, _POSITION + j]
                + C_e_G[i, 1] * P[_POSITION + 1, _POSITION + j]
                + C_e_G[i, 2] * P[_POSITION + 2, _POSITION + j]
            )
    for i in range(3):
        for j in range(3):
            row[POSITION_COVARIANCE + 3 * i + j] = (
                product[i, 0] * C_e_G[j, 0]
                + product[i, 1] * C_e_G[j, 1]
                + product[i, 2] * C_e_G[j, 2]
            )
            row[VELOCITY_COVARIANCE + 3 * i + j] = P[_VELOCITY + i, _VELOCITY + j]
            row[ATTITUDE_COVARIANCE + 3 * i + j] = P[i, j]
    _hold_position(row)


@kernel
def _hold_position(row: Array) -> None:
    """Enlarge the position's covariance where a variance is lost in the rounding of the others.

    One of 1 m^2 beside (1e8 m)^2 comes out of the rotation as some other number, below zero, too.
    """
    x = row[POSITION_COVARIANCE]
    y = row[POSITION_COVARIANCE + 4]
    z = row[POSITION_COVARIANCE + 8]
    least = _ROUNDING * (x + y + z)
    if x < least or y < least or z < least:
        for k in range(3):
            row[POSITION_COVARIANCE + 4 * k] += least


@kernel
def _true_heading(x: float, y: float, u_z: float, P: Array, row: Array) -> None:
    """True heading [rad] and its sigma, NaN where it cannot be known; see `grid.true_heading`."""
    row[TRUE_HEADING] = math.nan
    row[CONVERGENCE] = math.nan
    row[TRUE_HEADING_SIGMA] = SIGMA_CAP
    distance = math.hypot(x, y)
    if not distance > 0.0:
        return
    east_x = -y / distance
    east_y = x / distance
    p = _POSITION
    variance = (
        east_x * east_x * P[p, p]
        + east_x * east_y * (P[p, p + 1] + P[p + 1, p])
        + east_y * east_y * P[p + 1, p + 1]
    )
    sigma_east = 0.0 if variance < 0.0 else math.sqrt(variance)
    sigma = math.hypot(row[SIGMA + _HEADING], sigma_east / distance)
    if sigma >= SIGMA_CAP:
        return
    row[TRUE_HEADING_SIGMA] = sigma
    if sigma < SIGMA_CAP:  # or it is not a number
        angle = math.atan2(u_z * y, x)
        row[CONVERGENCE] = angle
        row[TRUE_HEADING] = (row[GRID_HEADING] + angle) % _TURN


@routine
def describe(r_e: Array, C_b_G: Array, P: Array, row: Array, scratch: Array) -> None:
    """Fill the row (WIDTH,) of derived columns of one state.

    Parameters
    ----------
    r_e : (3,) array
        Position, ECEF [m].
    C_b_G : (3, 3) array
    P : (24, 24) array
        Covariance of the error state.
    row : (WIDTH,) array
        Filled.
    scratch : (2, 3, 3) array
    """
    x = r_e[0]
    y = r_e[1]
    u_x, u_y, u_z, height = up_and_height(x, y, r_e[2])
    row[LATITUDE] = math.atan2(u_z, math.hypot(u_x, u_y))
    row[LONGITUDE] = math.atan2(y, x) if x != 0.0 or y != 0.0 else math.nan
    row[HEIGHT] = height
    _euler(C_b_G, row)
    _quaternion(C_b_G, row)
    row[DELTA] = delta(u_x, u_z)
    fill_C_e_G(u_x, u_y, u_z, scratch[0])
    _covariances(P, scratch[0], scratch[1], row)
    _true_heading(x, y, u_z, P, row)


@entry
@routine
def describe_many(r_e: Array, C_b_G: Array, P: Array, rows: Array, scratch: Array) -> None:
    """`describe` of each state: (n, 3), (n, 3, 3) and (n, 24, 24) into (n, WIDTH)."""
    for n in range(r_e.shape[0]):
        describe(r_e[n], C_b_G[n], P[n], rows[n], scratch)


@entry
@routine
def rotations_many(xyzw: Array, C: Array) -> None:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4) of about unit length; of zero ones, NaN.

    ``C = ((w^2 - |u|^2) I + 2 u u' + 2 w [u x]) / |q|^2``, u the vector part: rounding of the
    quaternion does not scale the matrix.
    """
    for n in range(xyzw.shape[0]):
        x = xyzw[n, 0]
        y = xyzw[n, 1]
        z = xyzw[n, 2]
        w = xyzw[n, 3]
        norm2 = x * x + y * y + z * z + w * w
        scale = 1.0 / norm2 if norm2 > 0.0 else math.nan
        diagonal = w * w - (x * x + y * y + z * z)
        twice = 2.0 * scale
        C[n, 0, 0] = (2.0 * x * x + diagonal) * scale
        C[n, 1, 1] = (2.0 * y * y + diagonal) * scale
        C[n, 2, 2] = (2.0 * z * z + diagonal) * scale
        C[n, 0, 1] = (x * y - w * z) * twice
        C[n, 1, 0] = (x * y + w * z) * twice
        C[n, 0, 2] = (x * z + w * y) * twice
        C[n, 2, 0] = (x * z - w * y) * twice
        C[n, 1, 2] = (y * z - w * x) * twice
        C[n, 2, 1] = (y * z + w * x) * twice
