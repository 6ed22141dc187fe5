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
    for c in range(COLUMNS):
        shared[0, c] *= f
    for d in range(1, COLUMNS + 1):
        for c in range(COLUMNS):
            shared[d, c] *= f * f


@kernel
def residual(
    e: Array, V: Array, shared: Array, J: Array, sigma: Array, z: Array, wide: Array, m: int
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
    m : int
    """
    for a in range(m):
        e[a] = z[a]
        for c in range(COLUMNS):
            J[a, c] *= sigma[c]
            e[a] -= J[a, c] * shared[0, c]
    for a in range(m):
        for b in range(m):
            V[a, b] = wide[a, b]
    for a in range(m):
        for c in range(COLUMNS):
            if J[a, c] != 0.0:
                t = 0.0
                for d in range(COLUMNS):
                    t += shared[1 + c, d] * J[a, d]
                # Rows b up to a: V is symmetric.
                for b in range(a + 1):
                    V[a, b] -= J[b, c] * t
    for a in range(m):
        for b in range(a):
            V[b, a] = V[a, b]


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
    M : (3, COLUMNS) scratch
    enlargement : float
        lambda >= 1 by which a fix far off weighs less.
    m : int
    """
    for a in range(m):
        for c in range(COLUMNS):
            t = J[a, c]
            for d in range(COLUMNS):
                t -= J[a, d] * shared[1 + d, c]
            M[a, c] = t
        for c in range(COLUMNS):
            for b in range(a):
                M[a, c] -= L[a, b] * M[b, c]
            M[a, c] /= L[a, a]
    for a in range(m):
        for c in range(COLUMNS):
            shared[0, c] += M[a, c] * w[a] / enlargement
            for d in range(COLUMNS):
                shared[1 + c, d] += M[a, c] * M[a, d] / enlargement


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
