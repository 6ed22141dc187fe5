"""Pose of a map or of the Earth, as RViz and robot_localization send it, in grid axes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from polar_nav_core.attitude import euler_from_matrix, matrix_from_quaternion
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.errors import PolarNavError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.kernels.limits import EARTH
from polar_nav_core.local_frame import LocalFrame

EARTH_FRAMES = ('earth', 'ecef')
_LEAST_HEIGHT = 1e-6
"""Variance of a height that says something: of a millimetre [m^2]."""
_LEAST_TILT = 1e-12
_LEANING = 2.5e-6
"""Share of a variance that comes into the vertical by axes 10 km away: (d / R)^2."""


class PoseError(PolarNavError, ValueError):
    """A pose from which no state can be made."""


class Pose(NamedTuple):
    """Pose of base_link with 1-sigma; SI units and radians.

    A sigma is None where the covariance is zero: RViz leaves height and tilt open like that.
    """

    latitude: float
    longitude: float
    height: float
    roll: float
    pitch: float
    grid_heading: float
    sigma_position: float
    sigma_height: float | None
    sigma_tilt: float | None
    sigma_heading: float


def pose_in_earth(message: Any, map_name: str, frame: LocalFrame | None) -> Pose:  # noqa: ANN401
    """Pose of a geometry_msgs/PoseWithCovarianceStamped.

    Parameters
    ----------
    message : PoseWithCovarianceStamped
        In the map or in ``earth``.
    map_name : str
        frame_id of the map.
    frame : LocalFrame or None
        None while the map has no origin.

    Raises
    ------
    PoseError
        When the frame is unknown, or a number no pose's.
    """
    name = message.header.frame_id
    at, q = message.pose.pose.position, message.pose.pose.orientation
    point = np.array([at.x, at.y, at.z])
    quaternion = np.array([q.x, q.y, q.z, q.w])
    P = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)
    if not (np.isfinite(point).all() and np.isfinite(quaternion).all() and np.isfinite(P).all()):
        raise PoseError('its numbers are not finite')
    if abs(float(quaternion @ quaternion) - 1.0) > 0.01:
        raise PoseError('its orientation is no unit quaternion')
    C_b = matrix_from_quaternion(quaternion)
    if name in EARTH_FRAMES:
        r_e, C_b_e, C_e_p = point, C_b, np.eye(3)
    elif map_name and name == map_name:
        if frame is None:
            raise PoseError(
                'the map has no origin before the first state: state origin_file, or send the '
                'pose in frame earth'
            )
        C_e_p = frame.C_e_m
        r_e, C_b_e = frame.r_e + C_e_p.T @ point, C_e_p.T @ C_b
    else:
        known = ', '.join(dict.fromkeys(f for f in (map_name, EARTH_FRAMES[0]) if f))
        raise PoseError(f'a pose must be in one of the frames {known}')
    if not EARTH[0] <= float(np.linalg.norm(r_e)) <= EARTH[1]:
        raise PoseError('its position is not on the Earth')
    C_e_G = ecef_to_grid(r_e)
    axes = C_e_G @ C_e_p.T
    position = axes @ P[:3, :3] @ axes.T
    turn = axes @ P[3:, 3:] @ axes.T
    psi, pitch, roll = (float(v) for v in euler_from_matrix(C_e_G @ C_b_e))
    across = max(float(position[0, 0]), float(position[1, 1]))
    if not (across > 0.0 and turn[2, 2] > 0.0):
        raise PoseError('its covariance states no variance of x, y and yaw')
    lat, lon, height = (float(v) for v in geodetic_from_ecef(r_e))
    return Pose(
        lat,
        lon,
        height,
        roll,
        pitch,
        math.remainder(0.5 * math.pi - psi, math.tau),
        math.sqrt(across),
        sigma_height(float(position[2, 2]), across),
        _sigma(
            max(float(turn[0, 0]), float(turn[1, 1])), _LEAST_TILT + _LEANING * float(turn[2, 2])
        ),
        min(math.sqrt(float(turn[2, 2])), math.pi),
    )


def sigma_height(variance: float, across: float) -> float | None:
    """Return the 1-sigma of a height [m]; None where the sender left it open.

    A variance of zero in a map is none in grid axes some way off: the map's vertical leans, and
    brings a little of the horizontal variance in.

    Parameters
    ----------
    variance : float
        Along the vertical, grid axes [m^2].
    across : float
        The larger one of the horizontal axes [m^2]; NaN where it is not known.
    """
    return _sigma(variance, _LEAST_HEIGHT + (_LEANING * across if across > 0.0 else 0.0))


def _sigma(variance: float, least: float) -> float | None:
    return math.sqrt(variance) if variance > least else None
