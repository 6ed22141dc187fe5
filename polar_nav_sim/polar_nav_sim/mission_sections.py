"""Sections of a mission file as specs: vehicles, path, oscillation and start."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from polar_nav_core.errors import ConfigError

from .dynamics_spec import dynamics_of
from .installed import instruments_of
from .section import parse
from .specs import (
    PATHS,
    OscillationSpec,
    PathSpec,
    SineSpec,
    TrackSpec,
    VehicleSpec,
)

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_STAMP = EPOCH + timedelta(seconds=2**31 - 1)


def read_vehicle(values: object, where: str) -> VehicleSpec:
    """Vehicle of one entry of ``vehicles``; ``where`` names the entry in errors."""
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


def read_path(values: Mapping[str, Any], where: str) -> PathSpec | TrackSpec:
    """Path of section ``path``, by its kind."""
    kind = values.get('kind')
    if kind not in PATHS:
        raise ConfigError(f'{where}: kind {kind!r} is none of {", ".join(PATHS)}')
    spec = parse(PATHS[str(kind)], {k: v for k, v in values.items() if k != 'kind'}, where)
    if isinstance(spec, TrackSpec) and not spec.csv:
        raise ConfigError(f'{where}: a track needs csv')
    return spec


def read_oscillation(values: object, where: str) -> OscillationSpec:
    """Sines of section ``oscillation``; angles without an entry have none."""
    if not isinstance(values, Mapping):
        raise ConfigError(f'{where}: expected pitch, roll and yaw, found {values!r}')
    names = [f.name for f in dataclasses.fields(OscillationSpec)]
    unknown = sorted(set(values) - set(names))
    if unknown:
        raise ConfigError(f'{where}: unknown {unknown[0]!r}; it has {", ".join(names)}')
    return OscillationSpec(**{k: parse(SineSpec, v, f'{where}.{k}') for k, v in values.items()})


def read_start_time(value: object, file: Path) -> datetime:
    """Start of the mission, with its time zone (UTC where none is stated)."""
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value)
        except ValueError as error:
            raise ConfigError(f'{file}: start_time {value!r} is not an ISO time') from error
    if not isinstance(value, datetime):
        raise ConfigError(f'{file}: start_time {value!r} is not an ISO time')
    value = value if value.tzinfo else value.replace(tzinfo=UTC)
    if value < EPOCH:
        raise ConfigError(f'{file}: start_time {value.isoformat()} is before 1970')
    if value >= _LAST_STAMP:
        raise ConfigError(
            f'{file}: start_time {value.isoformat()} is after {_LAST_STAMP.isoformat()}, '
            'the last second that a stamp can hold'
        )
    return value
