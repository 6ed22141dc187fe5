"""Backward pass of a fixed-interval smoother over the linear steps and updates of a filter.

Modified Bryson-Frazier form (Bierman 1973): an adjoint lambda (24,) with its covariance Lambda
gathers, from the end backwards, what later innovations say of the error at a time (`adjoint`). At
a row with the filter's covariance P the smoothed error is -P lambda, its covariance
P - P Lambda P. No covariance is inverted, so states without any uncertainty need no care; noise
that was added to P between two entries (a gate that opened, a gap) does not enter at all.

Common errors b shift innovations by J b (`consider`). The adjoint is linear in the innovations, so
a third part, (24, COLUMNS), is its change per unit of b. Where the position is known to so little
that P - P Lambda P would be rounding, Lambda is carried in two parts (`twofold`). Equations:
docs/derivations/smoother.md.
"""

from __future__ import annotations

from ...arrays import Array, Ints
from ..cache import entry, kernel, routine
from .adjoint import (
    adjoint_before_step,
    adjoint_before_update,
    information_before_update,
    measure_back,
    step_back,
)
from .consider import COLUMNS, add_common
from .hidden import leave_out_leader
from .left_out import learn_common, leave_out
from .rings import KEPT, STEP
from .state import NAVIGATION
from .twofold import smoothed_twofold, step_twofold, update_twofold
from .update import DR, feed_back

_ROUNDING = 2.3e-16
"""Relative rounding of a number."""
_DEPTHS = 1e5
"""Trace of Lambda that depths alone may add up to, before the next row [1/m^2]."""
_LOSS = 1e-4
"""Share of a smoothed variance of position that may be rounding of P Lambda P."""


@kernel
def _multiply(out: Array, A: Array, B: Array) -> None:
    """Write A B, all (n, n), into ``out``; eight products at a time."""
    n = A.shape[0]
    for i in range(n):
        for k in range(n):
            out[i, k] = 0.0
        j = 0
        while j + 8 <= n:
            # As numbers: in an array they would be read again, for `out` might lie before it.
            a_0, a_1, a_2, a_3 = A[i, j], A[i, j + 1], A[i, j + 2], A[i, j + 3]
            a_4, a_5, a_6, a_7 = A[i, j + 4], A[i, j + 5], A[i, j + 6], A[i, j + 7]
            for k in range(n):
                out[i, k] += (
                    a_0 * B[j, k] + a_1 * B[j + 1, k] + a_2 * B[j + 2, k] + a_3 * B[j + 3, k]
                    + a_4 * B[j + 4, k] + a_5 * B[j + 5, k] + a_6 * B[j + 6, k]
                    + a_7 * B[j + 7, k]
                )  # fmt: skip
            j += 8
        for r in range(j, n):
            for k in range(n):
                out[i, k] += A[i, r] * B[r, k]


@kernel
def trace_of_position(A: Array) -> float:
    """Sum of the three values on the diagonal of a square array that belong to the position."""
    s: float = A[DR, DR] + A[DR + 1, DR + 1] + A[DR + 2, DR + 2]
    return s


@kernel
def loses_digits(before: float, P: Array, information: Array) -> bool:
    """Whether P - P Lambda P of the row before would be rounding.

    Lambda is rounded in earth axes, of its depths that are known best, too; between this row and
    the one before it shrinks with what narrows P, and that rounding does not.

    Parameters
    ----------
    before : float
        Trace of the position's covariance in the row before [m^2].
    P, information : (n, n) arrays
        Smoothed covariance of this row, and Lambda there.
    """
    known = max(_DEPTHS, trace_of_position(information))
    return bool(_ROUNDING * known * before * before > _LOSS * trace_of_position(P))


@kernel
def smooth_row(
    x: Array,
    P: Array,
    sensitivity: Array,
    adjoint: Array,
    information: Array,
    low: Array,
    wide: bool,
    w: Array,
) -> None:
    """Smoothed error x (n,) of a row; its covariance P and sensitivity change to the smoothed.

    x <- -P lambda, P <- P - P Lambda P, sensitivity <- sensitivity + P (change of lambda).

    Parameters
    ----------
    x : (n,) array, out
    P : (n, n) array, in place
        The filter's, without common errors.
    sensitivity : (n, COLUMNS) array, in place
    adjoint, information : (n, 1 + COLUMNS), (n, n) arrays
    low : (n, n) array
        What is added to ``information`` where that is ``wide``.
    wide : bool
    w : (6, n, n) array
        Scratch.
    """
    n, columns = adjoint.shape
    for i in range(n):
        s = 0.0
        for j in range(n):
            s -= P[i, j] * adjoint[j, 0]
        x[i] = s
        if columns > 1:
            for j in range(n):
                s = P[i, j]
                for c in range(1, columns):
                    sensitivity[i, c - 1] += s * adjoint[j, c]
    for i in range(n):
        w[5, 0, i] = P[i, i]
    if wide:
        smoothed_twofold(P, information, low, w)
    else:
        _multiply(w[0], P, information)
        _multiply(w[1], w[0], P)
        for i in range(n):
            for k in range(i + 1):
                s = P[i, k] - 0.5 * (w[1, i, k] + w[1, k, i])
                P[i, k] = s
                P[k, i] = s
    for i in range(n):
        least = _ROUNDING * w[5, 0, i]  # less is rounding, and may be below zero
        if P[i, i] < least:
            P[i, i] = least


@kernel
def correct_row(row: Array, x: Array, C: Array) -> None:
    """Correct the leading values of a state, (30,) in place, by a smoothed error; C is scratch."""
    for i in range(3):
        for j in range(3):
            C[i, j] = row[3 * i + j]
    feed_back(
        x,
        C,
        row[9:12],
        row[12:15],
        row[15:18],
        row[18:21],
        row[21:24],
        row[24:27],
        row[27:NAVIGATION],
    )
    for i in range(3):
        for j in range(3):
            row[3 * i + j] = C[i, j]


@entry
@routine
def publish_rows(
    P: Array, sensitivity: Array, navigation: Array, sigma: Array, columns: Array, hidden: bool
) -> None:
    """Add the common errors to the covariances of rows; clear what is not published in them.

    Parameters
    ----------
    P, sensitivity, navigation : (k, 24, 24), (k, 24, COLUMNS), (k, 30) arrays
        In place, read, in place.
    sigma : (COLUMNS,) array
        Of the common errors.
    columns : (COLUMNS, 24) scratch
    hidden : bool
        Whether the last three states are not published: errors of a leader, or of headings.
    """
    for k in range(P.shape[0]):
        add_common(P[k], sensitivity[k], sigma, columns)
        if hidden:
            leave_out_leader(P[k], navigation[k])


@kernel
def turn_twofold(on: bool, low: Array, wide: Ints) -> None:
    """Begin or end to carry Lambda in two parts."""
    if on and wide[0] == 0:
        for i in range(low.shape[0]):
            for j in range(low.shape[1]):
                low[i, j] = 0.0
    wide[0] = 1 if on else 0


@kernel
def _take_rows(out: Array, rows: Array, begin: int, m: int) -> None:
    """Copy m rows of an update, and zeros below them, to ``out`` (3, n)."""
    for a in range(m):
        for i in range(out.shape[1]):
            out[a, i] = rows[begin + a, i]
    for a in range(m, 3):
        for i in range(out.shape[1]):
            out[a, i] = 0.0


@entry
@routine
def smooth_back(
    kinds: Ints,
    indices: Ints,
    phi: Array,
    model: Array,
    H: Array,
    K: Array,
    L: Array,
    z: Array,
    moved: Array,
    sizes: Ints,
    places: Ints,
    navigation: Array,
    deviations: Array,
    x: Array,
    P: Array,
    sensitivity: Array,
    adjoint: Array,
    information: Array,
    common: Array,
    sigma: Array,
    residuals: Array,
    V: Array,
    before: float,
    low: Array,
    wide: Ints,
    w: Array,
) -> None:
    """Run backwards over entries, and smooth the rows that lie between them.

    Parameters
    ----------
    kinds, indices : (n,) arrays
        STEP, UPDATE or KEPT, and the place of its numbers in ``phi``, or in ``L`` to ``sizes``.
    phi, model : (steps, PHI), (steps, 3, 31) arrays
        Transitions; n is 31 with a vehicle's model, else 24, and ``model`` has no rows.
    H, K : (rows, n) arrays
        Rows of all updates, and their gains.
    L, z, moved, sizes : (updates, ...) arrays
        Factor of S, innovation, its change per common error, number of rows.
    places : (k,) array
        Number of entries before each row, ascending.
    navigation : (k, 30) array, in place
        Leading values of the states, which become the smoothed ones.
    deviations : (k, n) array
        Estimated error of each row; not zero where the filter was held to a track.
    x, P, sensitivity : (k, n), (k, n, n), (k, n, COLUMNS) arrays
        Out, in place, in place: see `smooth_row`; x with the deviation, all that a row is off by.
    adjoint, information : (n, 1 + COLUMNS), (n, n) arrays, in place
        At the end of the entries; afterwards before the first. Without common errors, (n, 1).
    common : (COLUMNS, COLUMNS + 1) array, in place
        What the innovations say of the common errors: information matrix, and vector behind it.
    sigma : (COLUMNS,) array
        1-sigma of the common errors.
    residuals, V : (updates, 3), (updates, 3, 3) arrays, out
        Of each measurement, to the track by all others, and its covariance: see `leave_out`.
    before : float
        Trace of the position's covariance in the last row before these entries, or zero [m^2].
    low, wide : (n, n), (1,) arrays, in place
        What is added to ``information`` where ``wide`` is 1.
    w : (6, n, n) array
        Scratch.
    """
    row, end = places.shape[0] - 1, H.shape[0]
    for number in range(kinds.shape[0], -1, -1):
        while row >= 0 and places[row] >= number:
            smooth_row(
                x[row], P[row], sensitivity[row], adjoint, information, low, wide[0] == 1, w
            )
            for i in range(x.shape[1]):
                x[row, i] += deviations[row, i]
            correct_row(navigation[row], x[row], w[1])
            next_trace = trace_of_position(P[row - 1]) if row > 0 else before
            turn_twofold(loses_digits(next_trace, P[row], information), low, wide)
            row -= 1
        if number == 0:
            return
        i = indices[number - 1]
        if kinds[number - 1] == STEP:
            of_model = model[i] if model.shape[0] > 0 else w[0]
            if wide[0] == 1:
                adjoint_before_step(adjoint, phi[i], of_model, w)
                step_twofold(information, low, phi[i], of_model, w[2:4])
            else:
                step_back(adjoint, information, phi[i], of_model, w)
        else:
            m = sizes[i]
            kept = kinds[number - 1] == KEPT
            if not kept and adjoint.shape[1] > 1:
                learn_common(common[:, :COLUMNS], common[:, COLUMNS], L[i], z[i], moved[i], m, w)
            end -= m
            _take_rows(w[0, 3:6], H, end, m)
            _take_rows(w[0, 6:9], K, end, m)
            measure_back(adjoint, information, w[0, 6:9], L[i], z[i], moved[i], m, w)
            leave_out(L[i], m, not kept, sigma, residuals[i], V[i], w)
            if not kept:
                adjoint_before_update(adjoint, w[0, 3:6], m, w)
                if wide[0] == 1:
                    update_twofold(information, low, w[0, 3:6], w[0, 6:9], L[i], m, w[2:4])
                else:
                    information_before_update(information, w[0, 3:6], m, w)
