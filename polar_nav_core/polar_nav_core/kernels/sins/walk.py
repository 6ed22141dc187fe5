"""Rows of a late measurement referred to now: H Phi^-1 (docs/derivations/late_fixes.md)."""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel
from .update import MARKOV, NAV, Ints, N, leading_nine


@kernel
def rows_times(X: Array, inverse: Array, m: int) -> None:
    """X <- X Phi^-1 for m rows of (3, 24), in place.

    With Phi = [[A, B], [0, D]]: X1' = X1 A^-1 and X2' = (X2 - X1' B) / D, D being one up to MARKOV
    and B zero from COUPLED on. ``inverse`` holds [A^-1, -A^-1 B] and 1/D (`fill_transition`).
    """
    width = inverse.shape[1]
    for a in range(m):
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(X[a])
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


@entry
@kernel
def walk_forward(
    X: Array,
    z: Array,
    m: int,
    inverses: Array,
    first: int,
    last: int,
    corrections: Array,
    correction_steps: Ints,
    begin: int,
    end: int,
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
    inverses : (n, 10, 16) ring of inverted transitions; step j leads from boundary j - 1 to
        boundary j and stands at j % n
    first, last : boundary of validity and boundary of now
    corrections : (c, 24) ring of fed-back corrections
    correction_steps : (c,) boundary after which each was applied
    begin, end : corrections that came after the measurement's epoch; number i stands at i % c
    """
    n = inverses.shape[0]
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
        rows_times(X, inverses[step % n], m)
