"""Choices where the paper of the DVL-less system states no value; `--set` changes one.

The paper (Drones 2025, 9(4), 299) gives added mass, drag, the sensors' and the station's errors,
packet, period and window. Its thrust, yaw law, current, inertia, Q and R are lost in the text; in
their place stand the mission ``station`` (thrust, yaw, inertia, current, geometry) and
the `published_*` parameters of the engine.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import param
from polar_nav_sim.offline_station import StationScenario
from polar_nav_sim.section import Spec

_ENGINE = 'engine.'


@dataclass(frozen=True)
class StationChoices(Spec):
    """Numbers that the paper does not state, each with its reason."""

    noise: float = param(
        1.0,
        '',
        0.0,
        10.0,
        'Factor of all error amplitudes: "range of error 1 %" read as at most 1 % either way;'
        ' has-table has 0.5, the other reading, too',
    )
    processing_s: float = param(
        0.2, 's', 0.0, 60.0, 'T_sigma; the largest that the period of 2.5 s allows at 1.13 km'
    )
    excitation: float = param(
        1.0, '', 0.0, 10.0, 'Factor of the changes of thrust: 52 + 18 + 14 N as two slow sines'
    )
    current_change: float = param(
        0.3, '', -1.0, 1.0, 'has-current: how much the speed of the water swings, of its mean'
    )
    current_turn: float = param(0.6, 'rad', -3.0, 3.0, 'has-current: how far its direction swings')
    current_period_s: float = param(1800.0, 's', 60.0, 1e6, 'has-current: period of both')
    low_excitation: float = param(
        0.25, '', 0.0, 10.0, 'has-excitation: factor of the changes of thrust, 0.25 is +-8 N'
    )
    heading_bias_deg: float = param(
        2.0, 'deg', -90.0, 90.0, 'has-heading: constant error of the measured heading'
    )
    initial_sigma_position: float = param(
        5.0, 'm', 1e-3, 1e4, 'Start: a GNSS fix at the surface; the error is drawn per seed'
    )
    initial_sigma_velocity: float = param(
        0.2, 'm/s', 1e-3, 10.0, 'Start: how far the steady speed of the nominal model may be off'
    )
    depth_sigma: float = param(0.0289, 'm', 1e-4, 10.0, 'Depth in the filter: 0.05 m, uniform')
    output_period_s: float = param(
        0.5, 's', 0.01, 10.0, 'Time between the estimates that are compared with truth'
    )
    engine: Mapping[str, Any] = field(default_factory=dict)
    """Any other parameter of the engine, set with ``engine.name=value``."""

    def scenario(self, duration_s: float, **changes: Any) -> StationScenario:  # noqa: ANN401 - of StationScenario
        """Scenario with these choices."""
        same = {
            'noise': self.noise,
            'processing_s': self.processing_s,
            'excitation': self.excitation,
        }
        return StationScenario(**{**same, 'duration_s': duration_s, **changes})


def choices_table() -> str:
    """All choices as a Markdown table, for docs/experiments-station.md."""
    lines = ['| name | value | unit | meaning and reason |', '| --- | --- | --- | --- |']
    lines += [
        f'| `{f.name}` | {f.default:.4g} | {f.metadata["unit"]} | {f.metadata["doc"]} |'
        for f in fields(StationChoices)
        if f.name != 'engine'
    ]
    return '\n'.join(lines) + '\n'


def choices_from(settings: Sequence[str]) -> StationChoices:
    """Choices with changes like ``processing_s=1`` or ``engine.current_method=single``.

    Raises
    ------
    ConfigError
        Naming the setting that is not understood, unknown or out of range.
    """
    known = {f.name for f in fields(StationChoices) if f.name != 'engine'}
    of_engine = {f.name: f.metadata.get('kind') for f in fields(EngineParams)}
    values: dict[str, Any] = {}
    engine: dict[str, Any] = {}
    for setting in settings:
        name, sign, text = (part.strip() for part in setting.partition('='))
        short = name.removeprefix(_ENGINE)
        if not sign or not name:
            raise ConfigError(f'--set {setting}: want name=value')
        if name in known:
            values[name] = _number(text, setting)
        elif short == name:
            raise ConfigError(
                f'--set {setting}: no choice is called {name}; there are'
                f' {", ".join(sorted(known))} and {_ENGINE}PARAMETER'
            )
        elif short not in of_engine:
            raise ConfigError(f'--set {setting}: the engine has no parameter {short}')
        else:
            engine[short] = text if of_engine[short] == 'str' else _value(text, setting)
            if of_engine[short] == 'float':
                engine[short] = _number(text, setting)
    try:
        made = replace(StationChoices(**values), engine=engine)
        EngineParams(**{'mode': 'station', 'configuration': 'default', **engine})
    except ConfigError as error:
        raise ConfigError(f'--set: {error}') from error
    return made


def _number(text: str, setting: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise ConfigError(f'--set {setting}: {text!r} is not a number') from error


def _value(text: str, setting: str) -> Any:  # noqa: ANN401 - by parameter
    try:
        value = json.loads(text)
    except ValueError as error:
        raise ConfigError(f'--set {setting}: {text!r} is not a value') from error
    return tuple(value) if isinstance(value, list) else value
