"""Each measurement beside the track of all others: its residual, and what it says of errors.

Equations: docs/derivations/smoother.md.
"""

from __future__ import annotations

import math

from ...arrays import Array, Ints
from ..cache import entry, kernel, routine
from .adjoint import inverse
from .consider import COLUMNS
from .update import cholesky, nis_of


@kernel
def leave_out(
    L: Array, m: int, fused: bool, sigma: Array, residual: Array, V: Array, w: Array
) -> None:
    """Residual (3,) of a measurement to the track by all others, and its covariance V (3, 3).

    After `measure_back`. With A = K^T Lambda K: e = V u with V = (S^-1 + A)^-1 if it was fused,
    e = S u with V = S - S A S if not. Common errors, of 1-sigma ``sigma``, are added to V; it is
    zero where it could not be computed.

    Parameters
    ----------
    L, m, w : as in `measure_back`
    fused : bool
    sigma : (COLUMNS,) array
    residual, V : (3,), (3, 3) arrays, out
    """
    weight, S, A, G = w[1, :3], w[1, 3:6], w[1, 6:9], w[1, 9:12]
    B, u, e = w[1, 16:19], w[0, :3], w[1, 15]
    for a in range(3):
        residual[a] = 0.0
        for b in range(3):
            V[a, b] = 0.0
    if fused:
        for a in range(m):
            for b in range(m):
                B[a, b] = A[a, b] + weight[a, b]
        if not cholesky(G, B, m):
            return
        inverse(G, m, S[:, :3])  # now (S^-1 + A)^-1
        for a in range(m):
            for b in range(m):
                V[a, b] = S[a, b]
    else:
        for a in range(m):
            for b in range(m):
                s = 0.0
                for k in range(min(a, b) + 1):
                    s += L[a, k] * L[b, k]
                S[a, b] = s
        for a in range(m):
            for b in range(m):
                s = S[a, b]
                for c in range(m):
                    for d in range(m):
                        s -= S[a, c] * A[c, d] * S[d, b]
                V[a, b] = s
    for a in range(m):
        for b in range(m):
            residual[a] += S[a, b] * u[b, 0]
    for r in range(COLUMNS):
        if sigma[r] == 0.0:
            continue
        for a in range(m):
            e[a] = 0.0
            for b in range(m):
                e[a] += S[a, b] * u[b, 1 + r]
        for a in range(m):
            for b in range(m):
                V[a, b] += sigma[r] * sigma[r] * e[a] * e[b]


@kernel
def learn_common(J: Array, h: Array, L: Array, z: Array, moved: Array, m: int, w: Array) -> None:
    """J <- J + M^T S^-1 M, h <- h + M^T S^-1 z, M = ``moved``: what a measurement says of b."""
    weight, X = w[1, :3, :3], w[0, :3, :COLUMNS]
    inverse(L, m, weight)
    for a in range(m):
        for c in range(X.shape[1]):
            X[a, c] = 0.0
        for b in range(m):
            s = weight[a, b]
            for c in range(X.shape[1]):
                X[a, c] += s * moved[b, c]
        s = z[a]
        for c in range(X.shape[1]):
            h[c] += X[a, c] * s
    for c in range(COLUMNS):
        for a in range(m):
            x = X[a, c]
            if x != 0.0:
                for d in range(J.shape[1]):
                    J[c, d] += x * moved[a, d]


@entry
@routine
def normalize(residuals: Array, V: Array, sizes: Ints, nis: Array, w: Array) -> None:
    """Normalized squares (n,) of residuals, each of its first rows.

    NaN where the covariance is not positive definite.

    Parameters
    ----------
    residuals, V, sizes : (n, 3), (n, 3, 3), (n,) arrays
        As of `leave_out`, and numbers of rows.
    nis : (n,) array, out
    w : (4, 3) array
        Scratch.
    """
    for k in range(sizes.shape[0]):
        m = sizes[k]
        nis[k] = nis_of(w[:3], residuals[k], w[3], m) if cholesky(w[:3], V[k], m) else math.nan
