"""Straight course through the newest refused fixes: where they say that the vehicle is, how fast.

Least squares of a position and a velocity, weighted by what the fixes state and by what a vehicle
may have done meanwhile. It knows nothing of the estimate that the fixes contradict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from .disagreement import Refused
from .results import chi2_gate

FEWEST = 3
"""Fixes of a course."""
_MOST = 6
"""Newer ones say more of the present than older ones, which a turn may lie behind."""
_LEAST_S = 2.0
"""Time between the first and the last of them."""
_CERTAIN = 0.9999
"""Chi-square probability beyond which fixes lie on no course."""
MANOEUVRE = 0.3
"""Acceleration that a vehicle holds for seconds, 1-sigma per axis [m/s^2]."""


@dataclass(frozen=True)
class Course:
    """Horizontal position and velocity at a moment, grid axes.

    Attributes
    ----------
    position : (2,) array
        From the newest fix [m].
    velocity : (2,) array
        [m/s].
    covariance : (2, 2) array
        Of position and velocity, the same for both axes.
    newest_e : (3,) array
        The newest fix, ECEF [m].
    """

    position: Array
    velocity: Array
    covariance: Array
    newest_e: Array


def course_of(refused: Sequence[Refused], C_e_G: Array, stamp_ns: int) -> Course | None:
    """Course through the newest of some fixes, at a stamp [ns]; None where they lie on none.

    Parameters
    ----------
    refused : sequence of Refused
        In the order of validity.
    C_e_G : (3, 3) array
        ECEF to grid axes.
    stamp_ns : int
        Not before the newest of them.
    """
    row = list(refused[-_MOST:])
    if len(row) < FEWEST:
        return None
    newest = row[-1]
    time_s = np.array([(r.validity_ns - newest.validity_ns) * 1e-9 for r in row])
    if not -time_s[0] >= _LEAST_S:
        return None
    z = np.array([(C_e_G @ (r.r_e - newest.r_e))[:2] for r in row])
    stated = np.array([r.variance(C_e_G) for r in row])
    weights = 1.0 / (stated + _moved(time_s) ** 2)
    A = np.column_stack([np.ones(len(row)), time_s])
    covariance = np.linalg.inv(A.T @ (weights[:, None] * A))
    x = covariance @ A.T @ (weights[:, None] * z)
    chi2 = float(np.sum(weights[:, None] * (z - A @ x) ** 2))
    if not chi2 < chi2_gate(_CERTAIN, 2 * len(row) - 4):
        return None
    age_s = (stamp_ns - newest.validity_ns) * 1e-9
    F = np.array([[1.0, age_s], [0.0, 1.0]])
    changed = np.array([_moved(age_s), MANOEUVRE * age_s])
    there = F @ x
    return Course(
        there[0],
        there[1],
        F @ covariance @ F.T + np.outer(changed, changed),
        newest.r_e,
    )


def _moved(time_s: Array | float) -> Array:
    """Way that a manoeuvre leads off a straight course in a time [s], 1-sigma [m]."""
    return np.asarray(0.5 * MANOEUVRE * np.square(time_s))
