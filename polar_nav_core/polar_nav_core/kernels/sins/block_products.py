"""Products of closed blocks of stored steps; passage of a late fix through closed blocks."""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel, routine
from . import state as fs
from .blocks import NONE, Blocks
from .state import Log, Past
from .three_rows import add_mean, add_outer, inner, rows_times, whiten, whitener
from .update import MARKOV, NAV, N


@kernel
def _build_step(Psi: Array, Phi: Array, work: Array) -> None:
    """Psi <- Phi Psi; work is (9, 24) or more."""
    n = Psi.shape[0]
    for i in range(NAV):
        for j in range(n):
            work[i, j] = (
                Phi[i, 0] * Psi[0, j] + Phi[i, 1] * Psi[1, j] + Phi[i, 2] * Psi[2, j]
                + Phi[i, 3] * Psi[3, j] + Phi[i, 4] * Psi[4, j] + Phi[i, 5] * Psi[5, j]
                + Phi[i, 6] * Psi[6, j] + Phi[i, 7] * Psi[7, j] + Phi[i, 8] * Psi[8, j]
                + Phi[i, 9] * Psi[9, j] + Phi[i, 10] * Psi[10, j] + Phi[i, 11] * Psi[11, j]
                + Phi[i, 12] * Psi[12, j] + Phi[i, 13] * Psi[13, j] + Phi[i, 14] * Psi[14, j]
            )  # fmt: skip
    for i in range(NAV):
        for j in range(n):
            Psi[i, j] = work[i, j]
    for i in range(MARKOV, N):
        d = Phi[i, i]
        for j in range(n):
            Psi[i, j] *= d


@kernel
def _build_update(
    Psi: Array, Lambda: Array, mean: Array, work: Array, log: Log, u: int, m: int
) -> None:
    """Psi <- (I - K H) Psi, Lambda and lambda grow by (H Psi)^T S^-1 (H Psi, z).

    Rows 0..2 of work hold H Psi, rows 3..5 S^-1 H Psi; those from m on are zero.
    """
    n = Psi.shape[0]
    H = log.H[u]
    L = log.L[u]
    K = log.K[u]
    if m == 1:
        for j in range(n):
            work[0, j] = 0.0
        for k in range(N):
            h = H[0, k]
            if h != 0.0:
                for j in range(n):
                    work[0, j] += h * Psi[k, j]
        s = 1.0 / L[0, 0]
        for j in range(n):
            work[3, j] = work[0, j] * s * s
        s = log.z[u, 0]
        for j in range(n):
            mean[j] += s * work[3, j]
        for i in range(n):
            g = work[0, i]
            k_0 = K[0, i]
            for j in range(n):
                Lambda[i, j] += g * work[3, j]
                Psi[i, j] -= k_0 * work[0, j]
        return
    for a in range(6):
        for j in range(n):
            work[a, j] = 0.0
    for k in range(N):
        for a in range(m):
            h = H[a, k]
            if h != 0.0:
                for j in range(n):
                    work[a, j] += h * Psi[k, j]
    for a in range(m):
        for j in range(n):
            work[3 + a, j] = work[a, j]
        for b in range(a):
            s = L[a, b]
            for j in range(n):
                work[3 + a, j] -= s * work[3 + b, j]
        s = 1.0 / L[a, a]
        for j in range(n):
            work[3 + a, j] *= s
    for r in range(m):
        a = m - 1 - r
        for b in range(a + 1, m):
            s = L[b, a]
            for j in range(n):
                work[3 + a, j] -= s * work[3 + b, j]
        s = 1.0 / L[a, a]
        for j in range(n):
            work[3 + a, j] *= s
    for a in range(m):
        s = log.z[u, a]
        for j in range(n):
            mean[j] += s * work[3 + a, j]
    for i in range(n):
        g_0 = work[0, i]
        g_1 = work[1, i]
        g_2 = work[2, i]
        k_0 = K[0, i]
        k_1 = K[1, i]
        k_2 = K[2, i]
        for j in range(n):
            Lambda[i, j] += g_0 * work[3, j] + g_1 * work[4, j] + g_2 * work[5, j]
            Psi[i, j] -= k_0 * work[0, j] + k_1 * work[1, j] + k_2 * work[2, j]


@routine
def build(past: Past, log: Log, bl: Blocks, b: int, end: int) -> None:
    """Psi, Lambda and lambda of block b from its entries; its prior is as it was filtered."""
    length = log.kinds.shape[0]
    Psi = bl.Delta[b]  # for a while
    Lambda = bl.Lambda[b]
    mean = bl.means[b, 0]
    for i in range(N):
        for j in range(N):
            Psi[i, j] = 0.0
            Lambda[i, j] = 0.0
        Psi[i, i] = 1.0
        mean[i] = 0.0
        bl.means[b, 1, i] = 0.0
    u = bl.head[b]
    for entry in range(bl.first[b], end + 1):
        while u != NONE and bl.place[u] == entry:
            _build_update(Psi, Lambda, mean, bl.scratch, log, u, 3)
            u = bl.next[u]
        if entry == end:
            break
        e = entry % length
        if log.kinds[e] == fs.STEP:
            Phi = past.transitions[log.numbers[e] % past.transitions.shape[0]]
            _build_step(Psi, Phi, bl.scratch)
        else:
            w = log.numbers[e] % log.H.shape[0]
            _build_update(Psi, Lambda, mean, bl.scratch, log, w, log.rows[e])
    T = bl.T[b]
    for i in range(N):
        for j in range(N):
            T[j, i] = Psi[i, j]
        for j in range(i):  # equal but for rounding
            Lambda[i, j] = 0.5 * (Lambda[i, j] + Lambda[j, i])
            Lambda[j, i] = Lambda[i, j]
    for i in range(N):
        for j in range(N):
            Psi[i, j] = 0.0
    bl.built[b] = 1


@kernel
def cross_block(C: Array, P_cc: Array, z: Array, bl: Blocks, b: int) -> None:
    """Carry a late fix through a closed block; stores its rows and innovation at the entry."""
    for a in range(3):
        bl.z[b, a] = z[a]
        for d in range(3):
            bl.P_cc[b, a, d] = P_cc[a, d]
        for k in range(N):
            bl.C[b, a, k] = C[a, k]
    V = bl.V[b]
    rows_times(V, bl.C[b], bl.Lambda[b])
    rows_times(C, bl.C[b], bl.T[b])
    X = bl.small[0]
    inner(X, bl.C[b], V)
    for a in range(3):
        s = 0.0
        for k in range(N):
            s += bl.C[b, a, k] * bl.means[b, 0, k]
        z[a] -= s
        for d in range(3):
            P_cc[a, d] -= 0.5 * (X[a, d] + X[d, a])


@kernel
def change_prior(bl: Blocks, b: int) -> None:
    """Replace the prior of a closed block by that with the late fix fused before it.

    The whitened columns are those that `change_block` of the block before has left.
    """
    B = bl.small[1]
    W = bl.scratch[0:3]
    add_outer(bl.Delta[b], -1.0, W, W)
    add_mean(bl.means[b, 1], 1.0, W, B, bl.z[b])


@kernel
def change_block(
    bl: Blocks, b: int, C: Array, P_cc: Array, z: Array, R: Array, Y: Array, sign: float
) -> bool:
    """Replace Psi, Lambda and lambda of a closed block by those with the late fix fused.

    C, P_cc, z are those at its end; ``sign`` Y P = cov(c, x at the start | block) but for what
    does not depend on the block. B C stays in scratch[0:3], B in small[1].
    """
    B = bl.small[1]
    if not whitener(B, P_cc, R):
        return False
    W = bl.scratch[0:3]
    X = bl.scratch[3:6]
    whiten(W, B, C)
    whiten(X, B, Y)
    add_outer(bl.T[b], -sign, X, W)
    add_outer(bl.Lambda[b], 1.0, X, X)
    add_mean(bl.means[b, 0], sign, X, B, z)
    return True


@kernel
def correct_for_prior(C: Array, P_cc: Array, z: Array, Y: Array, bl: Blocks, b: int) -> None:
    """From the prior that a block was filtered with to that of now: C, P_cc, z, Y at its end."""
    D = bl.scratch[0:3]
    rows_times(D, Y, bl.Delta[b])
    for a in range(3):
        s = 0.0
        for k in range(N):
            s += D[a, k] * bl.means[b, 0, k] + Y[a, k] * bl.means[b, 1, k]
        z[a] -= s
    X = bl.scratch[3:6]
    rows_times(X, D, bl.Lambda[b])
    for a in range(3):
        for k in range(N):
            Y[a, k] -= X[a, k]
    rows_times(X, D, bl.T[b])
    for a in range(3):
        for k in range(N):
            C[a, k] += X[a, k]
    Q = bl.small[0]
    inner(Q, D, Y)
    for a in range(3):
        for d in range(3):
            P_cc[a, d] += 0.5 * (Q[a, d] + Q[d, a])
