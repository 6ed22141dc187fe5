"""The way of a late measurement to now: H Phi^-1 through the stored steps (polar-math 6.2)."""

from __future__ import annotations

from ..arrays import Array
from .cache import kernel
from .filter import NAV, Ints, N


@kernel
def rows_times_inverse(X: Array, Phi: Array, m: int, LU: Array, pivot: Ints) -> None:
    """X <- X Phi^-1 for m rows, by the block structure of Phi.

    With Phi = [[A, B], [0, D]]: X1 A = H1 and X2 = (H2 - X1 B) / D. A (9 x 9) is factored with
    partial pivoting.

    Parameters
    ----------
    X : (3, 24) array, in place
    Phi : (24, 24)
    LU : (9, 9) scratch
    pivot : (9,) int64 scratch
    """
    for i in range(NAV):  # factor A^T, because X1 A = H1 means A^T X1^T = H1^T
        for j in range(NAV):
            LU[i, j] = Phi[j, i]
    for c in range(NAV):
        p = c
        for i in range(c + 1, NAV):
            if abs(LU[i, c]) > abs(LU[p, c]):
                p = i
        pivot[c] = p
        if p != c:
            for j in range(NAV):
                swap = LU[c, j]
                LU[c, j] = LU[p, j]
                LU[p, j] = swap
        for i in range(c + 1, NAV):
            LU[i, c] /= LU[c, c]
            for j in range(c + 1, NAV):
                LU[i, j] -= LU[i, c] * LU[c, j]
    for a in range(m):
        for c in range(NAV):
            p = pivot[c]
            if p != c:
                swap = X[a, c]
                X[a, c] = X[a, p]
                X[a, p] = swap
        for i in range(NAV):
            for j in range(i):
                X[a, i] -= LU[i, j] * X[a, j]
        for c in range(NAV):
            i = NAV - 1 - c
            for j in range(i + 1, NAV):
                X[a, i] -= LU[i, j] * X[a, j]
            X[a, i] /= LU[i, i]
        for j in range(NAV, N):
            s = X[a, j]
            for i in range(NAV):
                s -= X[a, i] * Phi[i, j]
            X[a, j] = s / Phi[j, j]


@kernel
def walk_forward(
    X: Array,
    z: Array,
    m: int,
    Phis: Array,
    first: int,
    last: int,
    corrections: Array,
    correction_steps: Ints,
    begin: int,
    end: int,
    LU: Array,
    pivot: Ints,
) -> None:
    """Bring rows and innovation of a late measurement from its own time to now.

    The rows become H Phi(k, s)^-1 and the innovation is referred to the estimate as it is now:
    each correction c that the filter fed back since then moved the past estimate by the rows of
    that step times c (closed loop of polar-math 6.2: Z_m <- Z_m - G_m c).

    Parameters
    ----------
    X : (3, 24) array, in place: H at the time of validity
    z : (3,) array, in place
    Phis : (n, 24, 24) ring; step j leads from boundary j - 1 to boundary j and stands at j % n
    first, last : boundary of validity and boundary of now
    corrections : (c, 24) ring of fed-back corrections
    correction_steps : (c,) boundary after which each was applied
    begin, end : corrections that came after the measurement's epoch; number i stands at i % c
    """
    n = Phis.shape[0]
    c = corrections.shape[0]
    i = begin
    step = first
    while True:
        while i < end and correction_steps[i % c] <= step:
            for a in range(m):
                s = 0.0
                for k in range(N):
                    s += X[a, k] * corrections[i % c, k]
                z[a] -= s
            i += 1
        if step >= last:
            break
        step += 1
        rows_times_inverse(X, Phis[step % n], m, LU, pivot)
