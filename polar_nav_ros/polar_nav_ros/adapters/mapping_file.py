"""Reads a mapping from YAML; every error names file, key, value and what would be right."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.depth import STANDARD_ATMOSPHERE
from polar_nav_core.dvl import SOUND_SPEED_LIMITS
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import unknown_parameter
from polar_nav_core.user_files import parse_yaml, read_text

from . import noise_classes, section
from .heading_section import check_slow_errors, heading_of
from .mapping import (
    ACCEL_UNITS,
    CLOCKS,
    ENCODINGS,
    GYRO_UNITS,
    LENGTH_UNITS,
    POSITION_FRAMES,
    PRESSURE_UNITS,
    REFERENCES,
    SPEED_UNITS,
    STAMPS,
    VERSION,
    DepthMapping,
    DvlMapping,
    FixMapping,
    Frame,
    ImuMapping,
    InitialMapping,
    Mapping,
    PositionMapping,
    Stream,
)
from .section import TO_FILL, Section, is_to_fill


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
        fixes=_all_fixes(top, params, level=version > 1),
        initial=_initial(top.section('initial') or Section(f'{top.place}: initial', {})),
        truth=None if truth is None else _position(truth),
        accept=tuple(accept),
        params=params,
        heading=None if heading is None else heading_of(heading, params, stream_of(heading)),
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


def stream_of(s: Section) -> Stream:
    """Topic of a section, with its type, stamps and fields; errors as `load`."""
    offset_s = s.number('time_offset_s', 0.0, -1e9, 1e9, 's')
    stamp = s.choice('stamp', STAMPS, 'header')
    clock = s.choice('clock', CLOCKS, 'log' if stamp == 'log' else 'host')
    if stamp == 'log' and clock != 'log':
        raise s.fail('clock', f'{clock} does not go with `stamp: log`, which leaves stamps unread')
    return Stream(
        topic=s.text('topic'),
        stamp='log' if clock == 'log' else stamp,
        offset_ns=round(offset_s * 1e9),
        fields=s.texts('fields'),
        type=_type(s),
        clock=clock,
    )


def _type(s: Section) -> str:
    """Message type, as ``sensor_msgs/msg/Imu`` or ``sensor_msgs/Imu``."""
    name = s.text('type', '') if 'type' in s else ''
    s.raw('type')
    parts = name.split('/')
    if name and not (
        len(parts) in (2, 3) and all(parts) and (len(parts) == 2 or parts[1] == 'msg')
    ):
        raise s.fail('type', f'{name!r} is no message type, as in sensor_msgs/msg/Imu')
    return f'{parts[0]}/msg/{parts[-1]}' if name else ''


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


def _position(s: Section, *, finished: bool = True) -> PositionMapping:
    mapping = PositionMapping(stream_of(s), frame_of(s), s.rotation())
    if finished:
        s.done()
    return mapping


def frame_of(s: Section) -> Frame:
    """Frame of positions that a section states, with ``origin`` or ``epsg`` where it needs one."""
    kind = None
    if 'frame' in s:
        kind = s.choice('frame', POSITION_FRAMES)
    s.raw('frame')
    origin = s.section('origin')
    code = s.optional('epsg', 1024, 999999, '')
    place = None
    if origin is not None:
        place = (
            origin.number('latitude_deg', None, -90.0, 90.0, 'deg'),
            origin.number('longitude_deg', None, -360.0, 360.0, 'deg'),
            origin.number('height', 0.0, -12000.0, 10000.0, 'm'),
        )
        origin.done()
    if kind in ('enu', 'ned') and place is None:
        raise s.fail('origin', f'frame {kind} needs latitude_deg, longitude_deg and height')
    if kind == 'epsg' and code is None:
        raise s.fail('epsg', 'frame epsg needs the code of the projection, as in epsg: 3413')
    return Frame(kind, place, None if code is None else int(code))


def _all_fixes(top: Section, params: dict[str, Any], *, level: bool) -> tuple[FixMapping, ...]:
    """All sources of fixes, 2-D unless stated if level; the engine knows one transponder."""
    sections = top.sections('fixes')
    antennas = [_antenna(s) for s in sections]
    fixes = tuple(_fix(s, params, level=level) for s in sections)
    others = [lever for (_, lever), a in zip(fixes, antennas, strict=True) if a is None]
    levers = [lever for lever in others if lever is not None]
    if levers and (len(set(levers)) > 1 or len(levers) < len(others)):
        raise top.fail(
            'fixes',
            'transponder_lever_b is not the same in all of them; the filter knows one point of '
            'the vehicle that fixes locate: state one, or replay with one source at a time',
        )
    if not others:  # the first antenna is the point that the filter knows
        levers = [a for a in antennas if a is not None][:1]
    if levers:
        params['transponder_lever_b'] = list(levers[0])
    x, y, z = params.get('transponder_lever_b', (0.0, 0.0, 0.0))
    found = tuple(
        fix if a is None else replace(fix, offset_b=(a[0] - x, a[1] - y, a[2] - z))
        for (fix, _), a in zip(fixes, antennas, strict=True)
    )
    _check_slow(top, found, params)
    return found


def _antenna(s: Section) -> tuple[float, float, float] | None:
    """Lever arm of an antenna of its own, where one is stated."""
    found = None
    if 'antenna_lever_b' in s:
        if 'transponder_lever_b' in s:
            raise s.fail('antenna_lever_b', 'and transponder_lever_b are both given: name one')
        found = s.numbers('antenna_lever_b', None, -100.0, 100.0, 'm')
    s.raw('antenna_lever_b')
    return found


def _check_slow(top: Section, fixes: tuple[FixMapping, ...], params: dict[str, Any]) -> None:
    """Refuse a slow error beside another one: the engine estimates one, of fixes or a leader."""
    if not any(fix.slow_sigma > 0.0 for fix in fixes):
        return
    if len(fixes) > 1:
        raise top.fail(
            'fixes',
            'slow_sigma goes with one source of fixes: the filter estimates one slow error',
        )
    if params.get('usbl_bias_sigma'):
        raise top.fail('fixes', 'slow_sigma does not go with usbl_bias_sigma: state one of them')


def _slow(s: Section, params: dict[str, Any]) -> tuple[float, float]:
    """Return the slow error of a source [m], and for how long whole errors are alike [s].

    With a slow error the correlation time is its own, and the engine's parameter.
    """
    sigma = s.optional('slow_sigma', 1e-3, 1000.0, 'm')
    tau_s = s.number('correlation_s', 0.0, 0.0, 1e6, 's')
    if sigma is None:
        return 0.0, tau_s
    if tau_s < 1.0:
        raise s.fail('slow_sigma', 'goes with correlation_s: how large, and alike for how long')
    if 'leader_error_tau' in params:
        raise s.fail('correlation_s', 'is stated among parameters, too, as leader_error_tau')
    params['leader_error_tau'] = tau_s
    return sigma, 0.0


def _fix(
    s: Section, params: dict[str, Any], *, level: bool
) -> tuple[FixMapping, tuple[float, float, float] | None]:
    """One source of fixes, and the lever arm of its transponder where one is stated."""
    lever = None
    if 'transponder_lever_b' in s:
        lever = s.numbers('transponder_lever_b', None, -100.0, 100.0, 'm')
    s.raw('transponder_lever_b')
    sigma = s.raw('sigma')
    usual = 2 if level and not isinstance(sigma, list) else 3
    dimensions = int(s.number('dimensions', usual, 2.0, 3.0, ''))
    if sigma is not None:
        pair = sigma if isinstance(sigma, list) else [sigma, sigma]
        if len(pair) != 2 or not all(isinstance(v, int | float) and v > 0.0 for v in pair):
            said = TO_FILL if is_to_fill(sigma) else f'{sigma!r} is not'
            raise s.fail('sigma', f'{said} [horizontal, vertical], or one number [m]')
        sigma = (float(pair[0]), float(pair[1]))
    delay_s = s.optional('delay_s', 0.0, 3600.0, 's')
    slow_sigma, correlation_s = _slow(s, params)
    leader, array = s.section('leader'), s.section('array')
    position = _position(s, finished=False)
    mapping = FixMapping(
        position=position,
        source=s.text('source', position.stream.topic.strip('/')),
        delay_ns=None if delay_s is None else round(delay_s * 1e9),
        sigma=sigma,
        leader=None if leader is None else _position(leader),
        C_a_b=np.eye(3) if array is None else array.rotation(),
        lever_b=(0.0, 0.0, 0.0)
        if array is None
        else array.numbers('lever_b', (0.0, 0.0, 0.0), -100.0, 100.0, 'm'),
        leader_id=int(s.number('leader_id', 1.0, 0.0, 255.0, '')),
        own_id=int(s.number('own_id', 2.0, 0.0, 255.0, '')),
        dimensions=dimensions,
        encoding=s.choice('encoding', ENCODINGS) if 'encoding' in s else '',
        correlation_s=correlation_s,
        delay_sigma_s=s.number('delay_sigma_s', 0.0, 0.0, 60.0, 's'),
        slow_sigma=slow_sigma,
        surface_depth=s.number('surface_depth', math.inf, 0.0, 100.0, 'm'),
    )
    s.raw('encoding')
    if array is not None:
        array.done()
    s.done()
    return mapping, lever


def _initial(s: Section) -> InitialMapping:
    kind = s.choice('from', ('topic', 'values', 'alignment'), 'values')
    if kind == 'topic':
        s.text('topic')
    mapping = InitialMapping(
        kind=kind,
        position=_position(s, finished=False) if 'topic' in s else None,
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
