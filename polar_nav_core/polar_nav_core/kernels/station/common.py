"""Common errors of station mode: sensitivities of the state to constants not estimated.

As kernels.sins.consider: an error b that all fixes share moves the estimate of a member by S b
whatever it believes. S is carried through every step and update, the gain stays that of P, and
what is published is P + S B S^T with B = diag(sigma^2). Equations:
docs/derivations/common_errors.md.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from . import state as ss
from .state import Bank, Settings, Work


@kernel
def transform(
    V: Array, h: float, f_drag: float, f_share: float, g_x: float, g_y: float, w: Work
) -> None:
    """V <- F V for the columns of V (12, k); slopes as `step.slopes` left them."""
    F, R = w.F, w.R
    for j in range(V.shape[1]):
        v0 = V[0, j]
        v1 = V[1, j]
        v2 = V[2, j]
        for i in range(3):
            V[i, j] += h * (F[i, 0] * v0 + F[i, 1] * v1 + F[i, 2] * v2)
            V[3 + i, j] += h * (R[i, 0] * v0 + R[i, 1] * v1 + R[i, 2] * v2)
        V[0, j] += h * (f_drag * V[ss.DRAG, j] + f_share * V[ss.SHARE, j])
        V[3, j] += h * (V[ss.CURRENT, j] + g_x * V[ss.HEADING, j])
        V[4, j] += h * (V[ss.CURRENT + 1, j] + g_y * V[ss.HEADING, j])


@kernel
def fix_common(J: Array, H: Array, distance: float) -> None:
    """Innovation of a fix per unit of each common error, (2, COMMON); measured less expected.

    Parameters
    ----------
    J : (2, COMMON) array, out
    H : (2, 12) array
        Rows of range and bearing at the validity.
    distance : float
        Measured range [m].
    """
    for a in range(2):
        for k in range(ss.COMMON):
            J[a, k] = 0.0
        J[a, ss.OFFSET] = H[a, ss.POSITION]
        J[a, ss.OFFSET + 1] = H[a, ss.POSITION + 1]
    J[0, ss.RANGE_SCALE] = distance
    J[1, ss.TURN] = 1.0


@kernel
def subtract_state(J: Array, H: Array, S: Array, m: int) -> None:
    """J <- J - H S for the first m rows: what is left of each error in the innovation."""
    for a in range(m):
        for i in range(ss.N):
            h = H[a, i]
            if h != 0.0:
                for k in range(ss.COMMON):
                    J[a, k] -= h * S[i, k]


@kernel
def widen(wide: Array, S: Array, J: Array, sigma: Array) -> None:
    """Innovation covariance (S00, S01, S11) with the common errors: wide = S + J B J^T."""
    for i in range(3):
        wide[i] = S[i]
    for k in range(ss.COMMON):
        b = sigma[k] * sigma[k]
        wide[0] += b * J[0, k] * J[0, k]
        wide[1] += b * J[0, k] * J[1, k]
        wide[2] += b * J[1, k] * J[1, k]


@kernel
def add_common(P: Array, b: Bank, c: Settings, w: Work) -> None:
    """P <- P + S B S^T (12, 12), with S the mean of the members' by their weights."""
    S = w.common
    for i in range(ss.N):
        for k in range(ss.COMMON):
            S[i, k] = 0.0
            for m in range(b.x.shape[0]):
                S[i, k] += b.weight[m] * b.S[m, i, k]
            S[i, k] *= c.common[k]
    for i in range(ss.N):
        for j in range(i + 1):
            s = P[i, j]
            for k in range(ss.COMMON):
                s += S[i, k] * S[j, k]
            P[i, j] = s
            P[j, i] = s
