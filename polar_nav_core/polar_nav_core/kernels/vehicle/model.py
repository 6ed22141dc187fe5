"""Reduced dynamic model of a vehicle in moving water (docs/derivations/vehicle_model.md).

M v_r' = -omega x (M v_r) - d(v_r) v_r + tau + P_z R^T e_z, with M diagonal (mass and added mass),
d_i = d1_i + d2_i |v_ri| and v_r the velocity through the water, body axes (forward, left, up). The
current itself is not in it.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel


@entry
@kernel
def relative_acceleration(
    a_b: Array,
    v_r_b: Array,
    omega_b: Array,
    up_b: Array,
    force_b: Array,
    inertia: Array,
    drag_linear: Array,
    drag_quadratic: Array,
    net_buoyancy: float,
) -> None:
    """Rate of v_r as the body sees it [m/s^2], into a_b.

    Parameters
    ----------
    v_r_b, omega_b, force_b : (3,) velocity through the water, rate against the Earth, thrust
    up_b : (3,) the vertical in body axes, the last row of C_b_G
    inertia, drag_linear, drag_quadratic : (3,) mass plus added mass, d1, d2
    net_buoyancy : buoyancy minus weight [N]
    """
    p_x = inertia[0] * v_r_b[0]
    p_y = inertia[1] * v_r_b[1]
    p_z = inertia[2] * v_r_b[2]
    c_x = omega_b[1] * p_z - omega_b[2] * p_y
    c_y = omega_b[2] * p_x - omega_b[0] * p_z
    c_z = omega_b[0] * p_y - omega_b[1] * p_x
    for k in range(3):
        c = c_x if k == 0 else c_y if k == 1 else c_z
        drag = (drag_linear[k] + drag_quadratic[k] * abs(v_r_b[k])) * v_r_b[k]
        a_b[k] = (force_b[k] + net_buoyancy * up_b[k] - c - drag) / inertia[k]


@kernel
def relative_acceleration_jacobian(
    F: Array,
    v_r_b: Array,
    omega_b: Array,
    inertia: Array,
    drag_linear: Array,
    drag_quadratic: Array,
) -> None:
    """Slope of a_b with v_r_b, shape (3, 3), into F; the drag's slope is d1 + 2 d2 |v|."""
    F[0, 0] = 0.0
    F[0, 1] = omega_b[2] * inertia[1]
    F[0, 2] = -omega_b[1] * inertia[2]
    F[1, 0] = -omega_b[2] * inertia[0]
    F[1, 1] = 0.0
    F[1, 2] = omega_b[0] * inertia[2]
    F[2, 0] = omega_b[1] * inertia[0]
    F[2, 1] = -omega_b[0] * inertia[1]
    F[2, 2] = 0.0
    for i in range(3):
        F[i, i] -= drag_linear[i] + 2.0 * drag_quadratic[i] * abs(v_r_b[i])
        for j in range(3):
            F[i, j] /= inertia[i]


@kernel
def rate_jacobian(G: Array, v_r_b: Array, inertia: Array) -> None:
    """Slope of a_b with omega_b: M^-1 [M v_r]x, shape (3, 3), into G."""
    p_x = inertia[0] * v_r_b[0]
    p_y = inertia[1] * v_r_b[1]
    p_z = inertia[2] * v_r_b[2]
    G[0, 0] = 0.0
    G[0, 1] = -p_z / inertia[0]
    G[0, 2] = p_y / inertia[0]
    G[1, 0] = p_z / inertia[1]
    G[1, 1] = 0.0
    G[1, 2] = -p_x / inertia[1]
    G[2, 0] = -p_y / inertia[2]
    G[2, 1] = p_x / inertia[2]
    G[2, 2] = 0.0


@entry
@kernel
def surge_drag(log_total: float, share: float, speed: float) -> tuple[float, float]:
    """(d1x, d2x) of ln Dt and f: d1 = (1 - f) Dt / U, d2 = f Dt / U^2 at the speed U."""
    total = math.exp(log_total)
    return (1.0 - share) * total / speed, share * total / (speed * speed)
