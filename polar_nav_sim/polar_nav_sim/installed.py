"""Instruments of a vehicle by its mission: presets with the mission's changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import names_near, to_mapping

from .section import Spec, parse
from .sensors import instruments
from .sensors.absolute import AbsoluteErrors
from .sensors.compass import CompassErrors
from .sensors.depth import DepthErrors
from .sensors.dvl import DvlErrors
from .sensors.imu import ImuErrors
from .sensors.presets import Preset
from .sensors.reference import ReferenceErrors
from .sensors.usbl import UsblErrors

_KINDS: Mapping[str, tuple[type[Spec], Mapping[str, Preset[Any]]]] = {
    'imu': (ImuErrors, instruments.IMU),
    'dvl': (DvlErrors, instruments.DVL),
    'depth': (DepthErrors, instruments.DEPTH),
    'ahrs': (CompassErrors, instruments.AHRS),
    'absolute': (AbsoluteErrors, instruments.ABSOLUTE),
    'usbl': (UsblErrors, instruments.USBL),
    'heading': (ReferenceErrors, instruments.HEADING),
}
_OF_A_LEADER = ('usbl', 'heading')


@dataclass(frozen=True)
class Installed:
    """One instrument: its errors, and samples per second if preset or file state them."""

    errors: Spec
    rate_hz: float | None = None


def instruments_of(
    values: object, role: str, latitude: float, where: str
) -> Mapping[str, Installed]:
    """Instruments of a vehicle, by kind.

    Parameters
    ----------
    values : object
        Section of the file: per kind a preset's name, or a mapping with ``preset`` (optional),
        ``rate_hz`` (optional) and parameters of the error model.
    role : str
        Role of the vehicle.
    latitude : float
        Latitude of its start [rad]: a gyrocompass is worse nearer to a pole.
    where : str
        File and section, for messages.

    Raises
    ------
    ConfigError
        For an unknown preset, kind or parameter, which the text names.
    """
    if not isinstance(values, Mapping):
        raise ConfigError(f'{where}: expected instruments by kind, found {values!r}')
    out = {}
    for kind, chosen in values.items():
        if kind not in _KINDS:
            raise ConfigError(f'{where}: unknown {str(kind)!r}; {names_near(str(kind), _KINDS)}')
        if kind in _OF_A_LEADER and role != 'leader':
            raise ConfigError(f'{where}: {kind}: only a leader has one')
        out[str(kind)] = _installed(str(kind), chosen, latitude, f'{where}.{kind}')
    return out


def _installed(kind: str, chosen: object, latitude: float, where: str) -> Installed:
    cls, named = _KINDS[kind]
    given = {'preset': chosen} if isinstance(chosen, str) else chosen
    if not isinstance(given, Mapping):
        raise ConfigError(f'{where}: expected a preset or a mapping, found {chosen!r}')
    changes = {str(k): v for k, v in given.items() if k not in ('preset', 'rate_hz')}
    errors, rate_hz = cls(), None
    if 'preset' in given:
        name = str(given['preset'])
        if name not in named:
            raise ConfigError(f'{where}: unknown preset {name!r}; there are {", ".join(named)}')
        preset = named[name]
        rate_hz = preset.rate_hz
        errors = preset.errors.at(latitude) if kind == 'heading' else preset.errors
    if 'rate_hz' in given:
        rate_hz = _rate(kind, given['rate_hz'], where)
    # Parsed with all the rest: a typo is answered as everywhere, a whole number may be a float.
    parsed = parse(cls, {**to_mapping(errors), **changes}, where)
    return Installed(parsed, rate_hz)


def _rate(kind: str, value: object, where: str) -> float:
    if kind not in ('dvl', 'depth', 'ahrs', 'heading'):
        raise ConfigError(f'{where}: rate_hz: the {kind} has none of its own')
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.1 <= value <= 50.0:
        raise ConfigError(f'{where}: rate_hz: {value!r} is outside of [0.1, 50] Hz')
    return float(value)
