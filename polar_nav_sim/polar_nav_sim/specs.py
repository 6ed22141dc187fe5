"""Sections of a mission file, checked: one dataclass each, limits beside each default.

A mission file is a mapping with ``path`` (its ``kind`` picks one of :data:`PATHS`), ``vehicles``
and a few numbers for the whole mission. Angles are in degrees there, as the files
are written by hand; they are radians everywhere else.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, flag, param, text, vector

from .dynamics_spec import DynamicsSpec
from .section import Spec

_VEHICLE_NAME = re.compile(r'[a-z][a-z0-9_]*')


@dataclass(frozen=True)
class PathSpec(Spec):
    """A path that starts at a stated place with a stated course."""

    latitude_deg: float = param(80.0, 'deg', -90.0, 90.0, 'Geodetic latitude of the start')
    longitude_deg: float = param(
        120.0, 'deg', -180.0, 360.0, 'Longitude of the start; at a pole it only orients true north'
    )
    course_deg: float = param(0.0, 'deg', -360.0, 360.0, 'Initial course, clockwise from north')
    course_north: str = choice('true', ('true', 'grid'), 'Which north the course counts from')
    speed_mps: float = param(3.0, 'm/s', 0.05, 20.0, 'Speed over ground along the path')


@dataclass(frozen=True)
class StraightSpec(PathSpec):
    """Constant velocity in grid axes."""


@dataclass(frozen=True)
class LegsSpec(PathSpec):
    """Straight legs joined by two quarter turns each; a quarter turn has a smooth course rate."""

    leg_m: float = param(300.0, 'm', 1.0, 1e6, 'Straight part of a leg')
    spacing_m: float = param(200.0, 'm', 1.0, 1e5, 'Distance between neighbouring legs')
    turn_radius_m: float = param(40.0, 'm', 1.0, 1e4, 'Smallest radius of curvature in a turn')
    first_turn: str = choice('left', ('left', 'right'), 'Side of the first turn')


@dataclass(frozen=True)
class RacetrackSpec(LegsSpec):
    """All turns to the same side: round and round."""


@dataclass(frozen=True)
class LawnmowerSpec(LegsSpec):
    """Turns to alternate sides: legs side by side."""


@dataclass(frozen=True)
class DiveSpec(PathSpec):
    """Straight course with dives and returns, at constant speed along the path."""

    dive_m: float = param(60.0, 'm', 0.1, 5000.0, 'Change of depth in a dive')
    dive_angle_deg: float = param(12.0, 'deg', 0.1, 60.0, 'Steepest flight path angle')
    transition_s: float = param(8.0, 's', 1.0, 300.0, 'Time to change from level to the angle')
    level_s: float = param(60.0, 's', 0.0, 1e5, 'Level flight before and after each change')


@dataclass(frozen=True)
class TrackSpec(Spec):
    """Along the shape of a recorded track, smoothed: at the mission's speed, or as recorded."""

    csv: str = text('', 'CSV with columns datetime, latitude, longitude (UTC, degrees)')
    speed_mps: float = param(3.0, 'm/s', 0.05, 20.0, 'Speed over ground along the path')
    first_utc: str = text('', 'First fix to use, UTC; empty: the first of the file')
    last_utc: str = text('', 'Last fix to use, UTC; empty: the last of the file')
    nearest_pole: bool = flag(False, 'Sail the part around the fix that is nearest to a pole')
    reverse: bool = flag(False, 'Sail it against the order of time')
    smoothing_m: float = param(
        60.0, 'm', 0.0, 1e5, 'RMS distance that the smooth path may keep from the fixes'
    )
    max_lateral_acceleration: float = param(
        0.1, 'm/s^2', 1e-4, 10.0, 'Refuse a path whose curvature needs more at mission speed'
    )
    as_recorded: bool = flag(
        False, "Follow the track's own stamps; speed_mps and reverse do not count then"
    )
    max_gap_s: float = param(
        10800.0, 's', 0.1, 1e6, 'Refuse a longer time without a fix (as_recorded)'
    )


PATHS: Mapping[str, type[PathSpec] | type[TrackSpec]] = {
    'straight': StraightSpec,
    'racetrack': RacetrackSpec,
    'lawnmower': LawnmowerSpec,
    'dive': DiveSpec,
    'track': TrackSpec,
}


@dataclass(frozen=True)
class SineSpec(Spec):
    """amplitude sin(2 pi t / period + phase), added to one attitude angle."""

    amplitude_deg: float = param(0.0, 'deg', 0.0, 30.0, 'Amplitude')
    period_s: float = param(5.0, 's', 0.1, 1e4, 'Period')
    phase_deg: float = param(0.0, 'deg', -360.0, 360.0, 'Phase at the start of the mission')


@dataclass(frozen=True)
class OscillationSpec:
    """Attitude oscillation; defaults are those of polar-cooperative navigation, section 6.1."""

    pitch: SineSpec = SineSpec(4.0, 3.0)
    roll: SineSpec = SineSpec(5.0, 5.0)
    yaw: SineSpec = SineSpec(3.0, 7.0)


@dataclass(frozen=True)
class VehicleSpec(Spec):
    """One vehicle of the formation."""

    role: str = choice('follower', ('leader', 'follower'), 'leader: carries the USBL array')
    depth_m: float = param(100.0, 'm', 0.0, 11000.0, 'Depth at the start, positive down')
    offset_m: tuple[float, float] = vector(
        (0.0, 0.0),
        'm',
        -1e5,
        1e5,
        'Start relative to the path: [ahead, port] or [grid east, north]',
    )
    offset_frame: str = choice('course', ('course', 'grid'), 'Axes of offset_m')
    fixed: bool = flag(False, 'Stays where it starts, level, and does not oscillate')
    fixed_psi_deg: float = param(
        0.0, 'deg', -360.0, 360.0, 'Its heading then, counter-clockwise from grid east'
    )
    floor_lost_s: tuple[float, float] = vector(
        (0.0, 0.0),
        's',
        0.0,
        7 * 86400.0,
        'From when to when the sea floor under it is out of reach',
    )
    clock_offset_s: float = param(
        0.0, 's', -60.0, 60.0, 'Its clock is later than the truth by this at the start'
    )
    clock_drift_ppm: float = param(
        0.0, '1e-6', -1000.0, 1000.0, 'And by so many microseconds more every second'
    )
    sources: str = text(
        '',
        'Mapping file that its follower navigates by, beside the mission; empty: the topics of '
        'this project, and the packets of the leader',
    )
    dynamics: DynamicsSpec | None = field(default=None)
    instruments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MissionSpec(Spec):
    """Numbers that hold for the whole mission."""

    LEAST_RATE_HZ: ClassVar[float] = 10.0
    DEEP_M: ClassVar[float] = 500.0
    """A floor below this is out of reach of every DVL near the surface."""

    duration_s: float = param(600.0, 's', 1.0, 7 * 86400.0, 'Length of the mission')
    imu_rate_hz: float = param(100.0, 'Hz', LEAST_RATE_HZ, 1000.0, 'Rate of truth and IMU')
    sea_surface_height_m: float = param(
        0.0, 'm', -200.0, 200.0, 'Sea surface above the ellipsoid: height = this - depth'
    )
    sea_floor_depth_m: float = param(
        0.0, 'm', 0.0, 12000.0, 'Depth of the sea floor; 0: unknown, altitude is then NaN'
    )
    bottom_lock: str = choice(
        'range',
        ('range', 'assumed'),
        'A DVL has the floor within its range only; or also one over 500 m deep: altitude is NaN',
    )
    sound_speed: float = param(
        0.0, 'm/s', 0.0, 1700.0, 'Sound speed, the same everywhere; 0: that of each node'
    )
    sound_speed_profile: str = text(
        '', 'CSV with columns depth_m and sound_speed_mps, beside the mission or in the data'
    )


def check_vehicles(vehicles: Mapping[str, VehicleSpec], where: str) -> None:
    """Names must make ROS namespaces, and one vehicle leads who does not navigate by `sources`.

    Raises
    ------
    ConfigError
        Naming the vehicle.
    """
    for name in vehicles:
        if not _VEHICLE_NAME.fullmatch(name):
            raise ConfigError(
                f'{where}: vehicle name {name!r} cannot be a namespace; use a-z, 0-9 and _'
            )
    leaders = [name for name, v in vehicles.items() if v.role == 'leader']
    alone = not leaders and all(v.sources for v in vehicles.values())
    if len(leaders) != 1 and not alone:
        raise ConfigError(
            f'{where}: one vehicle must have role leader, found {leaders}; only vehicles with '
            'sources need none'
        )
