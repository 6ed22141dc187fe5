"""Coordinates of foreign positions to the earth frame (ECEF).

`geodetic` is latitude, longitude [deg] and height above the ellipsoid [m]; `earth` is ECEF; `enu`
and `ned` are Cartesian axes at a stated origin; `epsg` is a map projection (UTM, polar
stereographic) with heights as third coordinate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.earth import ecef_from_geodetic, ecef_to_enu
from polar_nav_core.errors import ConfigError

from .arrays import turned
from .mapping import Frame

_STEP = 1.0
"""Of the differences that give the axes of a map projection [m]."""


class Placed(NamedTuple):
    """Positions in the earth frame.

    Attributes
    ----------
    r_e : (n, 3) array
        ECEF [m].
    axes_e : (n, 3, 3) array
        The frame's own axes there as columns, ECEF; of a map projection they carry its scale.
    """

    r_e: Array
    axes_e: Array


def to_earth(frame: Frame, values: Array) -> Placed:
    """Take (n, 3) coordinates of a frame to ECEF.

    Raises
    ------
    ConfigError
        When the frame is not stated, or pyproj is needed and missing.
    """
    n = len(values)
    if frame.kind == 'earth':
        return Placed(values, np.broadcast_to(np.eye(3), (n, 3, 3)))
    if frame.kind == 'geodetic':
        lat, lon = np.radians(values[:, 0]), np.radians(values[:, 1])
        r_e = ecef_from_geodetic(lat, lon, values[:, 2])
        return Placed(np.asarray(r_e), _enu_axes(lat, lon))
    if frame.kind in ('enu', 'ned'):
        return _local(frame, values)
    if frame.kind == 'epsg':
        return _projected(frame, values)
    raise ConfigError('the frame is not stated: one of geodetic, earth, enu, ned, epsg')


def _enu_axes(lat: Array, lon: Array) -> Array:
    """East, north and up as columns, ECEF; at a pole along the given meridian. -> (n, 3, 3)."""
    return np.swapaxes(ecef_to_enu(lat, lon), -1, -2)


def _local(frame: Frame, values: Array) -> Placed:
    if frame.origin is None:
        raise ConfigError(f'frame {frame.kind} has no origin')
    lat, lon = np.radians(frame.origin[0]), np.radians(frame.origin[1])
    axes = _enu_axes(np.array([lat]), np.array([lon]))[0]
    if frame.kind == 'ned':
        axes = np.column_stack([axes[:, 1], axes[:, 0], -axes[:, 2]])
    origin = np.asarray(ecef_from_geodetic(lat, lon, frame.origin[2]))
    return Placed(origin + turned(axes, values), np.broadcast_to(axes, (len(values), 3, 3)))


def _projected(frame: Frame, values: Array) -> Placed:
    try:
        from pyproj import Transformer
        from pyproj.exceptions import CRSError
    except ImportError:
        raise ConfigError(
            'frame epsg needs pyproj, which is not installed here (pip install pyproj)'
        ) from None
    try:
        transformer = Transformer.from_crs(frame.epsg, 4326, always_xy=True)
    except CRSError as error:
        raise ConfigError(f'epsg: {frame.epsg}: {error}') from error

    def place(x: Array, y: Array, h: Array) -> Array:
        lon, lat = transformer.transform(x, y)
        return np.asarray(ecef_from_geodetic(np.radians(lat), np.radians(lon), h))

    x, y, h = values.T
    r_e = place(x, y, h)
    columns = [
        place(x + _STEP, y, h) - r_e,
        place(x, y + _STEP, h) - r_e,
        place(x, y, h + _STEP) - r_e,
    ]
    return Placed(r_e, np.stack(columns, axis=-1) / _STEP)
