"""WGS-84 earth: ECEF and geodetic coordinates, up vector, gravity. Regular at both poles.

Positions are ECEF metres, arrays of shape (..., 3); angles are radians. Compiled in
`kernels.frames.earth`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, scalar_or_array, vectors
from .kernels.frames import earth as _kernels
from .kernels.frames.earth import ECCENTRICITY_2, FLATTENING, GM, OMEGA_IE, SEMI_MAJOR, SEMI_MINOR

__all__ = [
    'ECCENTRICITY_2',
    'FLATTENING',
    'GM',
    'OMEGA_IE',
    'SEMI_MAJOR',
    'SEMI_MINOR',
    'ecef_from_geodetic',
    'ecef_to_enu',
    'geodetic_from_ecef',
    'gravity',
    'up',
]


@np.errstate(over='ignore', invalid='ignore')  # a filter that has gone astray can be anywhere
def _up_and_height(r_e: ArrayLike) -> tuple[Array, Array]:
    """Up vectors (..., 3) and heights (...)."""
    positions = vectors(r_e, 'r_e')
    if np.any(np.sum(positions * positions, axis=-1) < 1.0):
        raise ValueError('r_e is within 1 m of the centre of the earth, where up is undefined')
    flat = positions.reshape(-1, 3)
    u_e = np.empty_like(flat)
    height = np.empty(flat.shape[0])
    _kernels.up_and_height_many(flat, u_e, height)
    return u_e.reshape(positions.shape), height.reshape(positions.shape[:-1])


def up(r_e: ArrayLike) -> Array:
    """Up vector (normal of the ellipsoid) in ECEF.

    Parameters
    ----------
    r_e : array_like, shape (..., 3)
        Position, ECEF [m].

    Returns
    -------
    ndarray, shape (..., 3)
        Unit vector (cos lat cos lon, cos lat sin lon, sin lat).
    """
    return _up_and_height(r_e)[0]


def geodetic_from_ecef(r_e: ArrayLike) -> tuple[Array, Array, Array]:
    """Geodetic latitude, longitude [rad] and height above the ellipsoid [m].

    Bowring's formula, twice; exact to rounding between 1000 km below and 40000 km above the
    ellipsoid. At a pole the latitude is exactly +-pi/2 and the longitude, undefined there, is
    atan2(y, x).

    Parameters
    ----------
    r_e : array_like, shape (..., 3)
        Position, ECEF [m].

    Returns
    -------
    lat, lon, h : ndarray, shape (...)
        Scalars for a single position; lon in [-pi, pi].
    """
    u_e, height = _up_and_height(r_e)
    positions = vectors(r_e, 'r_e')
    lat = np.arctan2(u_e[..., 2], np.hypot(u_e[..., 0], u_e[..., 1]))
    lon = np.arctan2(positions[..., 1], positions[..., 0])
    return scalar_or_array(lat), scalar_or_array(lon), scalar_or_array(height)


def ecef_from_geodetic(lat: ArrayLike, lon: ArrayLike, h: ArrayLike) -> Array:
    """ECEF position of geodetic coordinates.

    Parameters
    ----------
    lat, lon : array_like
        Geodetic latitude and longitude [rad], broadcast together with h.
    h : array_like
        Height above the ellipsoid [m].

    Returns
    -------
    ndarray, shape (..., 3)
        r_e [m].
    """
    L, lam, height = np.broadcast_arrays(
        np.asarray(lat, np.float64), np.asarray(lon, np.float64), np.asarray(h, np.float64)
    )
    outside = np.abs(L) > 0.5 * np.pi + 1e-12
    if np.any(outside):
        raise ValueError(f'lat must be within +-pi/2 rad, not {L[outside][0]}')
    s = np.sin(L)
    r_n = SEMI_MAJOR / np.sqrt(1.0 - ECCENTRICITY_2 * s * s)
    p = (r_n + height) * np.cos(L)
    z = (r_n * (1.0 - ECCENTRICITY_2) + height) * s
    return np.stack([p * np.cos(lam), p * np.sin(lam), z], axis=-1)


def gravity(r_e: ArrayLike) -> Array:
    """Normal gravity: the positive magnitude along -up, centrifugal part included [m/s^2].

    Somigliana's formula on the ellipsoid with the second-order height factor of WGS-84.

    Parameters
    ----------
    r_e : array_like, shape (..., 3)
        Position, ECEF [m].

    Returns
    -------
    ndarray, shape (...)
    """
    positions = vectors(r_e, 'r_e')
    flat = positions.reshape(-1, 3)
    result = np.empty(flat.shape[0])
    _kernels.gravity_many(flat, result)
    return scalar_or_array(result.reshape(positions.shape[:-1]))


def ecef_to_enu(lat: ArrayLike, lon: ArrayLike) -> Array:
    """Rotation from ECEF to true east, north, up; at a pole along the given meridian.

    Parameters
    ----------
    lat, lon : array_like, shape (...)
        Geodetic [rad].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        C_e_n; its rows are east, north and up, ECEF.
    """
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(s)
    rows = ([-sl, cl, zero], [-s * cl, -s * sl, c], [c * cl, c * sl, s])
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)
