"""The exact 15-state system matrix of the grid strapdown (docs/derivations/error_model.md)."""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel
from ..frames.earth import (
    ECCENTRICITY_2,
    OMEGA_IE,
    SEMI_MAJOR,
    gravity_slopes,
    radii,
    up_and_height,
)
from ..frames.grid import curvatures, delta, excess_curvature


@kernel
def _add_outer(
    F: Array, row: int, x: float, y: float, z: float, e_x: float, e_y: float, e_z: float
) -> None:
    """F[row:row+3, 6:9] += (x, y, z) (e_x, e_y, e_z)^T."""
    F[row, 6] += x * e_x
    F[row, 7] += x * e_y
    F[row, 8] += x * e_z
    F[row + 1, 6] += y * e_x
    F[row + 1, 7] += y * e_y
    F[row + 1, 8] += y * e_z
    F[row + 2, 6] += z * e_x
    F[row + 2, 7] += z * e_y
    F[row + 2, 8] += z * e_z


@kernel
def _curvature_slopes(
    p_E: float,
    p_N: float,
    u_z: float,
    h: float,
    dp_E: float,
    dp_N: float,
    ds: float,
    dh: float,
) -> tuple[float, float, float]:
    """Slopes (dk_EE, dk_EN, dk_NN) [1/m^2] of the curvatures along a grid axis; eq. (3).

    Parameters
    ----------
    p_E, p_N : float
        Spin axis in the horizontal plane, grid axes [-].
    u_z, h : float
        sin(latitude) [-] and height [m].
    dp_E, dp_N, ds, dh : float
        Slopes of p_E, p_N and sin(latitude) [1/m], and of the height [-], along that axis.
    """
    w2 = 1.0 - ECCENTRICITY_2 * u_z * u_z
    w = math.sqrt(w2)
    r_m, r_n = radii(u_z)
    i_n = 1.0 / (r_n + h)
    i_m = 1.0 / (r_m + h)
    q = excess_curvature(u_z, h, i_n)
    dr_n = SEMI_MAJOR * ECCENTRICITY_2 * u_z / (w2 * w)
    dr_m = 3.0 * SEMI_MAJOR * (1.0 - ECCENTRICITY_2) * ECCENTRICITY_2 * u_z / (w2 * w2 * w)
    n = (dr_n * ds + dh) * i_n
    m = (dr_m * ds + dh) * i_m
    dq = q * (3.0 * ECCENTRICITY_2 * u_z / w2 * ds - m - n)
    return (
        -n * i_n + dq * p_E * p_E + 2.0 * q * p_E * dp_E,
        dq * p_E * p_N + q * (p_E * dp_N + p_N * dp_E),
        -n * i_n + dq * p_N * p_N + 2.0 * q * p_N * dp_N,
    )


@kernel
def _position_columns(
    F15: Array, v_G: Array, u_x: float, u_y: float, u_z: float, h: float
) -> None:
    """Columns of F15 by dr_e, added to its zeros: eqs. (2) to (5).

    First as derivatives along each grid axis, then times that axis in ECEF. Bg and C_G_e are read
    in F15, where they stand by dv (rows of phi and of dr).

    Parameters
    ----------
    F15 : (15, 15) array, in place
    v_G : (3,) array
        Velocity over ground, grid axes [m/s].
    u_x, u_y, u_z, h : float
        Up vector, ECEF [-], and height [m].
    """
    inv = 1.0 / delta(u_x, u_z)
    kappa = u_y * inv
    p_E = -kappa * u_z
    p_N = u_x * inv
    ie_x = OMEGA_IE * p_E
    ie_y = OMEGA_IE * p_N
    ie_z = OMEGA_IE * u_z
    v_x = v_G[0]
    v_y = v_G[1]
    v_z = v_G[2]
    eG_x = F15[0, 3] * v_x + F15[0, 4] * v_y
    g_h, g_s = gravity_slopes(u_z, h)
    for j in range(3):
        # displacement by 1 m along axis j: rotation (b) of the grid axes apart from their turn
        # about up, and changes of p_E, p_N, sin(lat), height
        b_x = F15[0, 3 + j]
        b_y = F15[1, 3 + j]
        b_z = F15[2, 3 + j]
        dp_E = p_N * b_z - u_z * b_y
        dp_N = u_z * b_x - p_E * b_z
        ds = p_E * b_y - p_N * b_x
        dh = 1.0 if j == 2 else 0.0
        k_EE, k_EN, k_NN = _curvature_slopes(p_E, p_N, u_z, h, dp_E, dp_N, ds, dh)
        # C_weGR, grid columns; d(kappa) is (k_EE, k_EN, 0) / Delta^2
        t_x = -(v_x * k_EN + v_y * k_NN)
        t_y = v_x * k_EE + v_y * k_EN
        t_z = kappa * t_x + eG_x * b_y * inv * inv
        # C_wieR = [w_ie x] C_betaR, grid columns
        w_x = ie_y * b_z - ie_z * b_y
        w_y = ie_z * b_x - ie_x * b_z
        w_z = ie_x * b_y - ie_y * b_x
        e_x = F15[6, 3 + j]
        e_y = F15[7, 3 + j]
        e_z = F15[8, 3 + j]
        _add_outer(F15, 0, w_x + t_x, w_y + t_y, w_z + t_z, e_x, e_y, e_z)
        t_x += 2.0 * w_x
        t_y += 2.0 * w_y
        t_z += 2.0 * w_z
        _add_outer(
            F15,
            3,
            v_y * t_z - v_z * t_y,
            v_z * t_x - v_x * t_z,
            v_x * t_y - v_y * t_x - g_h * dh - g_s * ds,
            e_x,
            e_y,
            e_z,
        )
        # -C_G_e [v x] C_betaR, its grid columns taken to ECEF
        w_x = -(v_y * b_z - v_z * b_y)
        w_y = -(v_z * b_x - v_x * b_z)
        w_z = -(v_x * b_y - v_y * b_x)
        _add_outer(
            F15,
            6,
            F15[6, 3] * w_x + F15[6, 4] * w_y + F15[6, 5] * w_z,
            F15[7, 3] * w_x + F15[7, 5] * w_z,
            F15[8, 3] * w_x + F15[8, 4] * w_y + F15[8, 5] * w_z,
            e_x,
            e_y,
            e_z,
        )


@entry
@kernel
def fill_system_matrix(F15: Array, r_e: Array, v_G: Array, C_b_G: Array, f_b: Array) -> None:
    """d(error rate)/d(error), into F15: phi_G, dv_G, dr_e, gyro bias, accelerometer bias.

    Exact to first order on the ellipsoid, gravity gradient included. With phi in grid axes the
    matrix does not depend on the angular rate. Rows 9 to 14 are zero: bias models belong to the
    filter.

    Parameters
    ----------
    F15 : (15, 15) array, out
        Units of the errors: rad, m/s, m, rad/s, m/s^2; rates per second.
    r_e : (3,) array
        Position, ECEF [m].
    v_G : (3,) array
        Velocity over ground, grid axes [m/s].
    C_b_G : (3, 3) array
        Body to grid.
    f_b : (3,) array
        Specific force, body axes [m/s^2].
    """
    for i in range(15):
        for j in range(15):
            F15[i, j] = 0.0

    u_x, u_y, u_z, h = up_and_height(r_e[0], r_e[1], r_e[2])
    d = delta(u_x, u_z)
    inv = 1.0 / d
    kappa = u_y * inv
    p_E = -kappa * u_z
    p_N = u_x * inv
    _, r_n = radii(u_z)
    k_EE, k_EN, k_NN = curvatures(p_E, p_N, u_z, h, 1.0 / (r_n + h))

    v_x = v_G[0]
    v_y = v_G[1]
    v_z = v_G[2]
    ie_x = OMEGA_IE * p_E
    ie_y = OMEGA_IE * p_N
    ie_z = OMEGA_IE * u_z
    eG_x = -(k_EN * v_x + k_NN * v_y)
    eG_y = k_EE * v_x + k_EN * v_y
    eG_z = kappa * eG_x
    iG_x = ie_x + eG_x
    iG_y = ie_y + eG_y
    iG_z = ie_z + eG_z
    o_x = iG_x + ie_x
    o_y = iG_y + ie_y
    o_z = iG_z + ie_z

    # phi' by phi: -[w_iG x]
    F15[0, 1] = iG_z
    F15[0, 2] = -iG_y
    F15[1, 0] = -iG_z
    F15[1, 2] = iG_x
    F15[2, 0] = iG_y
    F15[2, 1] = -iG_x
    # phi' by dv: C_weGv = Bg
    F15[0, 3] = -k_EN
    F15[0, 4] = -k_NN
    F15[1, 3] = k_EE
    F15[1, 4] = k_EN
    F15[2, 3] = -kappa * k_EN
    F15[2, 4] = -kappa * k_NN
    # dv' by phi: [f_G x]
    f_x = C_b_G[0, 0] * f_b[0] + C_b_G[0, 1] * f_b[1] + C_b_G[0, 2] * f_b[2]
    f_y = C_b_G[1, 0] * f_b[0] + C_b_G[1, 1] * f_b[1] + C_b_G[1, 2] * f_b[2]
    f_z = C_b_G[2, 0] * f_b[0] + C_b_G[2, 1] * f_b[1] + C_b_G[2, 2] * f_b[2]
    F15[3, 1] = -f_z
    F15[3, 2] = f_y
    F15[4, 0] = f_z
    F15[4, 2] = -f_x
    F15[5, 0] = -f_y
    F15[5, 1] = f_x
    # dv' by dv: [v x] Bg - [(2 w_ie + w_eG) x]; the third column of Bg is zero
    for j in range(3, 5):
        b_x = F15[0, j]
        b_y = F15[1, j]
        b_z = F15[2, j]
        F15[3, j] = v_y * b_z - v_z * b_y
        F15[4, j] = v_z * b_x - v_x * b_z
        F15[5, j] = v_x * b_y - v_y * b_x
    F15[3, 4] += o_z
    F15[3, 5] = -o_y
    F15[4, 3] -= o_z
    F15[4, 5] = o_x
    F15[5, 3] += o_y
    F15[5, 4] -= o_x
    # biases
    for i in range(3):
        for j in range(3):
            F15[i, 9 + j] = -C_b_G[i, j]
            F15[3 + i, 12 + j] = C_b_G[i, j]

    # dr' by dv: C_G_e, columns grid east, grid north, up
    F15[6, 3] = -u_x * kappa
    F15[7, 3] = d
    F15[8, 3] = -u_z * kappa
    F15[6, 4] = -u_z * inv
    F15[8, 4] = u_x * inv
    F15[6, 5] = u_x
    F15[7, 5] = u_y
    F15[8, 5] = u_z
    _position_columns(F15, v_G, u_x, u_y, u_z, h)
