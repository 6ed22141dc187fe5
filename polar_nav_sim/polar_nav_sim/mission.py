"""Missions: a YAML file becomes the exact truth of each vehicle.

``load_mission('demo')`` or ``load_mission('my_mission.yaml')``; the keys are those of the
dataclasses in :mod:`polar_nav_sim.specs`, and a mistake is answered with the file, the section and
the key.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import parse_yaml, read_yaml

from .dynamics.truth import DynamicTruth
from .dynamics_spec import dynamics_of
from .environment import Environment, Geoid, GeoidSpec, Gravity, GravitySpec
from .installed import Installed, instruments_of
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
    PATHS,
    MissionSpec,
    OscillationSpec,
    PathSpec,
    SineSpec,
    TrackSpec,
    VehicleSpec,
    check_vehicles,
)
from .trajectory import NS, Trajectory, Truth

DEFAULT_START = datetime(2026, 3, 1, tzinfo=UTC)
_SECTIONS = ('description', 'start_time', 'path', 'oscillation', 'gravity', 'geoid', 'vehicles')
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_STAMP = _EPOCH + timedelta(seconds=2**31 - 1)
_MARGIN_S = MARGIN * SPACING_S


@dataclass(frozen=True)
class Mission:
    """A mission as its file describes it; the truth of a vehicle is made when first asked for.

    Attributes
    ----------
    name, description : str
        File name without its ending; what the file says it is.
    file : Path
        Where it was read.
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
        How the sea surface differs from ``sea_surface_height_m``, which the vehicles are told.
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
        return (self.leader, *self.followers)

    @property
    def leader(self) -> str:
        """Name of the vehicle that carries the USBL array."""
        return next(name for name, v in self.formation.items() if v.role == 'leader')

    @property
    def followers(self) -> tuple[str, ...]:
        """Names of the other vehicles, in the order of the file."""
        return tuple(name for name, v in self.formation.items() if v.role != 'leader')

    @property
    def duration_s(self) -> float:
        """Length [s]."""
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
        """How fast sound is, as the file says it; None where it says nothing.

        Raises
        ------
        ConfigError
            When there is no such profile.
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

    def instruments(self, vehicle: str) -> Mapping[str, Installed]:
        """Instruments of a vehicle that the file names, by kind: imu, dvl, depth, usbl, heading.

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
        """Make the same mission with another length."""
        return self.with_overrides({'duration_s': float(duration_s)})

    def with_overrides(self, overrides: Mapping[str, Any]) -> Mission:
        """Make the same mission with other values, e.g. ``{'vehicles.follower.depth_m': 50.0}``.

        Raises
        ------
        ConfigError
            For a key or value that the file could not have either.
        """
        document = copy.deepcopy(dict(self.document))
        for dotted, value in overrides.items():
            section = document
            *parents, last = dotted.split('.')
            for key in parents:
                section = section.setdefault(key, {})
                if not isinstance(section, dict):
                    raise ConfigError(f'{self.file}: {dotted}: {key} is not a section')
            section[last] = value
        return mission_from(document, self.file)

    def _make(self, vehicle: VehicleSpec) -> Truth:
        surface, floor = self.numbers.sea_surface_height_m, self.numbers.sea_floor_depth_m
        assumed = self.numbers.bottom_lock == 'assumed' and floor > MissionSpec.DEEP_M
        known = floor > 0.0 and not assumed
        depths = (
            surface,
            floor if known else math.nan,
            vehicle.floor_lost_s,
            self._environment,
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
                    *depths,
                )
            still = still_knots(
                start_e, math.radians(vehicle.fixed_psi_deg), knot_times(self.duration_s)
            )
            none = SineSpec()
            calm = OscillationSpec(none, none, none)
            return Trajectory(still, calm, self.start_ns, self.imu_period_ns, *depths)
        return Trajectory(
            self._knots(vehicle), self.oscillation, self.start_ns, self.imu_period_ns, *depths
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
    """Read a mission: a file, or the name of one that comes with the package.

    Raises
    ------
    ConfigError
        Naming the file and what is wrong in it.
    """
    file = find_mission(name_or_path)
    return mission_from(read_yaml(file), file)


def overrides_from(texts: Sequence[str]) -> dict[str, Any]:
    """Read overrides from texts like ``path.speed_mps=2.0``.

    Raises
    ------
    ConfigError
        Naming the text.
    """
    out: dict[str, Any] = {}
    for text in texts:
        key, sign, value = text.partition('=')
        if not sign or not key.strip():
            raise ConfigError(f'override {text!r} is not of the form key=value')
        out[key.strip()] = parse_yaml(value, f'override {text!r}')
    return out


def mission_from(document: object, file: Path) -> Mission:
    """Make a mission from a file's content.

    Raises
    ------
    ConfigError
        Naming the file, the section and the key.
    """
    if not isinstance(document, Mapping):
        raise ConfigError(f'{file}: expected a mapping with path and vehicles')
    for section in ('path', 'vehicles'):
        if not isinstance(document.get(section), Mapping):
            raise ConfigError(f'{file}: no section {section!r}')
    numbers = {k: v for k, v in document.items() if k not in _SECTIONS}
    vehicles = {
        str(name): _vehicle(values or {}, f'{file}: vehicles.{name}')
        for name, values in document['vehicles'].items()
    }
    check_vehicles(vehicles, f'{file}')
    spec = parse(MissionSpec, numbers, f'{file}')
    if abs(NS / round(NS / spec.imu_rate_hz) - spec.imu_rate_hz) > 1e-9 * spec.imu_rate_hz:
        raise ConfigError(
            f'{file}: parameter imu_rate_hz: {spec.imu_rate_hz} Hz is no whole number of'
            ' nanoseconds'
        )
    path = _path(document['path'], f'{file}: path')
    plain = dict(document)
    if 'start_time' in document:
        start = _start_time(document['start_time'], file)
        plain['start_time'] = start.isoformat()
    elif isinstance(path, TrackSpec) and path.as_recorded:
        csv = find_data(path.csv, file)
        start_s = recorded_start_s(path, csv, spec.duration_s, 2.0 * _MARGIN_S)
        start = _EPOCH + timedelta(seconds=start_s)
    else:
        start = DEFAULT_START
    mission = Mission(
        name=file.stem,
        description=' '.join(str(document.get('description', '')).split()),
        file=file,
        document=plain,
        start_ns=(start - _EPOCH) // timedelta(microseconds=1) * 1000,
        numbers=spec,
        path=path,
        oscillation=_oscillation(document.get('oscillation') or {}, f'{file}: oscillation'),
        formation=vehicles,
        gravity=parse(GravitySpec, document.get('gravity') or {}, f'{file}: gravity'),
        geoid=parse(GeoidSpec, document.get('geoid') or {}, f'{file}: geoid'),
    )
    _check_water(mission)
    return mission


def _check_water(mission: Mission) -> None:
    """Refuse a profile that cannot be read now, not when a node asks for it."""
    try:
        if mission.water is not None:
            SoundSpeed.from_spec(mission.water)
    except ConfigError as error:
        raise ConfigError(f'{mission.file}: {error}') from error


def _vehicle(values: object, where: str) -> VehicleSpec:
    if not isinstance(values, Mapping):
        return parse(VehicleSpec, values, where)
    sections = ('dynamics', 'instruments')
    plain = parse(VehicleSpec, {k: v for k, v in values.items() if k not in sections}, where)
    if values.get('instruments') is not None:
        chosen = values['instruments']
        instruments_of(chosen, plain.role, 0.0, f'{where}.instruments')  # for its refusals
        plain = dataclasses.replace(plain, instruments=chosen)
    if 'dynamics' not in values:
        return plain
    dynamics = dynamics_of(values['dynamics'] or {}, f'{where}.dynamics')
    if plain.fixed:
        raise ConfigError(f'{where}: parameter fixed: a vehicle with dynamics moves')
    return dataclasses.replace(plain, dynamics=dynamics)


def _path(values: Mapping[str, Any], where: str) -> PathSpec | TrackSpec:
    kind = values.get('kind')
    if kind not in PATHS:
        raise ConfigError(f'{where}: kind {kind!r} is none of {", ".join(PATHS)}')
    spec = parse(PATHS[str(kind)], {k: v for k, v in values.items() if k != 'kind'}, where)
    if isinstance(spec, TrackSpec) and not spec.csv:
        raise ConfigError(f'{where}: a track needs csv')
    return spec


def _oscillation(values: object, where: str) -> OscillationSpec:
    if not isinstance(values, Mapping):
        raise ConfigError(f'{where}: expected pitch, roll and yaw, found {values!r}')
    names = [f.name for f in dataclasses.fields(OscillationSpec)]
    unknown = sorted(set(values) - set(names))
    if unknown:
        raise ConfigError(f'{where}: unknown {unknown[0]!r}; it has {", ".join(names)}')
    return OscillationSpec(**{k: parse(SineSpec, v, f'{where}.{k}') for k, v in values.items()})


def _start_time(value: object, file: Path) -> datetime:
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value)
        except ValueError as error:
            raise ConfigError(f'{file}: start_time {value!r} is not an ISO time') from error
    if not isinstance(value, datetime):
        raise ConfigError(f'{file}: start_time {value!r} is not an ISO time')
    value = value if value.tzinfo else value.replace(tzinfo=UTC)
    if value < _EPOCH:
        raise ConfigError(f'{file}: start_time {value.isoformat()} is before 1970')
    if value >= _LAST_STAMP:
        raise ConfigError(
            f'{file}: start_time {value.isoformat()} is after {_LAST_STAMP.isoformat()}, '
            'the last second that a stamp can hold'
        )
    return value
