"""The AHRS of a guessed mapping: whether an IMU's orientation is one, and of which axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from polar_nav_core.errors import PolarNavError
from polar_nav_core.nav_columns import rotations
from polar_nav_ros.adapters.arrays import finite_rows
from polar_nav_ros.adapters.headings import with_orientation
from polar_nav_ros.adapters.layouts import HEADING
from polar_nav_ros.adapters.mapping import ImuMapping, Stream

from ..bags.reader import Topic
from .guess_imu import axes_of, rotation_by
from .lines import Lines
from .mounting import Mount
from .read import read_imu, read_rows
from .sources import Source

_LEVEL = 0.98
"""Share of the specific force along the vertical of an orientation that is one (11 degrees)."""
_UP = {'enu': 'up', 'ned': 'down'}


class Attitude(NamedTuple):
    """Axes of an IMU's orientation.

    Attributes
    ----------
    world : str
        ``enu`` or ``ned``.
    axes : str
        Of the vehicle, as a mapping states them: by the transforms, or as gravity shows them in
        the IMU's forces.
    """

    world: str
    axes: str


def attitude_of(source: Source, imu: Topic | None, mount: Mount | None = None) -> Attitude | None:
    """Return the axes of an IMU's orientation; None where it is no attitude.

    The specific force, turned by an attitude, points up: along +z of ``enu``, -z of ``ned``. A
    quaternion that never changes, or that gravity contradicts, is none.

    Parameters
    ----------
    source : Source
    imu : Topic or None
    mount : Mount, optional
        Of the IMU.
    """
    if imu is None or imu.type not in HEADING:
        return None
    stream = Stream(imu.name)
    try:
        rows = read_rows(source, stream, 'heading')
        f_s = read_imu(source, ImuMapping(stream, np.eye(3), 1.0, 1.0)).f_b
    except PolarNavError:
        return None
    xyzw = rows.floats('attitude')
    if xyzw is None:
        return None
    good = with_orientation(rows, xyzw) & finite_rows(f_s)
    if good.sum() < 2 or not np.ptp(xyzw[good], axis=0).any():
        return None
    mean = np.einsum('nij,nj->ni', rotations(xyzw[good]), f_s[good]).mean(axis=0)
    share = float(mean[2] / max(float(np.linalg.norm(mean)), 1e-12))
    if abs(share) < _LEVEL:
        return None
    axes = rotation_by(mount, f_s[good]) or axes_of(f_s[good])[0]
    return Attitude('enu' if share > 0.0 else 'ned', axes)


def put_heading(out: Lines, imu: Topic, found: Attitude, times: str) -> None:
    """Write the section ``heading`` of an IMU's own orientation.

    Parameters
    ----------
    out : Lines
    imu : Topic
    found : Attitude
    times : str
        Line that says which times the IMU has: the heading has the same; empty for its stamps.
    """
    out.say(f'orientation of {imu.name}: by gravity, z of its world is {_UP[found.world]}')
    out.put('heading:')
    out.put(f'topic: {imu.name}', 2)
    out.put(f'type: {imu.type}', 2)
    if times:
        out.put(times, 2)
    out.say('axes of the vehicle, as of imu', 2)
    out.put(f'rotation: {found.axes}', 2)
    out.put(f'world: {found.world}', 2)
    out.say('FILL IN what it counts from: magnetic, true, grid, or arbitrary (without a', 2)
    out.say('magnetometer). With magnetic, too: what the driver has added already', 2)
    out.put('reference: FILL_IN', 2)
    out.say('declination_applied_deg: 0.0', 2)
    out.say('bias_sigma_deg: 4.5   # of its slow error: iron, currents, mounting', 2)
    out.put()
