"""Writes calibrated values into a copy of a mapping file, or as parameters; comments stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml.comments import CommentedMap

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import exp, matrix_from_euler
from polar_nav_core.dvl import SOUND_SPEED_LIMITS
from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_text
from polar_nav_ros.adapters.mapping import Mapping as Sources

from ..foreign.mapping_text import Written, load_text, parameters_of, put, sections, text_of
from . import move
from .bag import Calibration
from .problem import SIGMAS
from .verdicts import Line, Verdict

_TURNS = {'dvl_roll': 0, 'dvl_pitch': 1, 'dvl_yaw': 2}
_AXES = {'x': 0, 'y': 1, 'z': 2}
_SOUND_SPEED = 1500.0
"""That a DVL assumes unless it is told another one [m/s]."""
NO_KEY = {
    'range_scale': 'correct the sound speed of the acoustic ranges at their source',
    'array_yaw': "state it where the array's vehicle makes its fixes",
    'clock_drift': 'discipline the clocks',
    'heading_bias': 'calibrate the compass; the filter estimates it',
    'heading_sin': 'calibrate the compass',
    'heading_cos': 'calibrate the compass',
}
"""Constants that no key of a mapping and no parameter holds, and what to do about them."""


def chosen_lines(
    lines: Sequence[Line], assign: Sequence[str]
) -> tuple[list[Line], dict[str, str]]:
    """Lines to write, and why others are not: estimated ones, and sums that the user assigns.

    Raises
    ------
    ConfigError
        For an assigned constant that is no sum of this calibration.
    """
    sums = [li.constant.name for li in lines if li.verdict is Verdict.INSEPARABLE]
    for name in assign:
        if name not in sums:
            known = ', '.join(sums) or 'none'
            raise ConfigError(f'--assign {name}: is no sum here; there are {known}')
    out, left = [], {}
    for line in lines:
        name = line.constant.name
        if line.verdict is Verdict.NOT_EXCITED:
            left[name] = 'not excited'
        elif line.verdict is Verdict.INSEPARABLE and name not in assign:
            left[name] = f'a sum: `--assign {name}` gives all of it to this one'
        elif name in NO_KEY:
            left[name] = NO_KEY[name]
        else:
            out.append(line)
    return out, left


def parameter_lines(found: Calibration, assign: Sequence[str]) -> Written:
    """Lines of ``parameters:`` for a vehicle without a mapping file."""
    lines, left = chosen_lines(found.lines, assign)
    top = CommentedMap()
    top['parameters'] = section = CommentedMap()
    names = []
    for line in lines:
        name, value = line.constant.name, line.value / line.constant.factor
        key, new = _parameter(section, found, name, value)
        if not key:
            left[name] = 'no parameter holds it'
            continue
        put(section, key, new, _origin(found, line))
        _raise_sigma(top, found, line)
        names.append(name)
    return Written(text_of(top) if names else '', tuple(names), left)


def _parameter(
    section: CommentedMap, found: Calibration, name: str, value: float
) -> tuple[str, Any]:
    """Parameter that holds a constant with its new value; '' without one."""
    params = found.params
    if name in _TURNS:
        rpy = tuple(section.get('dvl_rpy_deg', params.dvl_rpy_deg))
        return 'dvl_rpy_deg', list(move.turned(rpy, _TURNS[name], value))
    for kind in ('dvl', 'transponder'):
        if name.startswith(f'{kind}_lever_'):
            key = f'{kind}_lever_b'
            return key, _longer(section.get(key, getattr(params, key)), name, value)
    if name == 'sea_surface':
        return 'sea_surface_height', params.sea_surface_height + value
    if name == 'dvl_scale' and params.water_sound_speed:
        return 'water_sound_speed', params.water_sound_speed / (1.0 + value)
    return '', None


def mapping_file(
    path: Path, found: Calibration, mapping: Sources, assign: Sequence[str]
) -> Written:
    """Text of a mapping file with the calibrated values and where they are from.

    Parameters
    ----------
    path : Path
        The mapping file of this calibration.
    found : Calibration
    mapping : Mapping
        What that file says.
    assign : sequence of str
        Sums that belong to these constants.
    """
    lines, left = chosen_lines(found.lines, assign)
    top = load_text(read_text(path))
    names = []
    for line in lines:
        name, value = line.constant.name, line.value / line.constant.factor
        why = _enter(top, found, mapping, line, value)
        if why:
            left[name] = why
        else:
            _raise_sigma(top, found, line)
            names.append(name)
    return Written(text_of(top), tuple(names), left)


def _raise_sigma(top: CommentedMap, found: Calibration, line: Line) -> None:
    """State what a calibration leaves of a constant, where less is stated; never less."""
    c = line.constant
    key, unit = SIGMAS.get(c.column, ('dvl_scale_sigma', 1.0))
    if c.column < 0 and c.name != 'dvl_scale':
        return
    section = parameters_of(top)
    if top.get('noise') is not None and key not in section:
        section = top['noise']  # where a number beside the class of an instrument wins
    sigma = line.sigma / c.factor * unit
    if sigma > float(section.get(key, getattr(found.params, key))):
        put(section, key, sigma, f'what is left of {c.name}')


def _enter(
    top: CommentedMap, found: Calibration, mapping: Sources, line: Line, value: float
) -> str:
    """Enter a value into a mapping; returns why it could not be, or nothing."""
    name, origin = line.constant.name, _origin(found, line)
    if name == 'delay':
        for section in sections(top, 'fixes'):
            _shift(section, -value, origin)
            if 'delay_s' in section:
                put(section, 'delay_s', max(0.0, float(section['delay_s']) + value), origin)
    elif name == 'dvl_latency':
        for section in sections(top, 'dvl'):
            _shift(section, -value, origin)
    elif name in _TURNS:
        for section, dvl in zip(sections(top, 'dvl'), mapping.dvls, strict=True):
            C = _turned(_mounting(section, dvl.C_s_b), found, _TURNS[name], value)
            put(section, 'rotation', {'rpy_deg': list(move.rpy_of(C))}, origin)
    elif name.startswith('dvl_lever_'):
        for section in sections(top, 'dvl'):
            lever = section.get('lever_b', mapping.params.get('dvl_lever_b', (0.0, 0.0, 0.0)))
            put(section, 'lever_b', _longer(lever, name, value), origin)
    elif name.startswith('transponder_lever_'):
        for section in sections(top, 'fixes'):
            key = 'antenna_lever_b' if 'antenna_lever_b' in section else 'transponder_lever_b'
            lever = section.get(key, mapping.params.get('transponder_lever_b', (0.0, 0.0, 0.0)))
            put(section, key, _longer(lever, name, value), origin)
    elif name == 'dvl_scale':
        return _sound_speed(top, mapping, value, origin)
    else:
        put(
            parameters_of(top),
            'sea_surface_height',
            found.params.sea_surface_height + value,
            origin,
        )
    return ''


def _sound_speed(top: CommentedMap, mapping: Sources, value: float, origin: str) -> str:
    """State a scale of the DVL as the sound speed of the water."""
    water = float(mapping.params.get('water_sound_speed', 0.0))
    assumed = {dvl.sound_speed for dvl in mapping.dvls}
    if not water and assumed == {0.0}:
        return (
            'state `sound_speed` of the DVL (what it assumes) and the parameter '
            f'`water_sound_speed`, {1.0 / (1.0 + value):.5f} times that'
        )
    if len(assumed) > 1:
        return 'the DVLs assume several sound speeds'
    new = (water or assumed.pop() or _SOUND_SPEED) / (1.0 + value)
    if not SOUND_SPEED_LIMITS[0] <= new <= SOUND_SPEED_LIMITS[1]:
        return f'{new:.0f} m/s is the sound speed of no water'
    put(parameters_of(top), 'water_sound_speed', new, origin)
    return ''


def _mounting(section: CommentedMap, stated: Array) -> Array:
    """Mounting in the file, which a constant before may have changed already."""
    rotation = section.get('rotation')
    if isinstance(rotation, dict) and 'rpy_deg' in rotation:
        roll, pitch, yaw = (math.radians(float(a)) for a in rotation['rpy_deg'])
        return np.asarray(matrix_from_euler(yaw, pitch, roll))
    return stated


def _turned(C_s_b: Array, found: Calibration, axis: int, angle: float) -> Array:
    """Mounting turned about a body axis, the parameter ``dvl_rpy_deg`` on top of it."""
    roll, pitch, yaw = (math.radians(a) for a in found.params.dvl_rpy_deg)
    C = matrix_from_euler(yaw, pitch, roll)
    by = np.zeros(3)
    by[axis] = angle
    return np.asarray(C.T @ exp(by) @ C @ C_s_b)


def _longer(lever: Sequence[float], name: str, value: float) -> list[float]:
    out = [float(v) for v in lever]
    out[_AXES[name[-1]]] += value
    return out


def _shift(section: CommentedMap, by: float, origin: str) -> None:
    put(section, 'time_offset_s', float(section.get('time_offset_s', 0.0)) + by, origin)


def _origin(found: Calibration, line: Line) -> str:
    c = line.constant
    return (
        f'polar calibrate {found.path.name} of {found.recorded:%Y-%m-%d}: '
        f'{c.name} {line.value:+.4g} {c.unit}, 1-sigma {line.sigma:.2g} {c.unit}'
    )
