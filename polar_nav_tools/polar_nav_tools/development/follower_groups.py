"""Order of the follower's parameters on their page: some that matter first, others by group."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import Field
from inspect import get_annotations
from typing import Any

from polar_nav_core.engine.heading_params import HeadingParams
from polar_nav_core.engine.limit_params import LimitParams
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.start_params import StartParams
from polar_nav_core.engine.station_params import StationParams
from polar_nav_core.identification.model_params import ModelParams
from polar_nav_core.identification.params import IdentificationParams
from polar_nav_core.output_params import OutputParams
from polar_nav_core.params import NodeParams

FIRST = {
    'sources': 'topics, types, axes, instruments: it states most of what follows',
    'imu_sample': '`instant` for filtered rates of an AHRS, `mean` for increments',
    'gyro_bias_sigma': 'of the data sheet; with the default, navigation grade, a MEMS diverges',
    'gyro_noise_density': 'angle random walk of the data sheet',
    'accel_bias_sigma': 'of the data sheet; also how well gravity levels',
    'dvl_scale_sigma': 'per cent of velocity; 0.03 where the instrument assumes a sound speed',
    'dvl_markov_sigma': 'slow error as installed; how fast dead reckoning becomes unsure',
    'dvl_lever_b': 'from base_link, as all lever arms; 0.3 m wrong at 10 deg/s are 5 cm/s',
    'transponder_lever_b': 'where on the vehicle fixes are: antenna, locator or transponder',
    'initialize': 'state place, height and heading, or let fixes and a heading align it',
    'reorder_window_s': 'how old `nav/state` is; where it is too short, messages are TOO_LATE',
    'max_delay_s': 'older fixes are refused; the longest cycle of the modem',
    'max_speed': 'what the vehicle can do: most blunders of sensors stop here',
    'map_axes': '`enu` for autopilots and people, `grid` near a pole',
    'state_file': 'after a restart the navigation goes on from it',
}
"""Parameters that a new vehicle's owner looks at first, each with what hangs on it."""

_CLASSES = {
    StartParams: 'Start',
    HeadingParams: 'AHRS and compass',
    LimitParams: 'Limits, gaps, silence',
    OutputParams: 'odometry/now, frames, /tf',
    ModelParams: 'Model of the vehicle: model aiding and station mode',
    StationParams: 'Station mode',
    IdentificationParams: 'Identification of drag and current',
    NodeParams: 'In simulations',
}
_PREFIXES = {
    ('gyro', 'accel', 'imu'): 'IMU',
    ('dvl', 'water'): 'DVL',
    ('depth', 'sea'): 'Depth',
    ('fix', 'usbl', 'leader', 'own_id', 'transponder'): 'Position fixes and packets',
}
_FILTER, _NODE = 'Filter, gates, delays', 'Node'
_ORDER = (
    'Start',
    'IMU',
    'DVL',
    'Depth',
    'Position fixes and packets',
    'AHRS and compass',
    _FILTER,
    'Limits, gaps, silence',
    'odometry/now, frames, /tf',
    _NODE,
    'Model of the vehicle: model aiding and station mode',
    'Station mode',
    'Identification of drag and current',
    'In simulations',
)


def groups(parameters: Iterable[Field[Any]]) -> dict[str, list[Field[Any]]]:
    """Return the parameters that are not first, by the title of their group, in order."""
    out: dict[str, list[Field[Any]]] = {title: [] for title in _ORDER}
    for parameter in parameters:
        if parameter.name not in FIRST:
            out[_title(parameter.name)].append(parameter)
    return out


def _title(name: str) -> str:
    for cls, title in _CLASSES.items():
        if name in get_annotations(cls):
            return title
    for prefixes, title in _PREFIXES.items():
        if name.startswith(prefixes):
            return title
    return _FILTER if name in get_annotations(EngineParams) else _NODE
