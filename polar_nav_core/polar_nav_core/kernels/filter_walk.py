"""The way of a late measurement to now: H Phi^-1 (docs/derivations/late_fixes.md)."""

from __future__ import annotations

from ..arrays import Array
from .cache import kernel
from .filter import COUPLED, MARKOV, NAV, Ints, N

INVERSE = (NAV + 1, COUPLED + 1)
"""Shape of what is kept of an inverted transition: see `invert`."""
KEPT = (NAV, COUPLED)
"""Where it says that it is that of the transition in its place: 1.0."""


@kernel
def invert(Phi: Array, inverse: Array, LU: Array) -> None:
    """What X Phi^-1 takes, by the block structure of Phi.

    With Phi = [[A, B], [0, D]]: X1' = X1 A^-1 and X2' = (X2 - X1' B) / D, D being one up to MARKOV
    and B zero from COUPLED on. Rows 0..8 of the result are [A^-1, -A^-1 B], by elimination with
    partial pivoting; the last row holds 1/D from MARKOV on.

    Parameters
    ----------
    Phi : (24, 24)
    inverse : (10, 16), out; the last column is zero but for `KEPT`
    LU : (9, 9) scratch
    """
    width = inverse.shape[1]
    for i in range(NAV):
        for j in range(NAV):
            LU[i, j] = Phi[i, j]
            inverse[i, j] = 0.0
        for j in range(NAV, COUPLED):
            inverse[i, j] = -Phi[i, j]
        inverse[i, i] = 1.0
        inverse[i, COUPLED] = 0.0
    for c in range(NAV):
        p = c
        for i in range(c + 1, NAV):
            if abs(LU[i, c]) > abs(LU[p, c]):
                p = i
        if p != c:
            for j in range(NAV):
                swap = LU[c, j]
                LU[c, j] = LU[p, j]
                LU[p, j] = swap
            for j in range(width):
                swap = inverse[c, j]
                inverse[c, j] = inverse[p, j]
                inverse[p, j] = swap
        for i in range(c + 1, NAV):
            f = LU[i, c] / LU[c, c]
            for j in range(c + 1, NAV):
                LU[i, j] -= f * LU[c, j]
            for j in range(width):
                inverse[i, j] -= f * inverse[c, j]
    for n in range(NAV):
        c = NAV - 1 - n
        f = 1.0 / LU[c, c]
        for j in range(width):
            inverse[c, j] *= f
        for i in range(c):
            f = LU[i, c]
            for j in range(width):
                inverse[i, j] -= f * inverse[c, j]
    for k in range(MARKOV, N):
        inverse[NAV, k - MARKOV] = 1.0 / Phi[k, k]
    inverse[KEPT] = 1.0


@kernel
def rows_times(X: Array, inverse: Array, m: int) -> None:
    """X <- X Phi^-1 for m rows of (3, 24), in place; ``inverse`` is of `invert`."""
    width = inverse.shape[1]
    for a in range(m):
        x_0 = X[a, 0]
        x_1 = X[a, 1]
        x_2 = X[a, 2]
        x_3 = X[a, 3]
        x_4 = X[a, 4]
        x_5 = X[a, 5]
        x_6 = X[a, 6]
        x_7 = X[a, 7]
        x_8 = X[a, 8]
        for j in range(NAV):
            X[a, j] = 0.0
        for j in range(width):
            X[a, j] += (
                x_0 * inverse[0, j] + x_1 * inverse[1, j] + x_2 * inverse[2, j]
                + x_3 * inverse[3, j] + x_4 * inverse[4, j] + x_5 * inverse[5, j]
                + x_6 * inverse[6, j] + x_7 * inverse[7, j] + x_8 * inverse[8, j]
            )  # fmt: skip
        for k in range(MARKOV, N):
            X[a, k] *= inverse[NAV, k - MARKOV]


@kernel
def walk_forward(
    X: Array,
    z: Array,
    m: int,
    Phis: Array,
    inverses: Array,
    first: int,
    last: int,
    corrections: Array,
    correction_steps: Ints,
    begin: int,
    end: int,
    LU: Array,
) -> None:
    """Bring rows and innovation of a late measurement from its own time to now.

    The rows become H Phi(k, s)^-1 and the innovation is referred to the estimate as it is now:
    each correction c that the filter fed back since then moved the past estimate by the rows of
    that step times c (closed loop: z <- z - X c).

    Parameters
    ----------
    X : (3, 24) array, in place: H at the time of validity; rows from m on count for nothing
    z : (3,) array, in place
    m : rows
    Phis : (n, 24, 24) ring; step j leads from boundary j - 1 to boundary j and stands at j % n
    inverses : (n, 10, 16) ring, in place: of each step when a walk first comes by
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
            place = i % c
            s_0 = 0.0
            s_1 = 0.0
            s_2 = 0.0
            for k in range(N):
                x = corrections[place, k]
                s_0 += X[0, k] * x
                s_1 += X[1, k] * x
                s_2 += X[2, k] * x
            z[0] -= s_0
            z[1] -= s_1
            z[2] -= s_2
            i += 1
        if step >= last:
            break
        step += 1
        place = step % n
        if inverses[place][KEPT] != 1.0:
            invert(Phis[place], inverses[place], LU)
        rows_times(X, inverses[place], m)
