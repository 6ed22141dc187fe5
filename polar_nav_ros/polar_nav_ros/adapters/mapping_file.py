"""Reads a mapping from YAML; every error names file, key, value and what would be right."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from polar_nav_core.depth import STANDARD_ATMOSPHERE
from polar_nav_core.dvl import SOUND_SPEED_LIMITS
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import unknown_parameter
from polar_nav_core.user_files import parse_yaml, read_text

from . import noise_classes, section
from .fix_section import fixes_of
from .heading_section import check_slow_errors, heading_of
from .mapping import (
    ACCEL_UNITS,
    GYRO_UNITS,
    LENGTH_UNITS,
    PRESSURE_UNITS,
    REFERENCES,
    SPEED_UNITS,
    VERSION,
    DepthMapping,
    DvlMapping,
    ImuMapping,
    InitialMapping,
    Mapping,
)
from .section import POINT, Section
from .stream_section import position_of, stream_of


def load(path: Path | str) -> Mapping:
    """Read a mapping file.

    Raises
    ------
    ConfigError
        Naming file, key, value and what would be right.
    """
    return from_section(section.load(Path(path)))


def read(path: Path) -> tuple[str, Mapping]:
    """Text of a mapping file, and what it says; errors as `load`."""
    text = read_text(path)
    return text, parse(text, str(path))


def parse(text: str, where: str) -> Mapping:
    """Read the text of a mapping file; errors as `load`, naming where it is from."""
    return from_section(Section(where, parse_yaml(text, where)))


def from_section(top: Section) -> Mapping:
    """Build a mapping of the top section of a file; errors as `load`."""
    version = top.number('version', 1.0, 1.0, 1e9, '')
    if version not in range(1, VERSION + 1):
        raise top.fail(
            'version', f'{version:g} is of a later polar_nav; this one reads 1 to {VERSION}'
        )
    imu = top.section('imu')
    if imu is None:
        raise top.fail('imu', 'is missing: without an IMU nothing can be integrated')
    params = _parameters(top)
    dvls, depths, truth = _several(top, 'dvl'), _several(top, 'depth'), top.section('truth')
    heading = top.section('heading')
    _lever(top, 'dvl', dvls, params)
    _lever(top, 'depth', depths, params)
    accept = top.raw('accept') or []
    if not isinstance(accept, list) or not all(isinstance(a, str) for a in accept):
        raise top.fail('accept', f'{accept!r} is not a list of names of findings')
    mapping = Mapping(
        place=top.place,
        vehicle=top.text('vehicle', 'follower'),
        imu=_imu(imu, params),
        dvls=tuple(_dvl(s) for s in dvls),
        depths=tuple(_depth(s) for s in depths),
        fixes=fixes_of(top, params, level=version > 1),
        initial=_initial(top.section('initial') or Section(f'{top.place}: initial', {})),
        truth=None if truth is None else position_of(truth),
        accept=tuple(accept),
        params=params,
        heading=None if heading is None else heading_of(heading, params),
    )
    if len({dvl.water for dvl in mapping.dvls}) > 1:
        raise top.fail(
            'dvl',
            'reference is not the same in all of them: a velocity through the water has the '
            'current in it, and the filter knows one noise of a DVL: map those of one reference',
        )
    if heading is not None:
        check_slow_errors(heading, mapping.fixes)
    noise = top.section('noise')
    if noise is not None:
        stated = _noise(noise, mapping.dvls, params)
        twice = sorted(set(stated) & set(top.texts('parameters')))
        if twice:
            raise top.fail('noise', f'{twice[0]} is stated among parameters, too')
        params.update(stated)
    top.done()
    return mapping


def _noise(s: Section, dvls: tuple[DvlMapping, ...], params: dict[str, Any]) -> dict[str, float]:
    """Noise by the classes of instruments; numbers that stand beside them win."""
    out: dict[str, float] = {}
    if 'imu' in s:
        name = s.choice('imu', noise_classes.IMU_CLASSES)
        out |= noise_classes.imu_noise(name)
        if params.get('heading_reference', 'none') != 'none':
            params.setdefault('heading_tilts', name in noise_classes.POOR_GYROS)
    if 'dvl' in s:
        name = s.choice('dvl', noise_classes.DVL_CLASSES)
        known = bool(dvls) and all(dvl.sound_speed > 0.0 for dvl in dvls)
        out |= noise_classes.dvl_noise(
            name,
            water=any(dvl.water for dvl in dvls),
            corrected=known and bool(params.get('water_sound_speed')),
        )
    for name in ('imu', 'dvl'):
        s.raw(name)
    for name in noise_classes.NAMES:
        value = s.optional(name, 0.0, 1e6, noise_classes.unit_of(name))
        if value is not None:
            out[name] = value
    s.done()
    return out


def _parameters(top: Section) -> dict[str, Any]:
    kinds = {f.name: f.metadata.get('kind') for f in fields(EngineParams)}
    out: dict[str, Any] = {}
    for name, value in top.texts('parameters').items():
        if name.isdigit():
            raise top.fail('parameters', f'{name} is no name{POINT}')
        if name not in kinds:
            raise top.fail('parameters', unknown_parameter(name, 'follower_node', kinds))
        out[name] = _typed(value, kinds[name])
    out.setdefault('configuration', 'default')
    return out


def _typed(value: Any, kind: str | None) -> Any:  # noqa: ANN401 - a value of YAML
    """Take whole numbers for floats: a person typed them; and 1e-3, a text to YAML."""
    if kind == 'float' and isinstance(value, int | str) and not isinstance(value, bool):
        try:
            return float(value)
        except ValueError:
            return value
    if kind == 'floats' and isinstance(value, list):
        return [_typed(v, 'float') for v in value]
    return value


def _imu(s: Section, params: dict[str, Any]) -> ImuMapping:
    if 'sample' in s:
        params['imu_sample'] = s.choice('sample', ('mean', 'instant'))
    s.raw('sample')
    mapping = ImuMapping(
        stream=stream_of(s),
        C_s_b=s.rotation(),
        gyro_scale=GYRO_UNITS[s.choice('gyro_unit', tuple(GYRO_UNITS), 'rad/s')],
        accel_scale=ACCEL_UNITS[s.choice('accel_unit', tuple(ACCEL_UNITS), 'm/s^2')],
        lever_b=s.numbers('lever_b', (0.0, 0.0, 0.0), -100.0, 100.0, 'm'),
    )
    s.done()
    return mapping


def _several(top: Section, key: str) -> list[Section]:
    """Sections of one sensor, or of a list of those that measure the same."""
    if isinstance(top.raw(key), list):
        return top.sections(key)
    one = top.section(key)
    return [] if one is None else [one]


def _lever(top: Section, key: str, sections: list[Section], params: dict[str, Any]) -> None:
    """Take the lever arm of a kind of sensor for the engine's parameter."""
    levers = [
        s.numbers('lever_b', None, -100.0, 100.0, 'm') if 'lever_b' in s else None
        for s in sections
    ]
    for s in sections:
        s.raw('lever_b')
    if len(set(levers)) > 1:
        raise top.fail(
            key,
            'lever_b is not the same in all of them; the filter knows one place of this sensor: '
            'state one for all where they sit together, or map one of them',
        )
    if levers and levers[0] is not None:
        params[f'{key}_lever_b'] = list(levers[0])


def _dvl(s: Section) -> DvlMapping:
    mapping = DvlMapping(
        stream=stream_of(s),
        C_s_b=s.rotation(),
        scale=SPEED_UNITS[s.choice('unit', tuple(SPEED_UNITS), 'm/s')],
        sigma=s.optional('sigma', 1e-6, 10.0, 'm/s'),
        water=s.choice('reference', REFERENCES, 'bottom') == 'water',
        sound_speed=s.optional('sound_speed', *SOUND_SPEED_LIMITS, 'm/s') or 0.0,
    )
    s.done()
    return mapping


def _depth(s: Section) -> DepthMapping:
    unit = None
    if 'unit' in s:
        unit = s.choice('unit', (*LENGTH_UNITS, *PRESSURE_UNITS))
    s.raw('unit')
    mapping = DepthMapping(
        stream=stream_of(s),
        unit=unit,
        sign=1.0 if s.choice('positive', ('down', 'up'), 'down') == 'down' else -1.0,
        sigma=s.optional('sigma', 1e-6, 100.0, 'm'),
        atmospheric_pressure=s.number(
            'atmospheric_pressure', STANDARD_ATMOSPHERE, 0.0, 120000.0, 'Pa'
        ),
        latitude_deg=s.optional('latitude_deg', -90.0, 90.0, 'deg'),
    )
    s.done()
    return mapping


def _initial(s: Section) -> InitialMapping:
    kind = s.choice('from', ('topic', 'values', 'alignment'), 'values')
    if kind == 'topic':
        s.text('topic')
    mapping = InitialMapping(
        kind=kind,
        position=position_of(s, finished=False) if 'topic' in s else None,
        heading_deg=s.optional('heading_deg', -360.0, 360.0, 'deg'),
        grid_heading_deg=s.optional('grid_heading_deg', -360.0, 360.0, 'deg'),
        rest_s=s.number('rest_s', 10.0, 0.1, 7200.0, 's'),
        heading_from=s.choice('heading', ('stated', 'gyrocompass'), 'stated'),
    )
    if mapping.heading_deg is not None and mapping.grid_heading_deg is not None:
        raise ConfigError(f'{s.place}: heading_deg and grid_heading_deg are both given: name one')
    for key in (
        'topic',
        'type',
        'clock',
        'stamp',
        'time_offset_s',
        'fields',
        'frame',
        'origin',
        'epsg',
        'rotation',
    ):
        s.raw(key)
    s.done()
    return mapping
