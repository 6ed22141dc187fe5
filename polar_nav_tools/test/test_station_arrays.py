"""Attitudes of an AHRS as arrays: those that messages give one by one."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import Imu

from polar_nav_core import attitude
from polar_nav_ros.navigation_inputs import ahrs_from_msg
from polar_nav_tools.replay.station_arrays import attitudes


def test_attitudes_are_those_of_the_messages_to_the_last_bit():
    rng = np.random.default_rng(4)
    angles = rng.uniform(-np.pi, np.pi, (200, 3)) * [1.0, 0.4, 1.0]
    xyzw = attitude.quaternion_from_matrix(attitude.matrix_from_euler(*angles.T))
    xyzw[::7] *= 1.0 + 2e-4  # rounded on the way
    xyzw[::11] *= 1.1  # no rotation
    xyzw[::13] = np.nan
    told = np.where(np.arange(200) % 17 == 0, -1.0, 1e-4)
    found = attitudes(xyzw, told)
    for q, covariance, C_b_G in zip(xyzw, told, found, strict=True):
        message = Imu()
        o = message.orientation
        o.x, o.y, o.z, o.w = (float(v) for v in q)
        message.orientation_covariance[0] = covariance
        expected = ahrs_from_msg(message, 0).C_b_G
        if expected is None:
            expected = np.full((3, 3), np.nan)
        np.testing.assert_array_equal(C_b_G, expected)
    assert np.isfinite(found).all((1, 2)).sum() > 100
