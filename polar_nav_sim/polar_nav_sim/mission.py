"""Missions: a YAML file becomes the exact truth of each vehicle.

``load_mission('demo')`` or ``load_mission('my_mission.yaml')``; the keys are those of the
dataclasses in :mod:`polar_nav_sim.specs`, and a mistake is answered with the file, the section and
the key.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_yaml

from .dynamics.truth import DynamicTruth
from .environment import Environment, Geoid, GeoidSpec, Gravity, GravitySpec
from .installed import Installed, instruments_of
from .mission_overrides import overridden
from .mission_sections import EPOCH, read_oscillation, read_path, read_start_time, read_vehicle
from .paths.knots import (
    MARGIN,
    SPACING_S,
    Knots,
    initial_psi,
    knot_times,
    knots_of_profile,
    knots_of_track,
    start_position,
    still_knots,
)
from .paths.profile import profile_of
from .paths.recorded import RecordedPath, recorded_start_s
from .paths.track import TrackPath
from .resources import find_data, find_mission
from .section import parse
from .sound_speed import SoundSpeed, WaterSpec
from .specs import (
    MissionSpec,
    OscillationSpec,
    PathSpec,
    SineSpec,
    TrackSpec,
    VehicleSpec,
    check_vehicles,
)
from .trajectory import NS, Surroundings, Trajectory, Truth

DEFAULT_START = datetime(2026, 3, 1, tzinfo=UTC)
_SECTIONS = ('description', 'start_time', 'path', 'oscillation', 'gravity', 'geoid', 'vehicles')
_MARGIN_S = MARGIN * SPACING_S


@dataclass(frozen=True)
class Mission:
    """A mission of a file; the truth of a vehicle is made at its first use.

    Attributes
    ----------
    name, description : str
        File name without its ending; description in the file.
    file : Path
        Path of the file.
    document : mapping
        The file's content, overrides included, in plain values.
    start_ns : int
        Stamp of sample 0 [ns since 1970, UTC]; of a track as recorded, a time of the track.
    numbers : MissionSpec
        Duration, rates, sea surface and floor.
    path : PathSpec or TrackSpec
        The path that offsets count from.
    oscillation : OscillationSpec
        Attitude oscillation of every vehicle.
    formation : mapping of str to VehicleSpec
        The vehicles, in the order of the file.
    gravity : GravitySpec
        How gravity differs from normal gravity.
    geoid : GeoidSpec
        Difference of the sea surface from ``sea_surface_height_m``, the vehicles' parameter.
    """

    name: str
    description: str
    file: Path
    document: Mapping[str, Any]
    start_ns: int
    numbers: MissionSpec
    path: PathSpec | TrackSpec
    oscillation: OscillationSpec
    formation: Mapping[str, VehicleSpec]
    gravity: GravitySpec = field(default_factory=GravitySpec)
    geoid: GeoidSpec = field(default_factory=GeoidSpec)
    _truth: dict[str, Truth] = field(default_factory=dict, repr=False, compare=False)

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names of all vehicles, leader first."""
        return (*self._leaders, *self.followers)

    @property
    def leader(self) -> str:
        """Name of the vehicle that carries the USBL array.

        Raises
        ------
        ConfigError
            When the mission has none.
        """
        if not self._leaders:
            raise ConfigError(f'mission {self.name} has no leader')
        return self._leaders[0]

    @property
    def led(self) -> bool:
        """Whether there is a leader; without one, vehicles navigate by their own `sources`."""
        return bool(self._leaders)

    @property
    def _leaders(self) -> tuple[str, ...]:
        return tuple(name for name, v in self.formation.items() if v.role == 'leader')

    @property
    def followers(self) -> tuple[str, ...]:
        """Names of the other vehicles, in the order of the file."""
        return tuple(name for name, v in self.formation.items() if v.role != 'leader')

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return self.numbers.duration_s

    @property
    def imu_period_ns(self) -> int:
        """Time between samples of truth and IMU [ns]."""
        return round(NS / self.numbers.imu_rate_hz)

    @property
    def sample_count(self) -> int:
        """Samples of truth per vehicle, the one at the start included."""
        return round(self.duration_s * NS) // self.imu_period_ns + 1

    @property
    def end_ns(self) -> int:
        """Stamp of the last sample [ns]."""
        return self.start_ns + (self.sample_count - 1) * self.imu_period_ns

    @property
    def water(self) -> WaterSpec | None:
        """Sound speed stated in the file; None if it states none.

        Raises
        ------
        ConfigError
            If the profile does not exist.
        """
        profile, speed = self.numbers.sound_speed_profile, self.numbers.sound_speed
        if profile:
            return WaterSpec(sound_speed_profile=str(find_data(profile, self.file)))
        return WaterSpec(sound_speed=speed) if speed > 0.0 else None

    def truth(self, vehicle: str) -> Truth:
        """Exact truth of one vehicle.

        Raises
        ------
        ConfigError
            When the mission has no such vehicle, or the path cannot be sailed.
        """
        if vehicle not in self.formation:
            known = ', '.join(self.vehicles)
            raise ConfigError(f'mission {self.name}: no vehicle {vehicle!r}; it has {known}')
        if vehicle not in self._truth:
            self._truth[vehicle] = self._make(self.formation[vehicle])
        return self._truth[vehicle]

    def sources(self, vehicle: str) -> Path | None:
        """Mapping file that a vehicle navigates by; None if the mission names none.

        Raises
        ------
        ConfigError
            When there is no such file.
        """
        name = self.formation[vehicle].sources
        return find_data(name, self.file).resolve() if name else None

    def instruments(self, vehicle: str) -> Mapping[str, Installed]:
        """Instruments of a vehicle in the file, by kind, as imu, dvl, ahrs.

        Raises
        ------
        ConfigError
            When the mission has no such vehicle.
        """
        latitude = float(self.truth(vehicle).state(self.start_ns).lat)
        spec = self.formation[vehicle]
        where = f'{self.file}: vehicles.{vehicle}.instruments'
        return instruments_of(spec.instruments, spec.role, latitude, where)

    @property
    def dynamic(self) -> tuple[str, ...]:
        """Names of the vehicles with dynamics."""
        return tuple(name for name in self.vehicles if self.formation[name].dynamics is not None)

    def dynamics(self, vehicle: str) -> DynamicTruth:
        """Truth of a vehicle with dynamics.

        Raises
        ------
        ConfigError
            When it has none.
        """
        truth = self.truth(vehicle)
        if not isinstance(truth, DynamicTruth):
            raise ConfigError(f'mission {self.name}: vehicle {vehicle!r} has no dynamics')
        return truth

    def with_duration(self, duration_s: float) -> Mission:
        """Return the same mission with another duration."""
        return self.with_overrides({'duration_s': float(duration_s)})

    def with_overrides(self, overrides: Mapping[str, Any]) -> Mission:
        """Return the same mission with other values, e.g. ``{'vehicles.follower.depth_m': 50.0}``.

        Raises
        ------
        ConfigError
            For a key or value that the file could not have either.
        """
        return mission_from(overridden(self.document, overrides, self.file), self.file)

    def _make(self, vehicle: VehicleSpec) -> Truth:
        surface, floor = self.numbers.sea_surface_height_m, self.numbers.sea_floor_depth_m
        assumed = self.numbers.bottom_lock == 'assumed' and floor > MissionSpec.DEEP_M
        known = floor > 0.0 and not assumed
        surroundings = Surroundings(
            surface, floor if known else math.nan, vehicle.floor_lost_s, self._environment
        )
        if vehicle.fixed or vehicle.dynamics is not None:
            if isinstance(self.path, TrackSpec):
                raise ConfigError(
                    f'{self.file}: a fixed vehicle or one with dynamics needs a path with a place;'
                    ' a track has none'
                )
            psi = initial_psi(self.path)
            start_e = start_position(self.path, vehicle, psi, surface)
            if vehicle.dynamics is not None:
                return DynamicTruth(
                    vehicle.dynamics,
                    start_position(self.path, VehicleSpec(depth_m=0.0), psi, surface),
                    start_e,
                    self.start_ns,
                    self.imu_period_ns,
                    self.end_ns,
                    surroundings,
                )
            still = still_knots(
                start_e, math.radians(vehicle.fixed_psi_deg), knot_times(self.duration_s)
            )
            none = SineSpec()
            calm = OscillationSpec(none, none, none)
            return Trajectory(still, calm, self.start_ns, self.imu_period_ns, surroundings)
        return Trajectory(
            self._knots(vehicle), self.oscillation, self.start_ns, self.imu_period_ns, surroundings
        )

    def _knots(self, vehicle: VehicleSpec) -> Knots:
        t_s = knot_times(self.duration_s)
        surface = self.numbers.sea_surface_height_m
        if isinstance(self.path, TrackSpec):
            return knots_of_track(self._track, self.path, vehicle, surface, t_s)
        psi = initial_psi(self.path)
        start_e = start_position(self.path, vehicle, psi, surface)
        profile = profile_of(self.path, float(t_s[-1]), f'{self.file}: path')
        return knots_of_profile(profile, start_e, psi, t_s)

    @cached_property
    def _environment(self) -> Environment:
        normal, flat = self.gravity.is_normal, self.geoid.is_flat
        if normal and flat:
            return Environment()
        # One plane for all vehicles: they meet the same field at the same place.
        if isinstance(self.path, TrackSpec):
            origin_e = self._track.sail(0.0, np.zeros(1))[0]
        else:
            origin_e = start_position(
                self.path, VehicleSpec(depth_m=0.0), initial_psi(self.path), 0.0
            )
        return Environment(
            gravity=None if normal else Gravity(self.gravity, origin_e),
            geoid=None if flat else Geoid(self.geoid, origin_e),
        )

    @cached_property
    def _track(self) -> TrackPath | RecordedPath:
        if not isinstance(self.path, TrackSpec):
            raise TypeError(f'mission {self.name} has no track')
        t_s = knot_times(self.duration_s)
        csv = find_data(self.path.csv, self.file)
        if self.path.as_recorded:
            return RecordedPath(self.path, csv, self.start_ns / NS, _MARGIN_S, float(t_s[-1]))
        return TrackPath(self.path, csv, _MARGIN_S, float(t_s[-1]))


def load_mission(name_or_path: str | Path) -> Mission:
    """Mission of a file, or of the name of one in the package.

    Raises
    ------
    ConfigError
        Naming the file and what is wrong in it.
    """
    file = find_mission(name_or_path)
    return mission_from(read_yaml(file), file)


def mission_from(document: object, file: Path) -> Mission:
    """Mission from a file's content.

    Raises
    ------
    ConfigError
        Naming the file, the section and the key.
    """
    if not isinstance(document, Mapping):
        raise ConfigError(f'{file}: expected a mapping with path and vehicles')
    for section in ('path', 'vehicles'):
        if not isinstance(document.get(section), Mapping):
            mapped = '; it looks like a mapping file, which a follower takes as `sources`'
            raise ConfigError(
                f'{file}: no section {section!r}' + (mapped if 'imu' in document else '')
            )
    numbers = {k: v for k, v in document.items() if k not in _SECTIONS}
    vehicles = {
        str(name): read_vehicle(values or {}, f'{file}: vehicles.{name}')
        for name, values in document['vehicles'].items()
    }
    check_vehicles(vehicles, f'{file}')
    spec = parse(MissionSpec, numbers, f'{file}')
    if abs(NS / round(NS / spec.imu_rate_hz) - spec.imu_rate_hz) > 1e-9 * spec.imu_rate_hz:
        raise ConfigError(
            f'{file}: parameter imu_rate_hz: {spec.imu_rate_hz} Hz is no whole number of'
            ' nanoseconds'
        )
    path = read_path(document['path'], f'{file}: path')
    plain = dict(document)
    if 'start_time' in document:
        start = read_start_time(document['start_time'], file)
        plain['start_time'] = start.isoformat()
    elif isinstance(path, TrackSpec) and path.as_recorded:
        csv = find_data(path.csv, file)
        start_s = recorded_start_s(path, csv, spec.duration_s, 2.0 * _MARGIN_S)
        start = EPOCH + timedelta(seconds=start_s)
    else:
        start = DEFAULT_START
    mission = Mission(
        name=file.stem,
        description=' '.join(str(document.get('description', '')).split()),
        file=file,
        document=plain,
        start_ns=(start - EPOCH) // timedelta(microseconds=1) * 1000,
        numbers=spec,
        path=path,
        oscillation=read_oscillation(document.get('oscillation') or {}, f'{file}: oscillation'),
        formation=vehicles,
        gravity=parse(GravitySpec, document.get('gravity') or {}, f'{file}: gravity'),
        geoid=parse(GeoidSpec, document.get('geoid') or {}, f'{file}: geoid'),
    )
    _check_water(mission)
    for name in mission.vehicles:
        mission.sources(name)  # for its refusal
    return mission


def _check_water(mission: Mission) -> None:
    """Raise ConfigError now for a profile that cannot be read, not at its use in a node."""
    try:
        if mission.water is not None:
            SoundSpeed.from_spec(mission.water)
    except ConfigError as error:
        raise ConfigError(f'{mission.file}: {error}') from error
