"""Depth: from pressure (TEOS-10), and the height it gives (docs/derivations/measurements.md, 2).

``h = sea_surface_height - depth`` is the ellipsoidal height of the sensor; base_link's follows
with the lever arm. `kernels.sins.rows.depth_rows` is the compiled form that the engine runs.
"""

from __future__ import annotations

import gsw
import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, scalar_or_array, vectors
from .attitude import skew
from .earth import geodetic_from_ecef, up
from .error_model import Navigation, X

STANDARD_ATMOSPHERE = 101325.0
"""Atmospheric pressure at the sea surface unless stated otherwise [Pa]."""


def depth_from_pressure(
    pressure: ArrayLike, lat: ArrayLike, atmospheric_pressure: float = STANDARD_ATMOSPHERE
) -> Array:
    """Depth below the sea surface, positive down [m], of an absolute pressure [Pa].

    TEOS-10 (gsw.z_from_p) for a standard ocean of salinity 35.16504 g/kg and 0 degrees Celsius;
    gravity by latitude. Real polar water columns differ by some tenths of a per cent.

    Parameters
    ----------
    pressure : array_like
        Absolute pressure [Pa].
    lat : array_like
        Geodetic latitude [rad].
    atmospheric_pressure : float
        Pressure of the air at the surface [Pa].

    Returns
    -------
    ndarray
    """
    sea_pressure_dbar = (np.asarray(pressure, np.float64) - atmospheric_pressure) * 1e-4
    return scalar_or_array(-np.asarray(gsw.z_from_p(sea_pressure_dbar, np.degrees(lat))))


def pressure_from_depth(
    depth: ArrayLike, lat: ArrayLike, atmospheric_pressure: float = STANDARD_ATMOSPHERE
) -> Array:
    """Absolute pressure [Pa] at a depth [m]: the inverse of `depth_from_pressure`."""
    sea_pressure_dbar = gsw.p_from_z(-np.asarray(depth, np.float64), np.degrees(lat))
    return scalar_or_array(np.asarray(sea_pressure_dbar) * 1e4 + atmospheric_pressure)


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
