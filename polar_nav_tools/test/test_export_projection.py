"""Polar stereographic coordinates of trajectories: pyproj's own, and axes that fit them."""

import numpy as np
import pyproj
import pytest

from polar_nav_core.earth import ecef_from_geodetic, geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_tools.export.projection import PROJECTIONS, projected


@pytest.mark.parametrize('name', PROJECTIONS)
def test_positions_are_those_of_pyproj_and_steps_follow_the_axes(name):
    south = -1.0 if name == 'epsg:3031' else 1.0
    lat = south * np.radians([70.0, 80.0, 89.9999, 90.0])
    lon = np.radians([120.0, -45.0, 10.0, 0.0])
    r_e = ecef_from_geodetic(lat, lon, np.array([-100.0, 0.0, 5.0, -10.0]))
    r_map, C_e_map = projected(name, r_e)
    x, y = pyproj.Proj(name)(np.degrees(lon), np.degrees(lat))
    np.testing.assert_allclose(r_map[:, 0], x, atol=1e-5)
    np.testing.assert_allclose(r_map[:, 1], y, atol=1e-5)
    np.testing.assert_allclose(r_map[:, 2], geodetic_from_ecef(r_e)[2])
    for axis in (0, 1):
        moved, _ = projected(name, r_e + 10.0 * C_e_map[:, axis])
        step = moved[:, :2] - r_map[:, :2]
        step /= np.linalg.norm(step, axis=1)[:, None]
        np.testing.assert_allclose(step, np.tile(np.eye(2)[axis], (4, 1)), atol=1e-5)
    identity = C_e_map @ np.swapaxes(C_e_map, 1, 2)
    np.testing.assert_allclose(identity, np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)


def test_the_other_hemisphere_is_not_on_the_map():
    with pytest.raises(ConfigError, match='other hemisphere'):
        projected('epsg:3413', ecef_from_geodetic(np.radians([-90.0]), np.zeros(1), np.zeros(1)))
