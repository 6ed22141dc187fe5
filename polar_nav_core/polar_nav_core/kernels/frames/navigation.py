"""The slow part of the strapdown: the navigation state over a block (grid.md, section 4).

Grid rotation, Coriolis, gravity at mid-block, position through C_G_e at mid-block. What the
samples of the block add up to in the body frame comes in: rotation, velocity and path.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from .earth import OMEGA_IE, SEMI_MAJOR, SEMI_MINOR, gravity
from .grid import curvatures, frame_near

_AXES_RATIO_2 = (SEMI_MAJOR / SEMI_MINOR) ** 2


@kernel
def _turn_attitude(
    C_b_G: Array,
    q_x: float, q_y: float, q_z: float, q_w: float,
    z_x: float, z_y: float, z_z: float,
) -> None:  # fmt: skip
    """C_b_G <- exp(-[z x]) C_b_G C(q), orthonormal to rounding afterwards.

    z, the turn of the grid axes, is under 1e-4 rad for blocks up to 1 s: its exponential is taken
    to second order. The first two rows are computed and brought back to unit length and right
    angle by first-order corrections, shared evenly; the third row is their cross product. Of an
    error of orthonormality e is left e^2, at every step, so that rounding cannot add up.
    """
    h_x = 0.5 * z_x
    h_y = 0.5 * z_y
    h_z = 0.5 * z_z
    g_00 = 1.0 - h_y * z_y - h_z * z_z
    g_01 = z_z + h_x * z_y
    g_02 = h_x * z_z - z_y
    g_10 = h_x * z_y - z_z
    g_11 = 1.0 - h_x * z_x - h_z * z_z
    g_12 = z_x + h_y * z_z
    x_0 = g_00 * C_b_G[0, 0] + g_01 * C_b_G[1, 0] + g_02 * C_b_G[2, 0]
    y_0 = g_00 * C_b_G[0, 1] + g_01 * C_b_G[1, 1] + g_02 * C_b_G[2, 1]
    z_0 = g_00 * C_b_G[0, 2] + g_01 * C_b_G[1, 2] + g_02 * C_b_G[2, 2]
    x_1 = g_10 * C_b_G[0, 0] + g_11 * C_b_G[1, 0] + g_12 * C_b_G[2, 0]
    y_1 = g_10 * C_b_G[0, 1] + g_11 * C_b_G[1, 1] + g_12 * C_b_G[2, 1]
    z_1 = g_10 * C_b_G[0, 2] + g_11 * C_b_G[1, 2] + g_12 * C_b_G[2, 2]
    d_x = q_x + q_x
    d_y = q_y + q_y
    d_z = q_z + q_z
    r_00 = 1.0 - d_y * q_y - d_z * q_z
    r_11 = 1.0 - d_x * q_x - d_z * q_z
    r_22 = 1.0 - d_x * q_x - d_y * q_y
    r_01 = d_x * q_y - d_z * q_w
    r_10 = d_x * q_y + d_z * q_w
    r_02 = d_x * q_z + d_y * q_w
    r_20 = d_x * q_z - d_y * q_w
    r_12 = d_y * q_z - d_x * q_w
    r_21 = d_y * q_z + d_x * q_w
    p_x = x_0 * r_00 + y_0 * r_10 + z_0 * r_20
    p_y = x_0 * r_01 + y_0 * r_11 + z_0 * r_21
    p_z = x_0 * r_02 + y_0 * r_12 + z_0 * r_22
    o_x = x_1 * r_00 + y_1 * r_10 + z_1 * r_20
    o_y = x_1 * r_01 + y_1 * r_11 + z_1 * r_21
    o_z = x_1 * r_02 + y_1 * r_12 + z_1 * r_22
    e = 0.5 * (p_x * o_x + p_y * o_y + p_z * o_z)
    n_p = 1.5 - 0.5 * (p_x * p_x + p_y * p_y + p_z * p_z)
    n_o = 1.5 - 0.5 * (o_x * o_x + o_y * o_y + o_z * o_z)
    x = n_p * p_x - e * o_x
    y = n_p * p_y - e * o_y
    z = n_p * p_z - e * o_z
    o_x = n_o * o_x - e * p_x
    o_y = n_o * o_y - e * p_y
    o_z = n_o * o_z - e * p_z
    C_b_G[0, 0] = x
    C_b_G[0, 1] = y
    C_b_G[0, 2] = z
    C_b_G[1, 0] = o_x
    C_b_G[1, 1] = o_y
    C_b_G[1, 2] = o_z
    C_b_G[2, 0] = y * o_z - z * o_y
    C_b_G[2, 1] = z * o_x - x * o_z
    C_b_G[2, 2] = x * o_y - y * o_x


@kernel
def surroundings(
    v_G: Array, r_e: Array, half: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Up vector, 1/Delta, curvatures and gravity at the position ``half`` [s] from now.

    Returns
    -------
    u_x, u_y, u_z, inv_d : float
        Up vector, ECEF, and 1/Delta: they give the grid frame and the earth rate.
    k_EE, k_EN, k_NN : float
        Curvatures [1/m].
    g : float
        Gravity [m/s^2].
    """
    # The normal of the similar ellipsoid through the point is along (x, y, z a^2/b^2): within
    # e^2 h / R of the true up, far under a micrometre in v dt/2, and cheap.
    v_x = v_G[0]
    v_y = v_G[1]
    v_z = v_G[2]
    n_x = r_e[0]
    n_y = r_e[1]
    n_z = r_e[2] * _AXES_RATIO_2
    d2 = n_x * n_x + n_z * n_z
    i = 1.0 / math.sqrt(d2 + n_y * n_y)
    j = 1.0 / math.sqrt(d2)
    m = half * i * (v_z - v_x * n_y * j)
    o = half * v_y * j
    u_x, u_y, u_z, inv_d, i_n, h = frame_near(
        r_e[0] + m * n_x - o * n_z,
        r_e[1] + half * i * (v_x * d2 * j + v_z * n_y),
        r_e[2] + m * n_z + o * n_x,
    )
    k_EE, k_EN, k_NN = curvatures(-(u_y * inv_d) * u_z, u_x * inv_d, u_z, h, i_n)
    return u_x, u_y, u_z, inv_d, k_EE, k_EN, k_NN, gravity(u_z, h)


@kernel
def move(
    C_b_G: Array, v_G: Array, r_e: Array,
    q_x: float, q_y: float, q_z: float, q_w: float,
    d_x: float, d_y: float, d_z: float,
    p_x: float, p_y: float, p_z: float,
    dt: float,
    u_x: float, u_y: float, u_z: float, inv_d: float,
    k_EE: float, k_EN: float, k_NN: float,
    g: float,
) -> None:  # fmt: skip
    """Move C_b_G, v_G and r_e over a block of dt [s] in given `surroundings`, in place.

    Parameters
    ----------
    C_b_G, v_G, r_e : (3, 3), (3,), (3,) arrays
        Body to grid; velocity over ground, grid axes [m/s]; position, ECEF [m].
    q_x, q_y, q_z, q_w : float
        Rotation of the body in the block as a quaternion, end to start.
    d_x, d_y, d_z : float
        C_b_G U: velocity gained by force, grid axes of the block's start [m/s].
    p_x, p_y, p_z : float
        C_b_G S: path gained by force, the same axes [m].
    dt : float
        Length of the block [s].
    u_x, u_y, u_z, inv_d : float
        Up vector at mid-block, ECEF, and 1/Delta [-].
    k_EE, k_EN, k_NN : float
        Curvatures of the height surface there, grid axes [1/m].
    g : float
        Gravity there, along -u [m/s^2].
    """
    half = 0.5 * dt
    v_x = v_G[0]
    v_y = v_G[1]
    v_z = v_G[2]
    kappa = u_y * inv_d
    ie_x = -OMEGA_IE * kappa * u_z
    ie_y = OMEGA_IE * u_x * inv_d
    ie_z = OMEGA_IE * u_z
    g *= dt

    # Velocity and path, first with the rates of the old velocity, then with those of the mean
    # velocity.
    t_x = -(k_EN * v_x + k_NN * v_y)
    t_y = k_EE * v_x + k_EN * v_y
    t_z = kappa * t_x
    z_x = ie_x + t_x
    z_y = ie_y + t_y
    z_z = ie_z + t_z
    # The grid axes turn under the force: d loses w_iG x (integral of t dd = dt d - p) and p the
    # integral of that; second-order terms and the latter as for a constant force.
    s = dt * (1.0 / 3.0)
    x = dt * d_x - p_x
    y = dt * d_y - p_y
    z = dt * d_z - p_z
    x -= s * (z_y * z - z_z * y)
    y -= s * (z_z * x - z_x * z)
    z -= s * (z_x * y - z_y * x)
    d_x -= z_y * z - z_z * y
    d_y -= z_z * x - z_x * z
    d_z -= z_x * y - z_y * x + g
    x = p_x - s * (z_y * p_z - z_z * p_y)
    y = p_y - s * (z_z * p_x - z_x * p_z)
    z = p_z - s * (z_x * p_y - z_y * p_x)
    o_x = z_x + ie_x
    o_y = z_y + ie_y
    o_z = z_z + ie_z
    i = 1.0 / dt
    s_x = v_x + (x * i - half * (o_y * v_z - o_z * v_y))
    s_y = v_y + (y * i - half * (o_z * v_x - o_x * v_z))
    s_z = v_z + (z * i - half * (o_x * v_y - o_y * v_x) - 0.5 * g)
    t_x = -(k_EN * s_x + k_NN * s_y)
    t_y = k_EE * s_x + k_EN * s_y
    t_z = kappa * t_x
    o_x = 2.0 * ie_x + t_x
    o_y = 2.0 * ie_y + t_y
    o_z = 2.0 * ie_z + t_z
    c_x = dt * (o_y * s_z - o_z * s_y)
    c_y = dt * (o_z * s_x - o_x * s_z)
    c_z = dt * (o_x * s_y - o_y * s_x)
    v_G[0] = v_x + (d_x - c_x)
    v_G[1] = v_y + (d_y - c_y)
    v_G[2] = v_z + (d_z - c_z)

    # Position: C_G_e at mid-block times the path.
    s_x *= dt
    s_y *= dt
    s_z *= dt
    m = s_z - s_x * kappa
    o = s_y * inv_d
    r_e[0] += m * u_x - o * u_z
    r_e[1] += s_x * (u_x * u_x + u_z * u_z) * inv_d + s_z * u_y
    r_e[2] += m * u_z + o * u_x

    _turn_attitude(
        C_b_G, q_x, q_y, q_z, q_w, dt * (ie_x + t_x), dt * (ie_y + t_y), dt * (ie_z + t_z)
    )


@kernel
def navigate(
    C_b_G: Array, v_G: Array, r_e: Array,
    q_x: float, q_y: float, q_z: float, q_w: float,
    d_x: float, d_y: float, d_z: float,
    p_x: float, p_y: float, p_z: float,
    dt: float,
) -> None:  # fmt: skip
    """`move` in the `surroundings` at mid-block.

    Parameters
    ----------
    C_b_G, v_G, r_e : (3, 3), (3,), (3,) arrays, in place
    q_x, q_y, q_z, q_w, d_x, d_y, d_z, p_x, p_y, p_z : float
        Rotation [-], velocity [m/s] and path [m] of the block, as of `move`.
    dt : float
        Length of the block [s].
    """
    u_x, u_y, u_z, inv_d, k_EE, k_EN, k_NN, g = surroundings(v_G, r_e, 0.5 * dt)
    move(
        C_b_G, v_G, r_e, q_x, q_y, q_z, q_w, d_x, d_y, d_z, p_x, p_y, p_z, dt,
        u_x, u_y, u_z, inv_d, k_EE, k_EN, k_NN, g,
    )  # fmt: skip
