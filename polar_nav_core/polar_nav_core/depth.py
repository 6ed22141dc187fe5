"""Depth from pressure and back by TEOS-10 (docs/derivations/measurements.md, 2).

``h = sea_surface_height - depth`` is the ellipsoidal height of the sensor; what the engine makes
of it is `kernels.sins.rows.depth_rows`.
"""

from __future__ import annotations

import gsw
import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, scalar_or_array

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
