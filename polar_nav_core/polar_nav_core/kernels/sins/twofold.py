"""Adjoint covariance of a smoother in numbers of twice the length: where a wide P is narrowed.

P - P Lambda P loses all its digits where one measurement has narrowed P by so much that what is
left of it is the rounding of P Lambda P: a position known to a kilometre before a fix of half a
metre. There Lambda is carried as a sum of two numbers, ``high + low``, of 32 digits together
(Dekker 1971), and so is S^-1, in which a wide position stands beside a narrow one. The filter's
own numbers need no more digits than they have: what P, K and the factor of S were rounded by moves
the smoothed covariance by the rounding of P alone.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel, routine
from .adjoint import _DIAGONAL
from .model import MOVING
from .update import COUPLED, NAV, N

_SPLIT = 134217729.0
"""2^27 + 1: cuts a number into halves whose products are exact."""


@kernel
def add_scaled(high: Array, low: Array, d: float, x: Array, rest: Array) -> None:
    """(high + low) <- (high + low) + d (x + rest), along a row."""
    cut = _SPLIT * d
    d_1 = cut - (cut - d)
    d_2 = d - d_1
    for k in range(high.shape[0]):
        a = x[k]
        cut = _SPLIT * a
        a_1 = cut - (cut - a)
        a_2 = a - a_1
        p = d * a
        e = ((d_1 * a_1 - p) + d_1 * a_2 + d_2 * a_1) + d_2 * a_2 + d * rest[k]
        b = high[k]
        s = b + p
        v = s - b
        t = ((b - (s - v)) + (p - v)) + (low[k] + e)
        high[k] = s + t
        low[k] = t - (high[k] - s)


@kernel
def _clear(high: Array, low: Array) -> None:
    for k in range(high.shape[0]):
        high[k] = 0.0
        low[k] = 0.0


@kernel
def _step_columns(
    phi: Array, model: Array, high: Array, low: Array, out: Array, rest: Array
) -> None:
    """Out + rest = Phi^T (high + low), all (n, n); see `adjoint.step_back`."""
    n = high.shape[0]
    for j in range(n):
        _clear(out[j], rest[j])
        if j < COUPLED:
            for i in range(NAV):
                add_scaled(out[j], rest[j], phi[i * COUPLED + j], high[i], low[i])
        if NAV <= j < N:
            add_scaled(out[j], rest[j], phi[_DIAGONAL + j], high[j], low[j])
        elif j >= N + MOVING:
            add_scaled(out[j], rest[j], 1.0, high[j], low[j])
        if n > N:
            for i in range(MOVING):
                add_scaled(out[j], rest[j], model[i, j], high[N + i], low[N + i])


@kernel
def _mirror(high: Array, low: Array) -> None:
    """Copy what is below the diagonal to above it."""
    for i in range(high.shape[0]):
        for j in range(i):
            high[j, i] = high[i, j]
            low[j, i] = low[i, j]


@kernel
def _turn_over(A: Array) -> None:
    """A <- A^T."""
    for i in range(A.shape[0]):
        for j in range(i):
            A[i, j], A[j, i] = A[j, i], A[i, j]


@routine
def step_twofold(high: Array, low: Array, phi: Array, model: Array, w: Array) -> None:
    """Lambda <- Phi^T Lambda Phi, (n, n) in two parts; w (2, n, n) scratch."""
    _step_columns(phi, model, high, low, w[0], w[1])
    _turn_over(w[0])
    _turn_over(w[1])
    _step_columns(phi, model, w[0], w[1], high, low)
    _mirror(high, low)


@kernel
def _inverse_twofold(L: Array, m: int, W: Array, rest: Array, X: Array, X_rest: Array) -> None:
    """W + rest = (L L^T)^-1, first m rows and columns of (3, ...) arrays; X is scratch."""
    for a in range(m):
        _clear(W[a, :m], rest[a, :m])
        _clear(X[a, :m], X_rest[a, :m])
    for a in range(m):  # X = L^-1, row by row: L_aa X_a = e_a - sum L_ac X_c, with X_c above it
        X[a, a] = 1.0
        for c in range(a):
            add_scaled(X[a, :m], X_rest[a, :m], -L[a, c], X[c, :m], X_rest[c, :m])
        _divide(X[a, :m], X_rest[a, :m], L[a, a])
    for c in range(m):
        for a in range(m):
            add_scaled(W[a, :m], rest[a, :m], X[c, a], X[c, :m], X_rest[c, :m])
            add_scaled(W[a, :m], rest[a, :m], X_rest[c, a], X[c, :m], X_rest[c, :m])


@kernel
def _divide(high: Array, low: Array, d: float) -> None:
    """(high + low) <- (high + low) / d, along a row."""
    for k in range(high.shape[0]):
        q = high[k] / d
        at = slice(k, k + 1)
        before, rest = high[k], low[k]
        high[k], low[k] = -before, -rest
        _add_product(high[at], low[at], q, d)
        r = -(high[k] + low[k]) / d  # what q leaves
        high[k] = q + r
        low[k] = r - (high[k] - q)


@kernel
def _add_product(high: Array, low: Array, a: float, b: float) -> None:
    """(high + low) <- (high + low) + a b, of one number."""
    cut = _SPLIT * a
    a_1 = cut - (cut - a)
    a_2 = a - a_1
    cut = _SPLIT * b
    b_1 = cut - (cut - b)
    b_2 = b - b_1
    p = a * b
    e = ((a_1 * b_1 - p) + a_1 * b_2 + a_2 * b_1) + a_2 * b_2
    x = high[0]
    s = x + p
    v = s - x
    t = ((x - (s - v)) + (p - v)) + (low[0] + e)
    high[0] = s + t
    low[0] = t - (high[0] - s)


@routine
def update_twofold(
    high: Array, low: Array, H: Array, K: Array, L: Array, m: int, w: Array
) -> None:
    """Lambda <- (I - K H)^T Lambda (I - K H) + H^T S^-1 H, (n, n) in two parts.

    Parameters
    ----------
    high, low : (n, n) arrays, in place
    H, K : (3, n) arrays
        Rows, and the transposed gain.
    L : (3, 3) array
        Cholesky factor of S.
    m : int
    w : (2, n, n) array
        Scratch.
    """
    Y, Y_rest, B, B_rest, none = w[0, :3], w[1, :3], w[0, 3:6], w[1, 3:6], w[0, 6]
    for k in range(none.shape[0]):
        none[k] = 0.0
    for a in range(m):
        _clear(Y[a], Y_rest[a])
        for j in range(high.shape[0]):
            add_scaled(Y[a], Y_rest[a], K[a, j], high[j], low[j])
    # With Y = Lambda K: Lambda - Y H - H^T Y^T + H^T (K^T Y + S^-1) H; half of the last term on
    # either side keeps Lambda symmetric.
    _inverse_twofold(L, m, B, B_rest, w[0, 7:10], w[1, 7:10])
    for a in range(m):
        for b in range(m):
            for i in range(K.shape[1]):
                at = slice(b, b + 1)
                add_scaled(B[a, at], B_rest[a, at], K[a, i], Y[b, i : i + 1], Y_rest[b, i : i + 1])
    for a in range(m):
        for b in range(m):
            add_scaled(Y[a], Y_rest[a], -0.5 * B[a, b], H[b], none)
            add_scaled(Y[a], Y_rest[a], -0.5 * B_rest[a, b], H[b], none)
    for i in range(high.shape[0]):
        for a in range(m):
            add_scaled(high[i], low[i], -H[a, i], Y[a], Y_rest[a])
            add_scaled(high[i], low[i], -Y[a, i], H[a], none)
            add_scaled(high[i], low[i], -Y_rest[a, i], H[a], none)
    _mirror(high, low)


@routine
def smoothed_twofold(P: Array, high: Array, low: Array, w: Array) -> None:
    """P <- P - P Lambda P, (n, n), with Lambda in two parts; w (4, n, n) scratch."""
    n = P.shape[0]
    none = w[3, 0]
    for i in range(n):
        _clear(w[0, i], w[1, i])
        for j in range(n):
            add_scaled(w[0, i], w[1, i], P[i, j], high[j], low[j])
    for k in range(n):
        none[k] = 0.0
    for i in range(n):
        out, rest = w[2, i], w[3, 1]
        for k in range(n):
            out[k], rest[k] = P[i, k], 0.0
        for j in range(n):
            add_scaled(out, rest, -w[0, i, j], P[j], none)
            add_scaled(out, rest, -w[1, i, j], P[j], none)
    for i in range(n):
        for k in range(i + 1):
            P[i, k] = P[k, i] = 0.5 * (w[2, i, k] + w[2, k, i])
