"""Updates of the 31 states in blocks: P (24, 24), P_xe (24, 7) and P_ee (7, 7) (model).

Gains and what else has one row per measured value are transposed, as in `update`; `gain_of` and
`subtract` there do each block (docs/derivations/model_aiding.md).
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .model import E
from .update import N


@kernel
def joint_innovation(
    S: Array,
    PHt: Array,
    G_e: Array,
    P: Array,
    P_xe: Array,
    P_ee: Array,
    H: Array,
    H_e: Array,
    R: Array,
) -> None:
    """(P H^T)^T of all 31 states, (3, 24) and (3, 7), and S = H P H^T + R."""
    for a in range(3):
        for i in range(N):
            PHt[a, i] = 0.0
        for i in range(E):
            G_e[a, i] = 0.0
        for k in range(N):
            h = H[a, k]
            if h != 0.0:
                for i in range(N):
                    PHt[a, i] += h * P[k, i]
                for i in range(E):
                    G_e[a, i] += h * P_xe[k, i]
        for k in range(E):
            h = H_e[a, k]
            if h != 0.0:
                for i in range(N):
                    PHt[a, i] += h * P_xe[i, k]
                for i in range(E):
                    G_e[a, i] += h * P_ee[k, i]
    for a in range(3):
        for b in range(a + 1):
            s = 0.5 * (R[a, b] + R[b, a])
            for k in range(N):
                s += H[a, k] * PHt[b, k]
            for k in range(E):
                s += H_e[a, k] * G_e[b, k]
            S[a, b] = s
            S[b, a] = s


@kernel
def rows_of_block(G_e: Array, H: Array, P_xe: Array, m: int) -> None:
    """(P_ex H^T)^T for m rows that do not know e."""
    for a in range(m):
        for i in range(E):
            G_e[a, i] = 0.0
        for k in range(N):
            h = H[a, k]
            if h != 0.0:
                for i in range(E):
                    G_e[a, i] += h * P_xe[k, i]


@kernel
def is_jointly_definite(
    P_xe: Array, P_ee: Array, L: Array, A: Array, B: Array, active: int
) -> bool:
    """Whether P_ee - P_ex P^-1 P_xe is positive definite; L is the Cholesky factor of P.

    A (24, 7) and B (7, 7) are scratch; of x the first ``active`` states count.
    """
    for a in range(E):
        for i in range(active):
            s = P_xe[i, a]
            for k in range(i):
                s -= L[i, k] * A[k, a]
            A[i, a] = s / L[i, i]
    for a in range(E):
        for b in range(a + 1):
            s = P_ee[a, b]
            for k in range(active):
                s -= A[k, a] * A[k, b]
            for k in range(b):
                s -= B[a, k] * B[b, k]
            if a == b:
                if not s > 0.0:
                    return False
                B[a, a] = s**0.5
            else:
                B[a, b] = s / B[b, b]
    return True
