"""A past position carried through the stored steps (docs/derivations/late_fixes.md, 3).

The clone is c = H_c x(s), three combinations of the error at a past time s. Carried are
C = cov(x, c), shape (24, 3), P_cc = cov(c), shape (3, 3), and the innovation of its late
measurement, which every later measurement moves because it moves the estimate of c.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .update import COUPLED, NAV, N, subtract


@kernel
def clone_begin(C: Array, P_cc: Array, P: Array, H: Array) -> None:
    """C = P H^T and P_cc = H P H^T at the time of validity."""
    for i in range(N):
        for a in range(3):
            s = 0.0
            for k in range(N):
                s += P[i, k] * H[a, k]
            C[i, a] = s
    for a in range(3):
        for b in range(a + 1):
            s = 0.0
            for k in range(N):
                s += H[a, k] * C[k, b]
            P_cc[a, b] = s
            P_cc[b, a] = s


@kernel
def clone_step(C: Array, Phi: Array, work: Array) -> None:
    """C <- Phi C; work is (9, 3) scratch."""
    for i in range(NAV):
        s_0 = 0.0
        s_1 = 0.0
        s_2 = 0.0
        for k in range(COUPLED):
            f = Phi[i, k]
            s_0 += f * C[k, 0]
            s_1 += f * C[k, 1]
            s_2 += f * C[k, 2]
        work[i, 0] = s_0
        work[i, 1] = s_1
        work[i, 2] = s_2
    for i in range(NAV):
        for a in range(3):
            C[i, a] = work[i, a]
    for i in range(NAV, N):
        for a in range(3):
            C[i, a] *= Phi[i, i]


@kernel
def clone_measurement(
    C: Array, P_cc: Array, z: Array, H: Array, L: Array, K: Array, z_m: Array, m: int, work: Array
) -> None:
    """Pass a fused measurement: what it said of x it said of the clone, too.

    With G = H C and K_c = G^T S^-1: z <- z - K_c z_m, P_cc <- P_cc - K_c S K_c^T, C <- C - K G.

    Parameters
    ----------
    C, P_cc, z : the clone, in place
    H, L, K, z_m : rows (m, 24), Cholesky factor of S, gain (3, 24) and innovation as fused
    m : rows
    work : (6, 3) scratch
    """
    for a in range(m):  # G in rows 0..2, L^-1 G in rows 3..5
        g_0 = 0.0
        g_1 = 0.0
        g_2 = 0.0
        for k in range(N):
            h = H[a, k]
            if h != 0.0:
                g_0 += h * C[k, 0]
                g_1 += h * C[k, 1]
                g_2 += h * C[k, 2]
        work[a, 0] = g_0
        work[a, 1] = g_1
        work[a, 2] = g_2
    for a in range(m):
        inverse = 1.0 / L[a, a]
        for c in range(3):
            s = work[a, c]
            for b in range(a):
                s -= L[a, b] * work[3 + b, c]
            work[3 + a, c] = s * inverse
    for c in range(3):
        for d in range(c + 1):
            s = P_cc[c, d]
            for a in range(m):
                s -= work[3 + a, c] * work[3 + a, d]
            P_cc[c, d] = s
            P_cc[d, c] = s
    _move_innovation(z, L, work, z_m, m)
    for a in range(m):
        g_0 = work[a, 0]
        g_1 = work[a, 1]
        g_2 = work[a, 2]
        for i in range(N):
            k = K[a, i]
            C[i, 0] -= k * g_0
            C[i, 1] -= k * g_1
            C[i, 2] -= k * g_2


@kernel
def _move_innovation(z: Array, L: Array, work: Array, z_m: Array, m: int) -> None:
    """Z <- z - (L^-1 G)^T (L^-1 z_m)."""
    y_0 = z_m[0] / L[0, 0]
    y_1 = 0.0
    y_2 = 0.0
    if m > 1:
        y_1 = (z_m[1] - L[1, 0] * y_0) / L[1, 1]
    if m > 2:
        y_2 = (z_m[2] - L[2, 0] * y_0 - L[2, 1] * y_1) / L[2, 2]
    for c in range(3):
        s = z[c] - work[3, c] * y_0
        if m > 1:
            s -= work[4, c] * y_1
        if m > 2:
            s -= work[5, c] * y_2
        z[c] = s


@kernel
def clone_fuse(
    P: Array, x: Array, C: Array, P_cc: Array, R: Array, L: Array, z: Array, K: Array, D: Array
) -> None:
    """Update the present by a measurement of the clone; x <- K z with K = C S^-1, S = P_cc + R.

    P <- P - K D^T - D K^T with D = C - K S/2: second order in an error of the gain, as Joseph's.

    Parameters
    ----------
    P : (24, 24), in place
    x : (24,), out
    C, P_cc, R : (24, 3), (3, 3), (3, 3)
    L : (3, 3) Cholesky factor of S
    z : (3,)
    K, D : (3, 24) out, scratch
    """
    for i in range(N):
        for a in range(3):
            s = C[i, a]
            for b in range(a):
                s -= L[a, b] * K[b, i]
            K[a, i] = s / L[a, a]
        for n in range(3):
            a = 2 - n
            s = K[a, i]
            for b in range(a + 1, 3):
                s -= L[b, a] * K[b, i]
            K[a, i] = s / L[a, a]
        s = 0.0
        for a in range(3):
            s += K[a, i] * z[a]
        x[i] = s
        for a in range(3):
            s = C[i, a]
            for b in range(3):
                s -= 0.5 * (P_cc[a, b] + R[a, b]) * K[b, i]
            D[a, i] = s
    subtract(P, K, D, K, D)


@kernel
def drop_information(P: Array, K: Array, S: Array, m: int) -> None:
    """P <- P - K^T S K: the covariance after an update whose gain and S are stored."""
    for i in range(N):
        for b in range(m):
            g = 0.0
            for a in range(m):
                g += K[a, i] * S[a, b]
            for j in range(i + 1):
                P[i, j] -= g * K[b, j]
        for j in range(i):
            P[j, i] = P[i, j]
