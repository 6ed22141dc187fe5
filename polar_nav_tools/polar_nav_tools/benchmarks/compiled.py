"""Compiled loops for the benchmarks only; compiled anew in each run, never cached.

From here numba would not see a change of the core's kernels (polar_nav_core.kernels.cache).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from polar_nav_core.arrays import Array
from polar_nav_core.kernels.frames.strapdown import strapdown_step
from polar_nav_core.kernels.sins.update import cholesky, innovation_covariance, predict, update

F = TypeVar('F', bound=Callable[..., Any])


def _compiled(function: F) -> F:
    return cast(F, numba.njit(error_model='numpy')(function))


@_compiled
def strapdown_kept(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    dtheta_b: Array,
    dvel_b: Array,
    dt: float,
    C_kept: Array,
    v_kept: Array,
    r_kept: Array,
) -> None:
    """Single steps from rest in the compensation terms; stores the state after every sample."""
    for k in range(1, dtheta_b.shape[0]):
        strapdown_step(C_b_G, v_G, r_e, dtheta_b[k], dvel_b[k], dtheta_b[k - 1], dvel_b[k - 1], dt)
        for i in range(3):
            v_kept[k, i] = v_G[i]
            r_kept[k, i] = r_e[i]
            for j in range(3):
                C_kept[k, i, j] = C_b_G[i, j]


@_compiled
def filter_cycles(
    P: Array,
    Phi: Array,
    q: Array,
    H: Array,
    R: Array,
    z: Array,
    x: Array,
    M: Array,
    S: Array,
    PHt: Array,
    L: Array,
    K: Array,
) -> bool:
    """Prediction and 3-dim update for each row of z (n, 3); False if S is not definite."""
    for k in range(z.shape[0]):
        predict(P, Phi, q, M)
        innovation_covariance(S, PHt, P, H, R, 3)
        if not cholesky(L, S, 3):
            return False
        update(P, x, S, z[k], 3, K, PHt, L, M)
    return True
