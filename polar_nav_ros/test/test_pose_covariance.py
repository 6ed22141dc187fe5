"""Poses whose covariance leaves height and tilt open, as RViz sends them, wherever they are."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped

from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.local_frame import LocalFrame
from polar_nav_ros.adapters.pose import pose_in_earth, sigma_height

LATITUDE, LONGITUDE = np.radians(63.4), np.radians(10.4)


def pose(x: float, height: float, tilt: float) -> PoseWithCovarianceStamped:
    """A pose in the map with variances of height and tilt; x, y 1 m and yaw 0.26 rad (RViz)."""
    message = PoseWithCovarianceStamped()
    message.header.frame_id = 'map'
    message.pose.pose.position.x = x
    message.pose.pose.orientation.w = 1.0
    message.pose.covariance = np.diag([1.0, 1.0, height, tilt, tilt, 0.07]).ravel()
    return message


@pytest.mark.parametrize('axes', ['enu', 'grid'])
@pytest.mark.parametrize('x', [0.0, 16.0, 5000.0])
def test_zero_variances_are_open_away_from_the_origin_too(axes: str, x: float) -> None:
    """The map's vertical leans against that of the place: 3e-6 of the metre comes into it."""
    frame = LocalFrame(np.asarray(ecef_from_geodetic(LATITUDE, LONGITUDE, 0.0)), axes)
    found = pose_in_earth(pose(x, 0.0, 0.0), 'map', frame)
    assert found.sigma_height is None
    assert found.sigma_tilt is None
    assert found.sigma_position == pytest.approx(1.0, abs=1e-6)


def test_small_variances_that_are_stated_are_taken() -> None:
    """A centimetre of height, a twentieth of a degree of tilt."""
    frame = LocalFrame(np.asarray(ecef_from_geodetic(LATITUDE, LONGITUDE, 0.0)), 'enu')
    tilt = np.radians(0.05)
    found = pose_in_earth(pose(5000.0, 1e-4, float(tilt**2)), 'map', frame)
    assert found.sigma_height == pytest.approx(0.01, rel=0.01)
    assert found.sigma_tilt == pytest.approx(tilt, rel=0.3)


def test_a_height_beside_an_unknown_horizontal_variance() -> None:
    """NaN of x and y says nothing of the height."""
    assert sigma_height(0.04, np.nan) == pytest.approx(0.2)
    assert sigma_height(np.nan, np.nan) is None
