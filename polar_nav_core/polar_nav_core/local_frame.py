"""Local map frame about an origin, and a dead-reckoned frame `odom` in it (REP-105).

The map is the plane that touches the ellipsoid at the origin; its axes are grid east and north, or
true east and north, and up there. Nothing switches between the two by latitude. The plane leaves
the surface by distance^2 / (2 R): 2 m at 5 km, so that z is no depth.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from . import earth, grid
from .arrays import Array
from .errors import ConfigError
from .kernels.sins import odometry, present
from .kernels.sins.present_covariance import STATES
from .user_files import parse_yaml, read_text

AXES = ('grid', 'enu')
NEAREST_POLE_M = 1000.0
"""Where true north turns by 57 deg per km across the meridian, `enu` is refused."""
_NUMBERS = {'latitude_deg': 90.0, 'longitude_deg': 360.0, 'height_m': 12000.0}


class LocalFrame:
    """Origin and axes of a map.

    Parameters
    ----------
    r_e : (3,) array
        Origin, ECEF [m].
    axes : str
        One of `AXES`.

    Raises
    ------
    ConfigError
        For true axes within `NEAREST_POLE_M` of a pole.
    """

    def __init__(self, r_e: Array, axes: str) -> None:
        self.r_e = np.array(r_e, dtype=np.float64)
        self.axes = axes
        self.C_e_m = np.ascontiguousarray(grid.ecef_to_grid(self.r_e))
        if axes == 'enu':
            away = math.hypot(self.r_e[0], self.r_e[1])
            if away < NEAREST_POLE_M:
                raise ConfigError(
                    f'the origin of the map is {away:.0f} m from a pole, where east and north '
                    f'turn within metres: map_axes enu needs {NEAREST_POLE_M:.0f} m, grid works '
                    'everywhere'
                )
            east = np.array([-self.r_e[1], self.r_e[0], 0.0]) / away
            up = self.C_e_m[2]
            self.C_e_m = np.array([east, np.cross(up, east), up])

    def position(self, r_e: Array) -> Array:
        """Map coordinates (3,) of an ECEF position [m]."""
        moved: Array = self.C_e_m @ (r_e - self.r_e)
        return moved

    def pose(self, values: Array) -> tuple[Array, Array, Array]:
        """Position (3,) [m], attitude C_b_m (3, 3) and way (3,) [m] in the map.

        ``values`` are those of an `engine.now.Now`.
        """
        r_m, C_b_m, moved_m = np.empty(3), np.empty((3, 3)), np.empty(3)
        odometry.to_map(self.C_e_m, self.r_e, values, r_m, C_b_m, moved_m)
        return r_m, C_b_m, moved_m

    def as_yaml(self) -> str:
        """Text of a file that `frame_of_yaml` reads."""
        lat, lon, height = earth.geodetic_from_ecef(self.r_e)
        return (
            f'latitude_deg: {math.degrees(lat)!r}\nlongitude_deg: {math.degrees(lon)!r}\n'
            f'height_m: {float(height)!r}\naxes: {self.axes}\n'
        )


def frame_of_file(path: Path) -> LocalFrame:
    """Map frame of a YAML file, as `frame_of_yaml`."""
    return frame_of_yaml(read_text(path), str(path))


def frame_of_yaml(text: str, path: str = 'nav/origin') -> LocalFrame:
    """Map frame of a YAML text with `latitude_deg`, `longitude_deg`, `height_m` and `axes`.

    Parameters
    ----------
    text : str
    path : str
        Where it comes from.

    Raises
    ------
    ConfigError
        Naming the file and what is wrong in it.
    """
    content: Any = parse_yaml(text, path)
    names = (*_NUMBERS, 'axes')
    if not isinstance(content, dict) or set(content) != set(names):
        raise ConfigError(f'{path}: an origin has {", ".join(names)}, all of them, and no more')
    values = []
    for name, most in _NUMBERS.items():
        value = content[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
            raise ConfigError(f'{path}: {name} is {value!r}, not a number within +-{most:g}')
        values.append(float(value))
    if content['axes'] not in AXES:
        raise ConfigError(f'{path}: axes is {content["axes"]!r}, none of {", ".join(AXES)}')
    lat, lon = np.radians(values[:2])
    try:
        return LocalFrame(earth.ecef_from_geodetic(lat, lon, values[2]), content['axes'])
    except (ConfigError, ValueError) as error:
        raise ConfigError(f'{path}: {error}') from error


class DeadReckoning:
    """Pose of the vehicle in `odom`, and of `odom` in the map.

    The two frames differ by a place and a turn about up. What corrections do to position and
    heading moves `odom` in the map; tilt, which the vertical always shows, stays in the pose.
    """

    def __init__(self) -> None:
        self.position = np.zeros(3)
        self.C_b_o = np.eye(3)
        self.C_o_m = np.eye(3)
        self.origin = np.zeros(3)
        self._last = np.eye(3)
        self._turn = np.zeros(1)
        self._begun = False

    def move(self, r_m: Array, C_b_m: Array, moved_m: Array, C_turn_b: Array) -> None:
        """Move the vehicle on; the arrays here change in place.

        Parameters
        ----------
        r_m, C_b_m : (3,), (3, 3) arrays
            Pose in the map [m], all corrections in it.
        moved_m : (3,) array
            Way since the call before without corrections, map axes [m].
        C_turn_b : (3, 3) array
            Rotation since then without corrections, body axes of now to those of then.
        """
        to, of = (self.position, self.C_b_o), (self.origin, self.C_o_m)
        turned = self._last, self._turn
        odometry.move_on(r_m, C_b_m, moved_m, C_turn_b, self._begun, *to, *of, *turned)
        self._begun = True


def warm_up() -> None:
    """Compile or load the kernels of local frames."""
    frame = LocalFrame(np.array([0.0, 0.0, 6356752.0]), 'grid')
    now, w = np.zeros(present.VALUES), present.make_scratch()
    r_m, C_b_m, moved_m = frame.pose(now)
    DeadReckoning().move(r_m, C_b_m, moved_m, np.eye(3))
    numbers = np.empty(odometry.NUMBERS)
    odometry.pose_and_twist(r_m, C_b_m, frame.C_e_m, now, np.eye(STATES), 0.0, numbers, w)
