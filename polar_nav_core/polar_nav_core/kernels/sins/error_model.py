"""The exact 15-state system matrix of the grid strapdown (docs/derivations/error_model.md)."""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from ..frames.earth import ECCENTRICITY_2, OMEGA_IE, SEMI_MAJOR, gravity_slopes, up_and_height
from ..frames.grid import delta


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
def fill_system_matrix(
    F15: Array,
    r_e: Array,
    v_G: Array,
    C_b_G: Array,
    omega_ib_b: Array,  # noqa: ARG001
    f_b: Array,
) -> None:
    """d(error rate)/d(error), into F15 (15, 15): phi_G, dv_G, dr_e, gyro bias, accelerometer bias.

    Exact to first order on the ellipsoid, gravity gradient included. omega_ib_b [rad/s] is part of
    the signature because it is part of the linearization point; with phi in grid axes the matrix
    does not depend on it. Rows 9 to 14 are zero: bias models belong to the filter.
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
    w2 = 1.0 - ECCENTRICITY_2 * u_z * u_z
    w = math.sqrt(w2)
    r_n = SEMI_MAJOR / w
    r_m = r_n * (1.0 - ECCENTRICITY_2) / w2
    i_n = 1.0 / (r_n + h)
    i_m = 1.0 / (r_m + h)
    q = r_n * ECCENTRICITY_2 / w2 * i_n * i_m
    k_EE = i_n + q * p_E * p_E
    k_EN = q * p_E * p_N
    k_NN = i_n + q * p_N * p_N

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

    # C_G_e: columns grid east, grid north, up
    C00 = -u_x * kappa
    C01 = d
    C02 = -u_z * kappa
    C10 = -u_z * inv
    C12 = u_x * inv
    F15[6, 3] = C00
    F15[7, 3] = C01
    F15[8, 3] = C02
    F15[6, 4] = C10
    F15[8, 4] = C12
    F15[6, 5] = u_x
    F15[7, 5] = u_y
    F15[8, 5] = u_z

    # Columns by dr_e: first as derivatives along each grid axis, then times that axis in ECEF.
    g_h, g_s = gravity_slopes(u_z, h)
    dr_n = SEMI_MAJOR * ECCENTRICITY_2 * u_z / (w2 * w)
    dr_m = 3.0 * SEMI_MAJOR * (1.0 - ECCENTRICITY_2) * ECCENTRICITY_2 * u_z / (w2 * w2 * w)
    dq_s = 3.0 * ECCENTRICITY_2 * u_z / w2
    for j in range(3):
        # displacement by 1 m along axis j: rotation (b) of the grid axes apart from their turn
        # about up, and changes of p_E, p_N, sin(lat), height
        if j < 2:
            b_x = F15[0, 3 + j]
            b_y = F15[1, 3 + j]
            b_z = F15[2, 3 + j]
            p_E_j = p_N * b_z - u_z * b_y
            p_N_j = u_z * b_x - p_E * b_z
            s_j = p_E * b_y - p_N * b_x
            h_j = 0.0
        else:
            b_x = 0.0
            b_y = 0.0
            b_z = 0.0
            p_E_j = 0.0
            p_N_j = 0.0
            s_j = 0.0
            h_j = 1.0
        if j == 0:
            e_x = C00
            e_y = C01
            e_z = C02
        elif j == 1:
            e_x = C10
            e_y = 0.0
            e_z = C12
        else:
            e_x = u_x
            e_y = u_y
            e_z = u_z
        n_j = (dr_n * s_j + h_j) * i_n
        m_j = (dr_m * s_j + h_j) * i_m
        q_j = q * (dq_s * s_j - m_j - n_j)
        k_EE_j = -n_j * i_n + q_j * p_E * p_E + 2.0 * q * p_E * p_E_j
        k_EN_j = q_j * p_E * p_N + q * (p_E * p_N_j + p_N * p_E_j)
        k_NN_j = -n_j * i_n + q_j * p_N * p_N + 2.0 * q * p_N * p_N_j
        # C_weGR, grid columns; d(kappa) is (k_EE, k_EN, 0) / Delta^2
        t_x = -(v_x * k_EN_j + v_y * k_NN_j)
        t_y = v_x * k_EE_j + v_y * k_EN_j
        t_z = kappa * t_x
        if j < 2:
            t_z += eG_x * b_y * inv * inv
        # C_wieR = [w_ie x] C_betaR, grid columns
        w_x = ie_y * b_z - ie_z * b_y
        w_y = ie_z * b_x - ie_x * b_z
        w_z = ie_x * b_y - ie_y * b_x
        _add_outer(F15, 0, w_x + t_x, w_y + t_y, w_z + t_z, e_x, e_y, e_z)
        t_x += 2.0 * w_x
        t_y += 2.0 * w_y
        t_z += 2.0 * w_z
        _add_outer(
            F15,
            3,
            v_y * t_z - v_z * t_y,
            v_z * t_x - v_x * t_z,
            v_x * t_y - v_y * t_x - g_h * h_j - g_s * s_j,
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
            C00 * w_x + C10 * w_y + u_x * w_z,
            C01 * w_x + u_y * w_z,
            C02 * w_x + C12 * w_y + u_z * w_z,
            e_x,
            e_y,
            e_z,
        )
