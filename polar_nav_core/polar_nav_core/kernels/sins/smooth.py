"""Backward pass of a fixed-interval smoother over the linear steps and updates of a filter.

Modified Bryson-Frazier form (Bierman 1973): an adjoint lambda (24,) with its covariance Lambda
gathers, from the end backwards, what later innovations say of the error at a time. At a row with
the filter's covariance P the smoothed error is -P lambda, its covariance P - P Lambda P. No
covariance is inverted, so states without any uncertainty need no care; noise that was added to P
between two entries (a gate that opened, a gap) does not enter at all.

Common errors b shift innovations by J b (`consider`). The adjoint is linear in the innovations, so
a third part, (24, COLUMNS), is its change per unit of b. Equations: docs/derivations/smoother.md.
"""

from __future__ import annotations

from ...arrays import Array, Ints
from ..cache import entry, kernel, routine
from .consider import COLUMNS, add_common
from .model import MOVING
from .run import leave_out_leader
from .state import KEPT, NAVIGATION, STEP
from .three_rows import solve_rows
from .update import COUPLED, NAV, N, cholesky, feed_back

PHI = NAV * COUPLED + COUPLED
"""Numbers of a transition that are kept: its first nine rows, then its diagonal below them."""


@kernel
def _apply_step(phi: Array, model: Array, x: Array, out: Array) -> None:
    """Write Phi^T x for each row of x (k, n) into ``out``; Phi as `PHI` numbers, and ``model``.

    ``model``, (3, 31), has the first rows of the states of a vehicle's model, which are n - 24;
    those below them are constant.
    """
    n = x.shape[1]
    for r in range(x.shape[0]):
        for j in range(COUPLED):
            s = 0.0
            for i in range(NAV):
                s += phi[i * COUPLED + j] * x[r, i]
            out[r, j] = s
        for j in range(COUPLED, N):
            out[r, j] = 0.0
        for j in range(NAV, N):
            out[r, j] += phi[NAV * COUPLED + j - NAV] * x[r, j]
        if n > N:
            for j in range(N, n):
                out[r, j] = x[r, j] if j >= N + MOVING else 0.0
            for i in range(MOVING):
                for j in range(n):
                    out[r, j] += model[i, j] * x[r, N + i]


@kernel
def _copy(x: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            out[i, j] = x[i, j]


@kernel
def _transpose(x: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            out[j, i] = x[i, j]


@kernel
def step_back(adjoint: Array, information: Array, phi: Array, model: Array, w: Array) -> None:
    """Carry adjoint (1 + COLUMNS, n) and Lambda (n, n) to before a step; w (2, n, n) scratch.

    lambda <- Phi^T lambda, Lambda <- Phi^T Lambda Phi.
    """
    rows = adjoint.shape[0]
    _apply_step(phi, model, adjoint, w[0, :rows])
    _copy(w[0, :rows], adjoint)
    _apply_step(phi, model, information, w[0])
    _transpose(w[0], w[1])
    _apply_step(phi, model, w[1], w[0])
    for i in range(information.shape[0]):
        for j in range(i + 1):
            s = 0.5 * (w[0, i, j] + w[0, j, i])
            information[i, j] = s
            information[j, i] = s


@kernel
def _inverse(L: Array, m: int, out: Array) -> None:
    """Write (L L^T)^-1, first m rows and columns, into ``out`` (3, 3)."""
    for a in range(3):
        for b in range(3):
            out[a, b] = 1.0 if a == b else 0.0
    solve_rows(out, L, m)


@kernel
def measure_back(
    adjoint: Array,
    information: Array,
    K: Array,
    L: Array,
    z: Array,
    moved: Array,
    m: int,
    w: Array,
) -> None:
    """Fill what both kernels below need of a measurement of m rows into the scratch.

    S^-1 into w[1, :3], Lambda K into w[1, 12:15], and u = S^-1 z + K^T lambda into w[0], a row of
    it for lambda and for its change per unit of each common error.

    Parameters
    ----------
    adjoint : (1 + COLUMNS, n) or (1, n) array
        lambda after the measurement, and below it its change per unit of each common error, where
        there are any.
    information : (n, n) array
        Lambda.
    K : (3, n) array
        Transposed gain; of a measurement that was refused that which it would have had.
    L : (3, 3) array
        Cholesky factor of S.
    z, moved : (3,), (3, COLUMNS) arrays
        Innovation, and its change per unit of each common error.
    m : int
    w : (2, n, n) array
        Scratch.
    """
    n = adjoint.shape[1]
    weight, Y, u = w[1, :3, :3], w[1, 12:15], w[0, : 1 + COLUMNS, :3]
    _inverse(L, m, weight)
    for a in range(m):
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += information[i, j] * K[a, j]
            Y[a, i] = s
    for r in range(adjoint.shape[0]):
        for a in range(m):
            s = 0.0
            for i in range(n):
                s += K[a, i] * adjoint[r, i]
            for b in range(m):
                s += weight[a, b] * (z[b] if r == 0 else moved[b, r - 1])
            u[r, a] = s


@kernel
def update_back(adjoint: Array, information: Array, H: Array, K: Array, m: int, w: Array) -> None:
    """Carry adjoint and Lambda to before a fused measurement of m rows, after `measure_back`.

    lambda <- (I - K H)^T lambda - H^T S^-1 z, Lambda <- (I - K H)^T Lambda (I - K H) + H^T S^-1 H.

    Parameters
    ----------
    adjoint, information : (1 + COLUMNS, n), (n, n) arrays, in place
    H, K : (3, n) arrays
        Rows and transposed gain.
    m : int
    w : (2, n, n) array
        Scratch.
    """
    n = adjoint.shape[1]
    weight, Y, u = w[1, :3, :3], w[1, 12:15], w[0, : 1 + COLUMNS, :3]
    for r in range(adjoint.shape[0]):
        for a in range(m):
            for i in range(n):
                if H[a, i] != 0.0:
                    adjoint[r, i] -= H[a, i] * u[r, a]
    # With Y = Lambda K: Lambda - Y H - H^T Y^T + H^T (K^T Y + S^-1) H
    for a in range(m):
        for b in range(m):
            s = 0.0
            for i in range(n):
                s += K[a, i] * Y[b, i]
            weight[a, b] += s
    for a in range(m):
        for i in range(n):
            # Half of the last term on either side keeps Lambda symmetric.
            for b in range(m):
                Y[a, i] -= 0.5 * weight[a, b] * H[b, i]
    for a in range(m):
        for i in range(n):
            h = H[a, i]
            if h != 0.0:
                for j in range(n):
                    information[i, j] -= h * Y[a, j]
                for j in range(n):
                    information[j, i] -= h * Y[a, j]


@kernel
def leave_out(
    K: Array, L: Array, m: int, fused: bool, sigma: Array, residual: Array, V: Array, w: Array
) -> None:
    """Residual (3,) of a measurement to the track by all others, and its covariance V (3, 3).

    After `measure_back`. With A = K^T Lambda K: e = V u with V = (S^-1 + A)^-1 if it was fused,
    e = S u with V = S - S A S if not. Common errors, of 1-sigma ``sigma``, are added to V; it is
    zero where it could not be computed.

    Parameters
    ----------
    K, L, m, w : as in `measure_back`
    fused : bool
    sigma : (COLUMNS,) array
    residual, V : (3,), (3, 3) arrays, out
    """
    n = K.shape[1]
    weight, S, A, G = w[1, :3, :3], w[1, 3:6, :3], w[1, 6:9, :3], w[1, 9:12, :3]
    Y, u, e = w[1, 12:15], w[0, : 1 + COLUMNS, :3], w[1, 15]
    for a in range(3):
        residual[a] = 0.0
        for b in range(3):
            V[a, b] = 0.0
    for a in range(m):
        for b in range(m):
            s = 0.0
            for i in range(n):
                s += K[a, i] * Y[b, i]
            A[a, b] = s
            s = 0.0
            for k in range(min(a, b) + 1):
                s += L[a, k] * L[b, k]
            S[a, b] = s
    if fused:
        for a in range(m):
            for b in range(m):
                A[a, b] += weight[a, b]
        if not cholesky(G, A, m):
            return
        _inverse(G, m, S)  # now (S^-1 + A)^-1
        for a in range(m):
            for b in range(m):
                V[a, b] = S[a, b]
    else:
        for a in range(m):
            for b in range(m):
                s = S[a, b]
                for c in range(m):
                    for d in range(m):
                        s -= S[a, c] * A[c, d] * S[d, b]
                V[a, b] = s
    for r in range(1 + COLUMNS):
        if r > 0 and sigma[r - 1] == 0.0:
            continue
        for a in range(m):
            e[a] = 0.0
            for b in range(m):
                e[a] += S[a, b] * u[r, b]
        for a in range(m):
            if r == 0:
                residual[a] = e[a]
            else:
                for b in range(m):
                    V[a, b] += sigma[r - 1] * sigma[r - 1] * e[a] * e[b]


@kernel
def learn_common(J: Array, h: Array, L: Array, z: Array, moved: Array, m: int, w: Array) -> None:
    """J <- J + M^T S^-1 M, h <- h + M^T S^-1 z, M = ``moved``: what a measurement says of b."""
    weight = w[1, :3, :3]
    _inverse(L, m, weight)
    for a in range(m):
        for c in range(COLUMNS):
            s = 0.0
            for b in range(m):
                s += weight[a, b] * moved[b, c]
            w[0, a, c] = s
    for c in range(COLUMNS):
        for a in range(m):
            x = w[0, a, c]
            h[c] += x * z[a]
            for d in range(COLUMNS):
                J[c, d] += x * moved[a, d]


@kernel
def smooth_row(
    x: Array, P: Array, sensitivity: Array, adjoint: Array, information: Array, w: Array
) -> None:
    """Smoothed error x (n,) of a row; its covariance P and sensitivity change to the smoothed.

    x <- -P lambda, P <- P - P Lambda P, sensitivity <- sensitivity + P (change of lambda).

    Parameters
    ----------
    x : (n,) array, out
    P : (24, n) array, in place
        The filter's, without common errors.
    sensitivity : (24, COLUMNS) array, in place
    adjoint, information : (1 + COLUMNS, n), (24, n) arrays
    w : (2, 24, n) array
        Scratch.
    """
    n = adjoint.shape[1]
    for i in range(n):
        s = 0.0
        for j in range(n):
            s -= P[i, j] * adjoint[0, j]
        x[i] = s
        for c in range(adjoint.shape[0] - 1):
            s = 0.0
            for j in range(n):
                s += P[i, j] * adjoint[1 + c, j]
            sensitivity[i, c] += s
        for k in range(n):
            s = 0.0
            for j in range(n):
                s += P[i, j] * information[j, k]
            w[0, i, k] = s
    for i in range(n):
        for k in range(n):
            s = 0.0
            for j in range(n):
                s += w[0, i, j] * P[j, k]
            w[1, i, k] = s
    for i in range(n):
        for k in range(i + 1):
            s = P[i, k] - 0.5 * (w[1, i, k] + w[1, k, i])
            P[i, k] = s
            P[k, i] = s


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
    P: Array, sensitivity: Array, navigation: Array, sigma: Array, hidden: bool
) -> None:
    """Add the common errors to the covariances of rows; clear what is not published in them.

    Parameters
    ----------
    P, sensitivity, navigation : (k, 24, 24), (k, 24, COLUMNS), (k, 30) arrays
        In place, read, in place.
    sigma : (COLUMNS,) array
        Of the common errors.
    hidden : bool
        Whether the last three states are not published: errors of a leader, or of headings.
    """
    for k in range(P.shape[0]):
        add_common(P[k], sensitivity[k], sigma)
        if hidden:
            leave_out_leader(P[k], navigation[k])


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
    w: Array,
) -> None:
    """Run backwards over entries, and smooth the rows that lie between them.

    Parameters
    ----------
    kinds, indices : (n,) arrays
        STEP, UPDATE or KEPT, and the place of its numbers in ``phi``, or in ``H`` to ``sizes``.
    phi, model : (steps, PHI), (steps, 3, 31) arrays
        Transitions; n is 31 with a vehicle's model, else 24, and ``model`` has no rows.
    H, K, L, z, moved, sizes : (updates, ...) arrays
        Rows, gain, factor of S, innovation, its change per common error, number of rows.
    places : (k,) array
        Number of entries before each row, ascending.
    navigation : (k, 30) array, in place
        Leading values of the states, which become the smoothed ones.
    deviations : (k, n) array
        Estimated error of each row; not zero where the filter was held to a track.
    x, P, sensitivity : (k, n), (k, n, n), (k, n, COLUMNS) arrays
        Out, in place, in place: see `smooth_row`; x with the deviation, all that a row is off by.
    adjoint, information : (1 + COLUMNS, n), (n, n) arrays, in place
        At the end of the entries; afterwards before the first. Without common errors, (1, n).
    common : (COLUMNS, COLUMNS + 1) array, in place
        What the innovations say of the common errors: information matrix, and vector behind it.
    sigma : (COLUMNS,) array
        1-sigma of the common errors.
    residuals, V : (updates, 3), (updates, 3, 3) arrays, out
        Of each measurement, to the track by all others, and its covariance: see `leave_out`.
    w : (2, n, n) array
        Scratch.
    """
    row = places.shape[0] - 1
    for number in range(kinds.shape[0], -1, -1):
        while row >= 0 and places[row] >= number:
            smooth_row(x[row], P[row], sensitivity[row], adjoint, information, w)
            for i in range(x.shape[1]):
                x[row, i] += deviations[row, i]
            correct_row(navigation[row], x[row], w[1])
            row -= 1
        if number == 0:
            return
        i = indices[number - 1]
        if kinds[number - 1] == STEP:
            of_model = model[i] if model.shape[0] > 0 else w[0]
            step_back(adjoint, information, phi[i], of_model, w)
        else:
            m = sizes[i]
            kept = kinds[number - 1] == KEPT
            if not kept and adjoint.shape[0] > 1:
                learn_common(common[:, :COLUMNS], common[:, COLUMNS], L[i], z[i], moved[i], m, w)
            measure_back(adjoint, information, K[i], L[i], z[i], moved[i], m, w)
            leave_out(K[i], L[i], m, not kept, sigma, residuals[i], V[i], w)
            if not kept:
                update_back(adjoint, information, H[i], K[i], m, w)
