"""The grid frame G: x grid east, y grid north, z up.

Grid north is the horizontal direction parallel to the plane of the Greenwich meridian.
Everything comes from the up vector, nothing from longitude, so both poles are ordinary places
(docs/derivations/grid.md). The only singular places are on the equator at longitude +-90 degrees,
where up is parallel to the ECEF y axis: functions of a position raise `ValueError` within 6 cm of
them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, scalar_or_array, vectors
from .earth import up
from .kernels.frames import grid as _kernels
from .kernels.sins.columns import SIGMA_CAP

SINGULAR_DELTA = 1e-8
"""Smallest Delta = sqrt(1 - u_y^2) that is still used [rad]."""

TRUE_HEADING_SIGMA_CAP = SIGMA_CAP
"""Standard deviation of a heading of which nothing is known (uniform over the circle) [rad]."""


def refuse_singular(delta: Array) -> None:
    """ValueError if one of the places, ``Delta = sqrt(1 - u_y^2)`` from singular, is too near."""
    if np.any(delta < SINGULAR_DELTA):
        raise ValueError(
            'grid north is undefined on the equator at longitude +-90 deg '
            f'(Delta = {float(np.min(delta)):.3g} < {SINGULAR_DELTA:g})'
        )


def require_regular(r_e: ArrayLike) -> Array:
    """Return r_e as an array (..., 3); ValueError if one of the singular places is in it."""
    positions = vectors(r_e, 'r_e')
    u_e = up(positions)
    refuse_singular(np.hypot(u_e[..., 0], u_e[..., 2]))
    return positions


def ecef_to_grid(r_e: ArrayLike) -> Array:
    """C_e_G: takes ECEF components to grid components; its rows are grid east, grid north and up.

    Parameters
    ----------
    r_e : array_like, shape (..., 3)
        Position, ECEF [m].

    Returns
    -------
    ndarray, shape (..., 3, 3)

    Raises
    ------
    ValueError
        On the equator at longitude +-90 degrees.
    """
    positions = require_regular(r_e)
    flat = positions.reshape(-1, 3)
    result = np.empty((flat.shape[0], 3, 3))
    _kernels.fill_C_e_G_many(flat, result)
    return result.reshape((*positions.shape, 3))


def convergence(lat: ArrayLike, lon: ArrayLike) -> Array:
    """Azimuth of grid north, clockwise from true north: true heading = grid heading + convergence.

    ``sigma = atan2(sin(lat) sin(lon), cos(lon))`` (docs/derivations/grid.md, eq. 3). At a pole it
    is the limit along the given meridian, i.e. +-lon.

    Parameters
    ----------
    lat, lon : array_like
        Geodetic latitude and longitude [rad].

    Returns
    -------
    ndarray
        sigma [rad], in [-pi, pi].

    Raises
    ------
    ValueError
        On the equator at longitude +-90 degrees.
    """
    y = np.sin(lat) * np.sin(lon)
    x = np.cos(lon)
    refuse_singular(np.hypot(x, y))
    return scalar_or_array(np.asarray(np.arctan2(y, x)))


def _rates(r_e: ArrayLike, v_G: ArrayLike) -> tuple[Array, Array]:
    positions = require_regular(r_e)
    velocities = vectors(v_G, 'v_G')
    shape = np.broadcast_shapes(positions.shape, velocities.shape)
    flat_r = np.ascontiguousarray(np.broadcast_to(positions, shape).reshape(-1, 3)).copy()
    flat_v = np.ascontiguousarray(np.broadcast_to(velocities, shape).reshape(-1, 3)).copy()
    omega_ie_G = np.empty_like(flat_r)
    omega_eG_G = np.empty_like(flat_r)
    _kernels.fill_rates_many(flat_r, flat_v, omega_ie_G, omega_eG_G)
    return omega_ie_G.reshape(shape), omega_eG_G.reshape(shape)


def earth_rate(r_e: ArrayLike) -> Array:
    """omega_ie_G: rotation of the earth, grid axes [rad/s].

    Parameters
    ----------
    r_e : array_like, shape (..., 3)
        Position, ECEF [m].

    Returns
    -------
    ndarray, shape (..., 3)
    """
    return _rates(r_e, np.zeros(3))[0]


def transport_rate(r_e: ArrayLike, v_G: ArrayLike) -> Array:
    """omega_eG_G: rotation of the grid axes against the earth due to motion, grid axes [rad/s].

    Exact on the ellipsoid (docs/derivations/grid.md, eq. 6).

    Parameters
    ----------
    r_e : array_like, shape (..., 3)
        Position, ECEF [m].
    v_G : array_like, shape (..., 3)
        Velocity over ground, grid axes [m/s].

    Returns
    -------
    ndarray, shape (..., 3)
    """
    return _rates(r_e, v_G)[1]


class TrueHeading(NamedTuple):
    """True heading with what is needed to judge it."""

    heading: float
    """Clockwise from true north [rad], in [0, 2 pi); NaN where sigma reaches the cap."""
    sigma: float
    """Standard deviation [rad], at most `TRUE_HEADING_SIGMA_CAP`."""
    convergence: float
    """Azimuth of grid north, clockwise from true north [rad]; NaN with heading."""


def true_heading(
    r_e: ArrayLike, grid_heading: float, sigma_grid: float, sigma_east: float
) -> TrueHeading:
    """True heading = grid heading + convergence, and how well it can be known here.

    The position error across the meridian turns true north: ``sigma = min(pi / sqrt(3),
    hypot(sigma_grid, sigma_east / hypot(x_e, y_e)))``, which grows as 1/cos(latitude). At the cap
    nothing is known and heading and convergence are NaN.

    Parameters
    ----------
    r_e : array_like, shape (3,)
        Position, ECEF [m].
    grid_heading : float
        Clockwise from grid north [rad].
    sigma_grid : float
        Standard deviation of the grid heading [rad].
    sigma_east : float
        Standard deviation of the position along true east [m].

    Returns
    -------
    TrueHeading
    """
    x, y, z = (float(c) for c in vectors(r_e, 'r_e'))
    distance = float(np.hypot(x, y))
    if distance > 0.0:
        sigma = float(np.hypot(sigma_grid, sigma_east / distance))
    else:
        sigma = TRUE_HEADING_SIGMA_CAP
    if not sigma < TRUE_HEADING_SIGMA_CAP:
        cap = TRUE_HEADING_SIGMA_CAP if sigma >= TRUE_HEADING_SIGMA_CAP else float('nan')
        return TrueHeading(float('nan'), cap, float('nan'))
    u_z = float(up(np.array([x, y, z]))[2])
    # atan2(sin(lat) sin(lon), cos(lon)), both times the distance from the axis
    refuse_singular(np.asarray(np.hypot(x, u_z * y) / distance))
    sigma_angle = float(np.arctan2(u_z * y, x))
    return TrueHeading(float(np.mod(grid_heading + sigma_angle, 2.0 * np.pi)), sigma, sigma_angle)
