"""What a smoother needs of a filter's steps and updates, gathered from one node to the next.

As the adjoint of derivations/smoother.md (1) and (2), composed forwards: with Psi the transition
of a member's error since the node,

    step:         Psi <- Phi Psi
    measurement:  a <- a + Psi^T H^T S^-1 [z, J],   M <- M + Psi^T H^T S^-1 H Psi,
                  Psi <- (I - K H) Psi

so that an adjoint after all of it is before it  Psi^T lambda - a,  its covariance
Psi^T Lambda Psi + M. The columns of a: the innovation, and its change per unit of each common
error. Fixes are no part of it: each stands at a node, with its rows.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from . import state as ss
from .common import transform
from .state import Tape, Work


@kernel
def tape_step(
    tape: Tape,
    m: int,
    h: float,
    e: float,
    f_drag: float,
    f_share: float,
    g_x: float,
    g_y: float,
    w: Work,
) -> None:
    """Add a step of member m; slopes as `step.slopes` left them, e: decay of the last state."""
    if tape.Psi.shape[0] == 0:
        return
    Psi = tape.Psi[m]
    transform(Psi, h, f_drag, f_share, g_x, g_y, w)
    for j in range(ss.N):
        Psi[ss.STATION, j] *= e


@kernel
def tape_depth(tape: Tape, m: int, up: Array, w: Work, shares: bool) -> None:
    """Add a fused depth of member m: ``w`` has its innovation, its covariance and P H^T."""
    if tape.Psi.shape[0] == 0:
        return
    Psi, a, M = tape.Psi[m], tape.vector[m], tape.information[m]
    g = w.d
    weight = 1.0 / w.S[m, 0]
    for j in range(ss.N):
        g[j] = 0.0
        for k in range(3):
            g[j] += up[k] * Psi[ss.POSITION + k, j]
    for i in range(ss.N):
        a[i, 0] += g[i] * weight * w.z[m, 0]
        if shares:
            for k in range(ss.COMMON):
                a[i, 1 + k] += g[i] * weight * w.J[m, 0, k]
        for j in range(ss.N):
            M[i, j] += g[i] * weight * g[j]
            Psi[i, j] -= weight * w.PHt[m, 0, i] * g[j]


@kernel
def tape_rows(tape: Tape, m: int, H: Array) -> None:
    """Keep the rows (2, 12) of a fix for member m."""
    if tape.Psi.shape[0] > 0:
        for a in range(2):
            for j in range(ss.N):
                tape.H[m, a, j] = H[a, j]
