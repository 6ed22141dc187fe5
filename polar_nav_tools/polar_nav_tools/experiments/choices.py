"""Choices where the paper states no value, all in one place; `--set name=value` changes one.

The paper (Sensors 2018, 18, 1044) gives the start, the attitude sines, the IMU, the DVL and the
filter period. It does not give the speed, the course, the ranges D1 to D4 and D of the delay, the
noise of its fixes, the initial errors, the forgetting factor b, the start values of the adaptation
or whether the filter feeds its estimates back. Feedback is not a choice here: the engine works in
closed loop, because an open loop leaves the linear error model within the first hours.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, default_of, param
from polar_nav_sim.section import Spec

from .schedule import DELAY_KINDS, FixSpec
from .world_spec import WorldSpec

_ENGINE = 'engine.'
_INITIAL = (
    'initial_sigma_position',
    'initial_sigma_height',
    'initial_sigma_velocity',
    'initial_sigma_tilt_deg',
    'initial_sigma_heading_deg',
)


@dataclass(frozen=True)
class Choices(Spec):
    """Numbers that the paper does not state, each with its reason."""

    speed_mps: float = param(
        3.0,
        'm/s',
        0.05,
        20.0,
        'Speed: a brisk cruise; the error of an ignored delay is proportional to it',
    )
    course_deg: float = param(
        0.0, 'deg', -360.0, 360.0, 'True course: its figure 7 has a straight line, no number'
    )
    depth_m: float = param(100.0, 'm', 0.0, 11000.0, 'Depth: the paper: "measured accurately"')
    d1: int = param(100, '', 1, 1200, 'D1 in filter periods: up to 10 s, a long acoustic cycle')
    d2: int = param(50, '', 1, 1200, 'D2 in filter periods: up to 5 s')
    d3: int = param(20, '', 1, 1200, 'D3 in filter periods: up to 2 s')
    d4: int = param(5, '', 1, 1200, 'D4 in filter periods: up to 0.5 s, barely above travel time')
    d: int = param(20, '', 1, 1200, 'D of tables 2 and 3 in filter periods: as D3')
    delay_kind: str = choice(
        'steps',
        tuple(k for k in DELAY_KINDS if k.startswith('steps')),
        'steps: every fix arrives once; steps_lossy: step k reads the fix of step k - i as the'
        ' equations are printed, so that about a third is never read',
    )
    fix_period_s: float = param(
        0.1, 's', 0.01, 3600.0, 'Between fixes: one per filter period, as the equations have it'
    )
    fix_sigma: float = param(
        1.0, 'm', 1e-3, 1e4, 'USBL noise per horizontal axis: 0.1 % of 1 km, a good array'
    )
    fix_sigma_vertical: float = param(
        0.3, 'm', 1e-3, 1e4, 'Noise of fixes along up: from depth sensors'
    )
    leader_sigma: float = param(
        0.0, 'm', 0.0, 1e4, 'Constant error of the leader per run: the paper ignores it'
    )
    initial_sigma_position: float = param(5.0, 'm', 1e-3, 1e6, 'Start: a GNSS fix')
    initial_sigma_height: float = param(5.0, 'm', 1e-3, 1e6, 'Start: a GNSS fix')
    initial_sigma_velocity: float = param(0.01, 'm/s', 1e-6, 100.0, 'Start: DVL')
    initial_sigma_tilt_deg: float = param(
        0.5 / 60, 'deg', 1e-7, 90.0, "Start: 0.5', levelling under way"
    )
    initial_sigma_heading_deg: float = param(
        5.0 / 60, 'deg', 1e-7, 180.0, "Start: 5', a gyrocompass"
    )
    constants: str = choice(
        'paper',
        ('paper', 'prior'),
        'paper: its constant on every axis, positive; prior: drawn per run',
    )
    dvl_rate_hz: float = param(
        10.0, 'Hz', 0.0, 50.0, 'Pings: one per filter period, as its measurement vector has it'
    )
    dvl_sigma: float = param(
        0.005, 'm/s', 1e-6, 1.0, 'White noise per ping; the paper names only the slow part'
    )
    depth_rate_hz: float = param(10.0, 'Hz', 0.0, 100.0, 'Depth: one per filter period')
    depth_sigma: float = param(0.05, 'm', 1e-6, 100.0, 'White noise of depth')
    imu_rate_hz: float = param(
        50.0,
        'Hz',
        10.0,
        1000.0,
        'IMU: enough for sines of 3 s, 10 mm of strapdown error per hour',
    )
    forgetting: float = param(
        default_of(EngineParams, 'forgetting'), '', 0.5, 0.999999, 'b of the adaptation'
    )
    published_start: float = param(
        default_of(EngineParams, 'published_start'),
        '',
        0.0,
        1e6,
        'Fixes that the adaptation as printed counts as seen before the first; 0: as printed, d_1'
        ' = 1 throws the stated noise away',
    )
    gate_probability: float = param(
        1.0, '', 0.5, 1.0, 'Columns that are no named configuration: 1 is no gate, as published'
    )
    output_period_s: float = param(
        1.0, 's', 0.1, 10.0, 'Time between the estimates that are compared with truth'
    )
    engine: Mapping[str, Any] = field(default_factory=dict)
    """Any other parameter of the engine, set with ``engine.name=value``."""

    def world(self, duration_s: float, imu: str = 'paper_6_1', **changes: Any) -> WorldSpec:  # noqa: ANN401 - of WorldSpec
        """World specification with these choices."""
        same = {
            name: getattr(self, name)
            for name in (
                'speed_mps', 'course_deg', 'depth_m', 'constants', 'dvl_rate_hz', 'dvl_sigma',
                'depth_rate_hz', 'depth_sigma', 'imu_rate_hz', *_INITIAL,
            )
        }  # fmt: skip
        return WorldSpec(**{**same, 'duration_s': duration_s, 'imu': imu, **changes})

    def fixes(self, delay_steps: int) -> FixSpec:
        """Specification of fixes with a random delay of 1 to ``delay_steps`` filter periods."""
        return FixSpec(
            period_s=self.fix_period_s,
            first_s=self.fix_period_s,
            sigma=self.fix_sigma,
            sigma_vertical=self.fix_sigma_vertical,
            delay_kind=self.delay_kind,
            delay_steps=delay_steps,
            leader_sigma=self.leader_sigma,
        )

    def filter_changes(self, longest_delay_s: float) -> dict[str, Any]:
        """Parameters of the engine that follow from these choices."""
        out: dict[str, Any] = {
            'forgetting': self.forgetting,
            'published_start': self.published_start,
            'output_period_s': self.output_period_s,
        }
        if longest_delay_s >= default_of(EngineParams, 'max_delay_s'):
            out['max_delay_s'] = longest_delay_s + 1.0
            out['history_s'] = longest_delay_s + 6.0
        return {**out, **self.engine}


def choices_table() -> str:
    """Markdown table of all choices, for docs/experiments.md."""
    lines = ['| name | value | unit | meaning and reason |', '| --- | --- | --- | --- |']
    for f in fields(Choices):
        if f.name != 'engine':
            value = f'{f.default:.4g}' if isinstance(f.default, float) else str(f.default)
            about = f'{f.metadata["doc"]}'
            lines.append(f'| `{f.name}` | {value} | {f.metadata["unit"]} | {about} |')
    return '\n'.join(lines) + '\n'


def choices_from(settings: Sequence[str]) -> Choices:
    """Choices with changes like ``speed_mps=2`` or ``engine.adaptive_floor=0.1``.

    Raises
    ------
    ConfigError
        If a setting is malformed, unknown or out of range; the text names it.
    """
    known = {f.name: f for f in fields(Choices) if f.name != 'engine'}
    of_engine = {f.name: f for f in fields(EngineParams)}
    values: dict[str, Any] = {}
    engine: dict[str, Any] = {}
    for setting in settings:
        name, sign, text = (part.strip() for part in setting.partition('='))
        if not sign or not name:
            raise ConfigError(f'--set {setting}: want name=value')
        if name.startswith(_ENGINE):
            short = name.removeprefix(_ENGINE)
            if short not in of_engine:
                raise ConfigError(f'--set {setting}: the engine has no parameter {short}')
            engine[short] = _value(of_engine[short].metadata.get('kind'), text, setting)
        elif name in known:
            values[name] = _value(known[name].metadata.get('kind'), text, setting)
        else:
            raise ConfigError(
                f'--set {setting}: no choice is called {name}; there are {", ".join(known)} and'
                f' {_ENGINE}PARAMETER'
            )
    try:
        made = replace(Choices(**values), engine=engine)
        EngineParams(**engine)
    except ConfigError as error:
        raise ConfigError(f'--set: {error}') from error
    return made


def _value(kind: str | None, text: str, setting: str) -> Any:  # noqa: ANN401 - by kind
    if kind == 'str':
        return text
    try:
        value = json.loads(text)
        if kind == 'float':
            return float(value)
        return tuple(value) if isinstance(value, list) else value
    except (ValueError, TypeError) as error:
        raise ConfigError(f'--set {setting}: {text!r} is not a {kind} value') from error
