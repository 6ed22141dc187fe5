"""A position fix: innovation and its rows in ECEF (docs/derivations/measurements.md, 3).

The readable form of `kernels.sins.rows.fix_rows`, which the engine runs in grid axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from polar_nav_core.arrays import Array, matrices, vectors
from polar_nav_core.attitude import skew
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid

from .error_model import Navigation


def innovation(
    navigation: Navigation,
    transponder_r_e: ArrayLike,
    lever_b: ArrayLike,
    C_a_e: ArrayLike | None = None,
) -> Array:
    """Estimate minus measurement of the transponder's position, ECEF [m], shape (3,).

    Parameters
    ----------
    navigation : Navigation
        Of the follower, at the time of validity.
    transponder_r_e : array_like, shape (3,)
        The fix, ECEF [m].
    lever_b : array_like, shape (3,)
        From the follower's base_link to its transponder, body axes [m].
    C_a_e : array_like, shape (3, 3), optional
        Leader's array axes to ECEF, where the USBL error is estimated.
    """
    lever_e = ecef_to_grid(navigation.r_e).T @ navigation.C_b_G @ vectors(lever_b, 'lever_b')
    fix = vectors(transponder_r_e, 'transponder_r_e')
    if C_a_e is not None:
        fix = fix - matrices(C_a_e, 'C_a_e') @ navigation.usbl_bias_a
    result: Array = navigation.r_e + lever_e - fix
    return result


def jacobian(navigation: Navigation, lever_b: ArrayLike, C_a_e: ArrayLike | None = None) -> Array:
    """H, shape (3, 24): innovation = H x.

    The turn of the lever arm with dr, lever over earth radius, is left out.
    """
    C_G_e = ecef_to_grid(navigation.r_e).T
    H = np.zeros((3, X.size))
    H[:, X.phi_G] = C_G_e @ skew(navigation.C_b_G @ vectors(lever_b, 'lever_b'))
    H[:, X.dr_e] = np.eye(3)
    if C_a_e is not None:
        H[:, X.usbl_bias_a] = -matrices(C_a_e, 'C_a_e')
    return H
