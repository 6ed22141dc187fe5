"""Depth as a height: innovation and its row (docs/derivations/measurements.md, 2).

The readable form of `kernels.sins.rows.depth_rows`, which the engine runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from polar_nav_core.arrays import Array, vectors
from polar_nav_core.attitude import skew
from polar_nav_core.earth import geodetic_from_ecef, up
from polar_nav_core.error_model import X

from .error_model import Navigation


def innovation(
    navigation: Navigation, depth: float, sea_surface_height: float, lever_b: ArrayLike
) -> Array:
    """Estimate minus measurement of the sensor's height [m], shape (1,).

    Parameters
    ----------
    navigation : Navigation
    depth : float
        Depth of the sensor, positive down [m].
    sea_surface_height : float
        Ellipsoidal height of the sea surface [m].
    lever_b : array_like, shape (3,)
        From base_link to the sensor, body axes [m].
    """
    _, _, height = geodetic_from_ecef(navigation.r_e)
    lever_up = navigation.C_b_G[2] @ vectors(lever_b, 'lever_b')
    return np.array([float(height) + float(lever_up) - (sea_surface_height - depth)])


def jacobian(navigation: Navigation, lever_b: ArrayLike) -> Array:
    """H, shape (1, 24): innovation = H x for the error vector x of `error_model.X`."""
    H = np.zeros((1, X.size))
    H[0, X.phi_G] = skew(navigation.C_b_G @ vectors(lever_b, 'lever_b'))[2]
    H[0, X.dr_e] = up(navigation.r_e)
    return H
