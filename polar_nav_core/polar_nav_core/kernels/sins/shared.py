"""What innovations show of the common errors: residuals that are independent again.

In a world as stated an innovation is z = nu + J b: nu, the innovation of the same filter in a
world without the common errors b, is white with the covariance S, and J (`consider`) is known. So
b is estimated from all innovations by a filter of its own, b in units of its stated sigmas with
the prior N(0, I). Its residuals z - J b^ are white with the covariance S + J Pi J^T: means,
cumulative sums and NIS of them have the statistics of independent numbers (`watch`), however large
b is within its sigmas. b^ itself has the covariance E = I - Pi: a b^ far beyond it is a
common error larger than stated. Derivation: docs/derivations/common_errors.md.

`State.shared` (COLUMNS + 1, COLUMNS) holds b^ in row 0 and E in the others: zeros know nothing.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from .consider import COLUMNS
from .update import cholesky, nis_of

TAU_S = 86400.0
"""Correlation time of the common errors [s]: zeros and mountings change from day to day."""


@kernel
def forget(shared: Array, dt: float) -> None:
    """Bring what is known of b on by dt [s]: b^ <- f b^, E <- f^2 E with f = exp(-dt / TAU_S)."""
    f = math.exp(-dt / TAU_S)
    square = f * f
    for c in range(shared.shape[1]):
        shared[0, c] *= f
    for d in range(1, shared.shape[0]):
        for c in range(shared.shape[1]):
            shared[d, c] *= square


@kernel
def residual(
    e: Array,
    V: Array,
    shared: Array,
    J: Array,
    sigma: Array,
    z: Array,
    wide: Array,
    M: Array,
    m: int,
) -> None:
    """Residual e = z - J b^ of an innovation, and its covariance V = wide - J E J^T, m rows.

    Parameters
    ----------
    e, V : (3,), (3, 3) out
    shared : (COLUMNS + 1, COLUMNS)
    J : (3, COLUMNS) array, in place
        Innovation per unit of each common error; per sigma of it afterwards.
    sigma : (COLUMNS,)
        Stated ones.
    z, wide : (3,), (3, 3)
        Innovation, and its covariance with the common errors, S + J J^T per sigma.
    M : (3, COLUMNS) out
        J E.
    m : int
    """
    n = shared.shape[1]
    for a in range(m):
        for c in range(n):
            J[a, c] *= sigma[c]
            M[a, c] = 0.0
        for d in range(n):
            x = J[a, d]
            if x != 0.0:
                for c in range(n):
                    M[a, c] += x * shared[1 + d, c]
    for a in range(m):
        s = z[a]
        for c in range(n):
            s -= J[a, c] * shared[0, c]
        e[a] = s
        for b in range(a + 1):
            s = wide[a, b]
            for c in range(n):
                s -= M[a, c] * J[b, c]
            V[a, b] = s
            V[b, a] = s


@kernel
def learn(
    shared: Array, J: Array, L: Array, w: Array, M: Array, enlargement: float, m: int
) -> None:
    """Take a residual into b^ and E: gain Pi J^T (V lambda)^-1 with Pi = I - E.

    Parameters
    ----------
    shared : (COLUMNS + 1, COLUMNS) array, in place
    J : (3, COLUMNS)
        Per sigma, as `residual` leaves it.
    L, w : (3, 3), (3,)
        Factor of V, and the residual whitened by it.
    M : (3, COLUMNS) array, in place
        J E, as `residual` leaves it; scratch.
    enlargement : float
        lambda >= 1 by which a fix far off weighs less.
    m : int
    """
    n = shared.shape[1]
    root = math.sqrt(enlargement)
    for a in range(m):
        for c in range(n):
            M[a, c] = J[a, c] - M[a, c]
        for b in range(a):
            x = L[a, b] * root  # rows before are divided by it
            for c in range(n):
                M[a, c] -= x * M[b, c]
        x = 1.0 / (L[a, a] * root)
        for c in range(n):
            M[a, c] *= x
    for a in range(m):
        x = w[a] / root
        for c in range(n):
            shared[0, c] += M[a, c] * x
    if m == 3:
        for c in range(COLUMNS):
            x, y, z = M[0, c], M[1, c], M[2, c]
            for d in range(n):
                shared[1 + c, d] = shared[1 + c, d] + x * M[0, d] + y * M[1, d] + z * M[2, d]
        return
    for a in range(m):
        for c in range(COLUMNS):
            x = M[a, c]
            for d in range(n):
                shared[1 + c, d] += x * M[a, d]


@kernel
def clear_shared(shared: Array) -> None:
    """Know nothing of the common errors once more: as at the start."""
    for c in range(COLUMNS):
        for d in range(COLUMNS + 1):
            shared[d, c] = 0.0


@kernel
def whitened(L: Array, V: Array, e: Array, w: Array, m: int) -> float:
    """NIS of a residual, with the factor of V and the whitened residual; -1 if V has none."""
    if not cholesky(L, V, m):
        return -1.0
    nis: float = nis_of(L, e, w, m)
    return nis
