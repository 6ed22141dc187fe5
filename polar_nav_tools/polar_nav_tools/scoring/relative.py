"""Absolute and relative position errors as `evo` computes them (evo_ape, evo_rpe; translation).

Absolute: distance between estimate and truth in space, no alignment of the trajectories. Relative:
over a time interval, ``E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j)`` with poses Q of the truth and P of the
estimate (earth axes, pose of base_link); its translation is what the estimate's motion over the
interval is off, seen from the vehicle, whatever the error was before. All pairs of samples that
far apart count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.grid import ecef_to_grid

from .align import Alignment

Floats = NDArray[np.float64]

INTERVAL_S = 10.0
"""Interval of the relative error in tables."""


def absolute_errors(pairs: Alignment) -> Floats:
    """Distance between estimate and truth [m], shape (n,); NaN without an estimate."""
    return np.asarray(np.linalg.norm(pairs.estimate.r_e - pairs.truth.r_e, axis=1))


def relative_errors(pairs: Alignment, interval_s: float = INTERVAL_S) -> Floats:
    """Translation part of the relative error over an interval [m].

    Parameters
    ----------
    pairs : Alignment
    interval_s : float
        [s]; a sample without another one exactly that much later gives nothing.

    Returns
    -------
    ndarray, shape (m,)
        NaN where an estimate is missing.
    """
    if not interval_s > 0.0:
        raise ValueError(f'interval_s={interval_s} must be > 0')
    stamp_ns = pairs.truth.stamp_ns
    wanted = stamp_ns + round(interval_s * 1e9)
    at = np.minimum(np.searchsorted(stamp_ns, wanted), len(stamp_ns) - 1)
    i = np.flatnonzero(stamp_ns[at] == wanted)
    j = at[i]
    C_truth, C_estimate = (
        _attitude_e(r_e, C_b_G)
        for r_e, C_b_G in (
            (pairs.truth.r_e, pairs.truth.C_b_G),
            (pairs.estimate.r_e, pairs.estimate.C_b_G),
        )
    )
    # Translations of Q_i^-1 Q_j and P_i^-1 P_j, each in the body axes of its own i.
    q = np.einsum('nji,nj->ni', C_truth[i], pairs.truth.r_e[j] - pairs.truth.r_e[i])
    p = np.einsum('nji,nj->ni', C_estimate[i], pairs.estimate.r_e[j] - pairs.estimate.r_e[i])
    # The translation of E is R(Q_i^-1 Q_j)' (p - q): a rotation does not change its length.
    return np.asarray(np.linalg.norm(p - q, axis=1))


def _attitude_e(r_e: Floats, C_b_G: Floats) -> Floats:
    """C_b_e; NaN without a position."""
    out = np.full((len(r_e), 3, 3), np.nan)
    known = np.isfinite(r_e).all(1)
    out[known] = np.swapaxes(ecef_to_grid(r_e[known]), 1, 2) @ C_b_G[known]
    return out
