"""Positions known to hundreds of metres or worse: corrections that follow the bent surface.

The error of a position is a vector; the surface of equal depth is bent. Where position and
correction are of kilometres the two part by metres (3 km: 0.7 m), which depths and fixes take for
an error of ten sigmas of the height. So the estimate is moved along the surface, a fix far off is
compared with it by its height, and the axes of the error turn with the vertical, in the next
transition (docs/derivations/error_model.md, 5). Below `FAR` all this is under a millimetre.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from .update import DR, NAV

FAR = 100.0
"""Position error from which on the bend counts [m]."""
_TIMES = 8
"""Steps of the height's iteration; each leaves the square of the angle moved by, at most."""


@kernel
def is_far(P: Array, x: Array) -> bool:
    """Whether the bend counts for a correction x (24,) beside a covariance P (24, 24)."""
    moved = 0.0
    known = 0.0
    for k in range(DR, DR + 3):
        moved += x[k] * x[k]
        known += P[k, k]
    return max(moved, known) > FAR * FAR


@kernel
def begin_move(turn: Array, r_e: Array, C_e_G: Array) -> float:
    """Height [m] of a position (3,) that is about to be moved; keeps its axes.

    Parameters
    ----------
    turn : (3, 3) array, in place
        Of the axes of the position error since the last transition; zeros for none.
    r_e : (3,) array
        ECEF [m].
    C_e_G : (3, 3) scratch
    """
    u_x, u_y, u_z, height = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    if turn[0, 0] == 0.0 and turn[1, 0] == 0.0 and turn[2, 0] == 0.0:
        for i in range(3):
            for j in range(3):
                turn[i, j] = C_e_G[i, j]
        return height
    for j in range(3):
        a, b, c = turn[0, j], turn[1, j], turn[2, j]
        for i in range(3):
            turn[i, j] = C_e_G[i, 0] * a + C_e_G[i, 1] * b + C_e_G[i, 2] * c
    return height


@kernel
def end_move(turn: Array, r_e: Array, C_e_G: Array, x: Array, height: float) -> None:
    """Put a moved position to the height that its correction means, and turn the axes.

    Parameters
    ----------
    turn, C_e_G : (3, 3) arrays, in place
        As `begin_move` leaves them: axes before.
    r_e : (3,) array, in place
        The position less x, ECEF [m].
    x : (24,) array
        The correction.
    height : float
        Before the correction [m].
    """
    u_x, u_y, u_z = C_e_G[2, 0], C_e_G[2, 1], C_e_G[2, 2]
    meant = height - (u_x * x[DR] + u_y * x[DR + 1] + u_z * x[DR + 2])
    for _ in range(_TIMES):
        _, _, _, h = up_and_height(r_e[0], r_e[1], r_e[2])
        r_e[0] += (meant - h) * u_x
        r_e[1] += (meant - h) * u_y
        r_e[2] += (meant - h) * u_z
    u_x, u_y, u_z, _ = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    for j in range(3):
        a, b, c = turn[0, j], turn[1, j], turn[2, j]
        for i in range(3):
            turn[i, j] = C_e_G[0, i] * a + C_e_G[1, i] * b + C_e_G[2, i] * c


@kernel
def turn_transition(Phi: Array, inverse: Array, turn: Array) -> None:
    """Turn the axes of the position error before a transition, in place; ``turn`` is zero then.

    Phi (24, 24) and inverse (10, 16) are as `transition.fill_transition` leaves them.
    """
    if turn[0, 0] == 0.0 and turn[1, 0] == 0.0 and turn[2, 0] == 0.0:
        return
    for i in range(NAV):
        a, b, c = Phi[i, DR], Phi[i, DR + 1], Phi[i, DR + 2]
        for k in range(3):
            Phi[i, DR + k] = a * turn[0, k] + b * turn[1, k] + c * turn[2, k]
    for j in range(inverse.shape[1]):
        a, b, c = inverse[DR, j], inverse[DR + 1, j], inverse[DR + 2, j]
        for k in range(3):
            inverse[DR + k, j] = turn[0, k] * a + turn[1, k] * b + turn[2, k] * c
    for i in range(3):
        for k in range(3):
            turn[i, k] = 0.0


@kernel
def bend_of(C_e_G: Array, r_e: Array, measured_r_e: Array) -> float:
    """Difference of heights [m] less that along up, of an estimate and a fix far from it; or 0.

    Parameters
    ----------
    C_e_G : (3, 3) array
        At the estimate.
    r_e, measured_r_e : (3,) arrays
        ECEF [m].
    """
    x = r_e[0] - measured_r_e[0]
    y = r_e[1] - measured_r_e[1]
    z = r_e[2] - measured_r_e[2]
    if not x * x + y * y + z * z > FAR * FAR:
        return 0.0
    _, _, _, here = up_and_height(r_e[0], r_e[1], r_e[2])
    _, _, _, there = up_and_height(measured_r_e[0], measured_r_e[1], measured_r_e[2])
    along_up: float = C_e_G[2, 0] * x + C_e_G[2, 1] * y + C_e_G[2, 2] * z
    return here - there - along_up
