"""Strapdown integration in the grid frame (docs/derivations/grid.md, section 4).

Two speeds. The fast part gathers samples in the body frame of the block's start: a quaternion q,
the velocity U = integral of C(q) f and its integral S, with two-sample coning and sculling and
with the exact rotation compensation for constant rate and force (body). The slow part then moves
the navigation state over the whole block (navigation). A step is a block of one sample. Everything
is of second order in the sample interval and in the block length, or better.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel
from .body import EQUAL_INTERVALS, body_sample, coning_weight
from .earth import up_and_height
from .navigation import move, navigate


@kernel
def _one(
    C_b_G: Array, v_G: Array, r_e: Array,
    a_x: float, a_y: float, a_z: float,
    f_x: float, f_y: float, f_z: float,
    ap_x: float, ap_y: float, ap_z: float,
    fp_x: float, fp_y: float, fp_z: float,
    dt: float, weight: float,
) -> None:  # fmt: skip
    """`navigate` over one sample, a block with S = U dt / 2.

    Parameters
    ----------
    C_b_G, v_G, r_e : (3, 3), (3,), (3,) arrays, in place
    a_x, a_y, a_z, f_x, f_y, f_z : float
        Increments of angle [rad] and velocity [m/s], body axes.
    ap_x, ap_y, ap_z, fp_x, fp_y, fp_z : float
        The same of the interval before.
    dt : float
        Length of the interval [s].
    weight : float
        By `coning_weight` [-].
    """
    q_x, q_y, q_z, q_w, w_x, w_y, w_z = body_sample(
        a_x, a_y, a_z, f_x, f_y, f_z, ap_x, ap_y, ap_z, fp_x, fp_y, fp_z, weight
    )
    d_x = C_b_G[0, 0] * w_x + C_b_G[0, 1] * w_y + C_b_G[0, 2] * w_z
    d_y = C_b_G[1, 0] * w_x + C_b_G[1, 1] * w_y + C_b_G[1, 2] * w_z
    d_z = C_b_G[2, 0] * w_x + C_b_G[2, 1] * w_y + C_b_G[2, 2] * w_z
    h = 0.5 * dt
    navigate(C_b_G, v_G, r_e, q_x, q_y, q_z, q_w, d_x, d_y, d_z, h * d_x, h * d_y, h * d_z, dt)


@entry
@kernel
def strapdown_step(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    dtheta_b: Array,
    dvel_b: Array,
    dtheta_prev_b: Array,
    dvel_prev_b: Array,
    dt: float,
) -> None:
    """Advance C_b_G (3, 3), v_G (3,) [m/s], r_e (3,) [m] in place over one interval of dt [s].

    dtheta_b, dvel_b: integrals of omega_ib_b [rad] and f_b [m/s] over the interval; *_prev_b:
    those of the interval before, of the same length. Zeros for the first interval: the
    compensation terms are then zero.
    """
    _one(
        C_b_G, v_G, r_e,
        dtheta_b[0], dtheta_b[1], dtheta_b[2],
        dvel_b[0], dvel_b[1], dvel_b[2],
        dtheta_prev_b[0], dtheta_prev_b[1], dtheta_prev_b[2],
        dvel_prev_b[0], dvel_prev_b[1], dvel_prev_b[2],
        dt, EQUAL_INTERVALS,
    )  # fmt: skip


@entry
@kernel
def strapdown_step_uneven(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    dtheta_b: Array,
    dvel_b: Array,
    dtheta_prev_b: Array,
    dvel_prev_b: Array,
    dt: float,
    dt_prev: float,
) -> None:
    """`strapdown_step` after an interval of another length dt_prev [s] (0: there was none)."""
    _one(
        C_b_G, v_G, r_e,
        dtheta_b[0], dtheta_b[1], dtheta_b[2],
        dvel_b[0], dvel_b[1], dvel_b[2],
        dtheta_prev_b[0], dtheta_prev_b[1], dtheta_prev_b[2],
        dvel_prev_b[0], dvel_prev_b[1], dvel_prev_b[2],
        dt, coning_weight(dt, dt_prev),
    )  # fmt: skip


@kernel
def strapdown_step_held(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    increments: Array,
    dt: float,
    dt_prev: float,
    held: Array,
) -> None:
    """`strapdown_step_uneven` in given `surroundings` (8,), evaluated once for several steps.

    increments, (4, 3): angle and velocity increment of this step, then of the one before.
    """
    q_x, q_y, q_z, q_w, w_x, w_y, w_z = body_sample(
        increments[0, 0], increments[0, 1], increments[0, 2],
        increments[1, 0], increments[1, 1], increments[1, 2],
        increments[2, 0], increments[2, 1], increments[2, 2],
        increments[3, 0], increments[3, 1], increments[3, 2],
        coning_weight(dt, dt_prev),
    )  # fmt: skip
    d_x = C_b_G[0, 0] * w_x + C_b_G[0, 1] * w_y + C_b_G[0, 2] * w_z
    d_y = C_b_G[1, 0] * w_x + C_b_G[1, 1] * w_y + C_b_G[1, 2] * w_z
    d_z = C_b_G[2, 0] * w_x + C_b_G[2, 1] * w_y + C_b_G[2, 2] * w_z
    h = 0.5 * dt
    move(
        C_b_G, v_G, r_e, q_x, q_y, q_z, q_w, d_x, d_y, d_z, h * d_x, h * d_y, h * d_z, dt,
        held[0], held[1], held[2], held[3], held[4], held[5], held[6], held[7],
    )  # fmt: skip


@entry
@kernel
def strapdown_batch(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    dtheta_b: Array,
    dvel_b: Array,
    dtheta_prev_b: Array,
    dvel_prev_b: Array,
    dt: float,
) -> None:
    """`strapdown_step` over all rows of dtheta_b, dvel_b, each (n, 3), to the same bits.

    The *_prev_b arrays (3,) are read for the first row and hold the last row afterwards: calls can
    be chained.
    """
    for k in range(dtheta_b.shape[0]):
        strapdown_step(C_b_G, v_G, r_e, dtheta_b[k], dvel_b[k], dtheta_prev_b, dvel_prev_b, dt)
        for j in range(3):
            dtheta_prev_b[j] = dtheta_b[k, j]
            dvel_prev_b[j] = dvel_b[k, j]


@entry
@kernel
def hold_vertical(v_G: Array, r_e: Array, height: float, v_up: float) -> None:
    """Set height [m] and vertical velocity [m/s] of a state to stated values, as of a depth.

    The free vertical channel of any strapdown is unstable (time constant about 570 s).
    """
    u_x, u_y, u_z, h = up_and_height(r_e[0], r_e[1], r_e[2])
    r_e[0] += (height - h) * u_x
    r_e[1] += (height - h) * u_y
    r_e[2] += (height - h) * u_z
    v_G[2] = v_up


@entry
@kernel
def strapdown_batch_held(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    dtheta_b: Array,
    dvel_b: Array,
    dtheta_prev_b: Array,
    dvel_prev_b: Array,
    dt: float,
    height: Array,
    v_up: Array,
) -> None:
    """`strapdown_batch` with `hold_vertical` after each step; height, v_up: (n,)."""
    for k in range(dtheta_b.shape[0]):
        strapdown_step(C_b_G, v_G, r_e, dtheta_b[k], dvel_b[k], dtheta_prev_b, dvel_prev_b, dt)
        hold_vertical(v_G, r_e, height[k], v_up[k])
        for j in range(3):
            dtheta_prev_b[j] = dtheta_b[k, j]
            dvel_prev_b[j] = dvel_b[k, j]
