"""Products of closed blocks of stored steps; passage of a late fix through closed blocks."""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel, routine
from . import rings
from . import state as fs
from .blocks import NONE, Blocks
from .rings import Log, Past
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
def _build_scalar(Psi: Array, Lambda: Array, mean: Array, work: Array, log: Log, u: int) -> None:
    """`_build_update` of one row."""
    n = Psi.shape[0]
    H = log.H[u]
    K = log.K[u]
    for j in range(n):
        work[0, j] = 0.0
    for k in range(N):
        h = H[0, k]
        if h != 0.0:
            for j in range(n):
                work[0, j] += h * Psi[k, j]
    s = 1.0 / log.L[u, 0, 0]
    z_0 = log.z[u, 0]
    for j in range(n):
        w_0 = work[0, j] * s * s
        work[3, j] = w_0
        mean[j] += z_0 * w_0
    for i in range(N):
        g = work[0, i]
        k_0 = K[0, i]
        for j in range(N):
            Lambda[i, j] += g * work[3, j]
            Psi[i, j] -= k_0 * work[0, j]


@kernel
def _build_update(Psi: Array, Lambda: Array, mean: Array, work: Array, log: Log, u: int) -> None:
    """Psi <- (I - K H) Psi, Lambda and lambda grow by (H Psi)^T S^-1 (H Psi, z); three rows.

    Rows 0..2 of work hold H Psi, rows 3..5 S^-1 H Psi.
    """
    n = Psi.shape[0]
    K = log.K[u]
    L = log.L[u]
    rows_times(work, log.H[u], Psi)
    l_10 = L[1, 0]
    l_20 = L[2, 0]
    l_21 = L[2, 1]
    i_0 = 1.0 / L[0, 0]
    i_1 = 1.0 / L[1, 1]
    i_2 = 1.0 / L[2, 2]
    z_0 = log.z[u, 0]
    z_1 = log.z[u, 1]
    z_2 = log.z[u, 2]
    for j in range(n):  # forward and back substitution
        w_0 = work[0, j] * i_0
        w_1 = (work[1, j] - l_10 * w_0) * i_1
        w_2 = (work[2, j] - l_20 * w_0 - l_21 * w_1) * i_2 * i_2
        w_1 = (w_1 - l_21 * w_2) * i_1
        w_0 = (w_0 - l_10 * w_1 - l_20 * w_2) * i_0
        work[3, j] = w_0
        work[4, j] = w_1
        work[5, j] = w_2
        mean[j] = mean[j] + z_0 * w_0 + z_1 * w_1 + z_2 * w_2
    for i in range(N):
        g_0 = work[0, i]
        g_1 = work[1, i]
        g_2 = work[2, i]
        k_0 = K[0, i]
        k_1 = K[1, i]
        k_2 = K[2, i]
        for j in range(N):
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
    entry = bl.first[b]
    while True:
        if u != NONE and bl.place[u] == entry:
            update = u
            rows = fs.VECTOR
            u = bl.next[u]
        elif entry == end:
            break
        else:
            e = entry % length
            entry += 1
            if log.kinds[e] == rings.STEP:
                Phi = past.transitions[log.numbers[e] % past.transitions.shape[0]]
                _build_step(Psi, Phi, bl.scratch)
                continue
            update = log.numbers[e] % log.H.shape[0]
            rows = log.rows[e]
        if rows == fs.SCALAR:
            _build_scalar(Psi, Lambda, mean, bl.scratch, log, update)
        else:
            _build_update(Psi, Lambda, mean, bl.scratch, log, update)
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
    s_0 = s_1 = s_2 = 0.0
    for k in range(N):
        mean = bl.means[b, 0, k]
        s_0 += bl.C[b, 0, k] * mean
        s_1 += bl.C[b, 1, k] * mean
        s_2 += bl.C[b, 2, k] * mean
    z[0] -= s_0
    z[1] -= s_1
    z[2] -= s_2
    for a in range(3):
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
    s_0 = s_1 = s_2 = 0.0
    for k in range(N):
        m_0 = bl.means[b, 0, k]
        m_1 = bl.means[b, 1, k]
        s_0 += D[0, k] * m_0 + Y[0, k] * m_1
        s_1 += D[1, k] * m_0 + Y[1, k] * m_1
        s_2 += D[2, k] * m_0 + Y[2, k] * m_1
    z[0] -= s_0
    z[1] -= s_1
    z[2] -= s_2
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
