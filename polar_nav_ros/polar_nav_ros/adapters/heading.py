"""Heading in the orientation of a sensor_msgs/Imu, for an alignment."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from polar_nav_core.attitude import matrix_from_quaternion
from polar_nav_core.engine.start.model import Heading

from .mapping import HeadingMapping

USUAL_SIGMA = math.radians(5.0)
"""1-sigma where neither mapping nor message states one [rad]."""
_UNKNOWN = -1.0
_UNIT = 0.01
_STEEP = math.cos(math.radians(75.0))
_NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def heading_of(
    message: Any,  # noqa: ANN401 - sensor_msgs/Imu, or what a bag's definitions make of it
    stamp_ns: int,
    mapping: HeadingMapping,
    topic: str,
) -> Heading | None:
    """Heading of body x in a sensor_msgs/Imu; None where it holds no attitude, or x is steep.

    Parameters
    ----------
    message : sensor_msgs/Imu
    stamp_ns : int
        Time of validity.
    mapping : HeadingMapping
    topic : str
    """
    q = getattr(message, 'orientation', None)
    if q is None or float(message.orientation_covariance[0]) == _UNKNOWN:
        return None
    xyzw = np.array([q.x, q.y, q.z, q.w])
    if not abs(float(xyzw @ xyzw) - 1.0) <= _UNIT:
        return None
    C_b_w = matrix_from_quaternion(xyzw) @ mapping.C_s_b.T
    if mapping.frame == 'ned':
        C_b_w = _NED_TO_ENU @ C_b_w
    east, north = float(C_b_w[0, 0]), float(C_b_w[1, 0])
    if math.hypot(east, north) < _STEEP:
        return None
    variance = float(message.orientation_covariance[8])
    sigma = math.sqrt(variance) if 0.0 < variance < math.inf else USUAL_SIGMA
    if mapping.sigma_deg is not None:
        sigma = math.radians(mapping.sigma_deg)
    return Heading(stamp_ns, math.atan2(east, north), sigma, mapping.reference, topic)
