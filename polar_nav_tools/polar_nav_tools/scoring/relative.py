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
from polar_nav_core.spilled import by_rows

from .align import Alignment, EstimateAt, TruthAt

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

INTERVAL_S = 10.0
"""Interval of the relative error in tables."""


def absolute_errors(pairs: Alignment) -> Floats:
    """Distance between estimate and truth [m], shape (n,); NaN without an estimate."""
    return np.asarray(np.linalg.norm(pairs.estimate.r_e - pairs.truth.r_e, axis=1))


@np.errstate(over='ignore', invalid='ignore')  # a damaged message can hold any number
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

    # Translations of Q_i^-1 Q_j and P_i^-1 P_j. That of E is R(Q_i^-1 Q_j)' (p - q): a rotation
    # does not change its length.
    def between(i: Rows, j: Rows) -> Floats:
        q, p = _translation(pairs.truth, i, j), _translation(pairs.estimate, i, j)
        return np.asarray(np.linalg.norm(p - q, axis=1))

    return by_rows(between, i, j)


def _translation(poses: TruthAt | EstimateAt, i: Rows, j: Rows) -> Floats:
    """Displacement from rows `i` to rows `j` in the body axes of `i` [m], shape (m, 3)."""
    step_e = poses.r_e[j] - poses.r_e[i]
    step_G = np.einsum('nij,nj->ni', _axes(poses.r_e[i]), step_e)
    return np.asarray(np.einsum('nji,nj->ni', poses.C_b_G[i], step_G))


def _axes(r_e: Floats) -> Floats:
    """C_e_G at each position, shape (m, 3, 3); NaN where grid axes are undefined.

    That is at the centre of the earth and on its y axis; a damaged estimate can be anywhere.
    """
    C_e_G = np.full((len(r_e), 3, 3), np.nan)
    good = (np.hypot(r_e[:, 0], r_e[:, 2]) > 1.0) & np.isfinite(r_e).all(axis=1)
    C_e_G[good] = ecef_to_grid(r_e[good])
    return C_e_G
