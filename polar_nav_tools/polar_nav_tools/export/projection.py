"""Positions and axes of polar map projections, by pyproj.

x and y are of the projection, whose scale is not 1 (EPSG:3413 at 80 N: 0.98), and z is the height
above the ellipsoid. Attitudes and velocities are in the axes of the map at the vehicle, true to
scale.
"""

from __future__ import annotations

import numpy as np

from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid

from ..series.vehicle import Floats

PROJECTIONS = {'epsg:3413': 1.0, 'epsg:3995': 1.0, 'epsg:3031': -1.0}
"""NSIDC north, Arctic and Antarctic polar stereographic, of WGS 84; sign of their latitudes."""
_STEP = 1.0
"""Of the differences that give the axes [m]."""


def projected(name: str, r_e: Floats) -> tuple[Floats, Floats]:
    """Map coordinates (n, 3) and C_e_map (n, 3, 3) of ECEF positions.

    Parameters
    ----------
    name : str
        One of `PROJECTIONS`.
    r_e : (n, 3) array
        ECEF [m].

    Raises
    ------
    ConfigError
        Without pyproj, and for a place on the other hemisphere.
    """
    try:
        from pyproj import Transformer
    except ImportError:
        raise ConfigError(f'frame {name} needs pyproj (pip install pyproj)') from None
    transformer = Transformer.from_crs('epsg:4326', name, always_xy=True)

    if np.any(PROJECTIONS[name] * r_e[:, 2] < 0.0):
        raise ConfigError(f'frame {name}: a position is on the other hemisphere')

    def place(points_e: Floats) -> tuple[Floats, Floats]:
        lat, lon, height = geodetic_from_ecef(points_e)
        x, y = transformer.transform(np.degrees(lon), np.degrees(lat))
        return np.column_stack([x, y]), np.asarray(height)

    C_e_G = ecef_to_grid(r_e)
    (xy, height), (east, _), (north, _) = (
        place(points_e) for points_e in (r_e, r_e + _STEP * C_e_G[:, 0], r_e + _STEP * C_e_G[:, 1])
    )
    east, north = east - xy, north - xy
    turn = np.arctan2(east[:, 1] - north[:, 0], east[:, 0] + north[:, 1])
    C_G_map = np.zeros((len(r_e), 3, 3))
    C_G_map[:, 0, 0] = C_G_map[:, 1, 1] = np.cos(turn)
    C_G_map[:, 1, 0] = np.sin(turn)
    C_G_map[:, 0, 1] = -np.sin(turn)
    C_G_map[:, 2, 2] = 1.0
    return np.column_stack([xy, height]), C_G_map @ C_e_G
