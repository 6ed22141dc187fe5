"""What a campaign's file states, checked: what all runs share, what varies, what is drawn.

::

    mission: racetrack            # a name or a file; without: the straight run of `world`
    world: {duration_s: 900.0, constants: prior, dvl_rate_hz: 5.0}
    fixes: {period_s: 2.0, delay_kind: uniform, delay_s: 10.0}
    engine: {gate_probability: 0.999}
    settings: default             # exact: the filter is told that sensors have no common errors
    mismatch: none                # a row of `experiment mismatch`, without its scene
    fault: none                   # an injection of `polar inject`, as imu_silent:3@120
    vary:                         # every combination is run
      engine.configuration: [default, modified_akf]
    draw:                         # one value per seed
      world.latitude_deg: {uniform: [70.0, 89.0]}

With ``station:`` instead of ``world:`` and ``fixes:`` the vehicle has no DVL and is located by a
station.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import names_near
from polar_nav_core.user_files import read_yaml
from polar_nav_sim.mission import load_mission
from polar_nav_sim.offline_station import StationScenario
from polar_nav_sim.randomness import stream
from polar_nav_sim.section import parse

from ..experiments.mismatch.faults import Fault
from ..experiments.mismatch.rows import ROWS
from ..experiments.mismatch.scenes import Scene, SinsScene, StationScene
from ..experiments.schedule import FixSpec
from ..experiments.world_spec import WorldSpec
from ..inject.faults import Injection
from ..inject.faults import parse as parse_injection
from .mission import document_of

NONE = 'none'
_SECTIONS = ('world', 'fixes', 'station', 'engine')
_WORDS = {'mission': '', 'settings': 'default', 'mismatch': NONE, 'fault': NONE}
_SETTINGS = ('default', 'exact')
_DRAWS = {'uniform': 2, 'log_uniform': 2, 'normal': 2, 'choice': 0}


@dataclass(frozen=True)
class Point:
    """One combination of parameters, ready to be run with a seed.

    Attributes
    ----------
    scene : SinsScene or StationScene
        Its mission is in ``document``.
    engine : mapping
        Parameters of the engine that the file states.
    exact : bool
        Whether the filter is told that the sensors have no common errors.
    mismatch : Fault
        What the filter does not know, with its size.
    injection : Injection or None
        Fault of messages.
    document : mapping
        Content of the mission's file; empty for the straight run.
    """

    scene: Scene
    engine: Mapping[str, Any]
    exact: bool
    mismatch: Fault
    injection: Injection | None
    document: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Spec:
    """A campaign as its file states it.

    Attributes
    ----------
    file : Path
    shared : mapping
        Sections and words that all runs share.
    vary : mapping
        Values of what varies, by name as ``world.speed_mps``.
    draw : mapping
        Distribution of what is drawn, by name.
    """

    file: Path
    shared: Mapping[str, Any]
    vary: Mapping[str, list[Any]]
    draw: Mapping[str, Mapping[str, list[Any]]]

    def combinations(self) -> Iterator[dict[str, Any]]:
        """Values of what varies, by name, every combination."""
        for values in itertools.product(*self.vary.values()):
            yield dict(zip(self.vary, values, strict=True))

    def drawn(self, seed: int) -> dict[str, Any]:
        """Values of what is drawn for a seed, each from a stream of its own."""
        return {
            name: _draw(kind, values, stream(seed, f'campaign/{name}'))
            for name, held in self.draw.items()
            for kind, values in held.items()
        }

    def point(self, chosen: Mapping[str, Any]) -> Point:
        """Point with values in place of those that all runs share.

        Raises
        ------
        ConfigError
            Naming the file and the key.
        """
        values = copy.deepcopy(dict(self.shared))
        for name, value in chosen.items():
            section, _, key = name.partition('.')
            if key:
                values[section] = {**values.get(section, {}), key: value}
            else:
                values[section] = value
        return _point(values, self.file)


def read(file: Path) -> Spec:
    """Campaign of a file.

    Raises
    ------
    ConfigError
        Naming the file and the key.
    """
    stated = read_yaml(file)
    if not isinstance(stated, Mapping):
        raise ConfigError(f'{file}: expected a mapping with world, fixes, engine, vary')
    known = (*_SECTIONS, *_WORDS, 'vary', 'draw')
    for key in stated:
        if key not in known:
            raise ConfigError(f'{file}: unknown key {key!r}; {names_near(str(key), known)}')
    shared = {key: stated[key] for key in (*_SECTIONS, *_WORDS) if key in stated}
    for key in _SECTIONS:
        if not isinstance(shared.get(key, {}), Mapping):
            raise ConfigError(f'{file}: {key}: expected a mapping')
    vary, draw = stated.get('vary') or {}, stated.get('draw') or {}
    for key, held in (('vary', vary), ('draw', draw)):
        if not isinstance(held, Mapping):
            raise ConfigError(f'{file}: {key}: expected a mapping')
        for name in held:
            _check_name(f'{file}: {key}', name)
    twice = sorted(set(vary) & set(draw))
    if twice:
        raise ConfigError(f'{file}: {twice[0]} is in vary and in draw')
    for name, values in vary.items():
        if not isinstance(values, list) or not values:
            raise ConfigError(f'{file}: vary.{name}: expected a list of values')
    for name, held in draw.items():
        _check_draw(f'{file}: draw.{name}', held)
    spec = Spec(file, shared, dict(vary), dict(draw))
    for chosen in spec.combinations():
        spec.point({**spec.drawn(1), **chosen})
    return spec


def _check_name(where: str, name: object) -> None:
    section, _, key = str(name).partition('.')
    if (key and section in _SECTIONS) or (not key and section in _WORDS):
        return
    names = ', '.join([*(f'{s}.NAME' for s in _SECTIONS), *_WORDS])
    raise ConfigError(f'{where}.{name}: no such parameter; there are {names}')


def _check_draw(where: str, held: object) -> None:
    if not isinstance(held, Mapping) or len(held) != 1 or next(iter(held)) not in _DRAWS:
        raise ConfigError(f'{where}: expected one of {", ".join(_DRAWS)} with its list')
    ((kind, values),) = held.items()
    if not isinstance(values, list) or not values:
        raise ConfigError(f'{where}.{kind}: expected a list')
    if kind == 'choice':
        return
    numbers = [v for v in values if isinstance(v, int | float) and math.isfinite(v)]
    if len(numbers) != len(values) or len(values) != _DRAWS[kind]:
        raise ConfigError(f'{where}.{kind}: expected two numbers')
    low, high = numbers
    if kind == 'log_uniform' and not 0.0 < low <= high:
        raise ConfigError(f'{where}.{kind}: expected 0 < lowest <= highest')
    if kind == 'uniform' and low > high:
        raise ConfigError(f'{where}.{kind}: expected lowest <= highest')
    if kind == 'normal' and high < 0.0:
        raise ConfigError(f'{where}.{kind}: expected a mean and a sigma')


def _draw(kind: str, values: list[Any], rng: np.random.Generator) -> Any:  # noqa: ANN401
    if kind == 'choice':
        return values[int(rng.integers(len(values)))]
    low, high = map(float, values)
    if kind == 'normal':
        return low + high * float(rng.standard_normal())
    share = float(rng.random())
    if kind == 'uniform':
        return low + (high - low) * share
    return math.exp(math.log(low) + (math.log(high) - math.log(low)) * share)


def _point(values: Mapping[str, Any], file: Path) -> Point:
    words = {**_WORDS, **{k: values[k] for k in _WORDS if k in values}}
    for key, value in words.items():
        if not isinstance(value, str):
            raise ConfigError(f'{file}: {key}: {value!r} is not a word')
    if words['settings'] not in _SETTINGS:
        raise ConfigError(f'{file}: settings: expected one of {", ".join(_SETTINGS)}')
    scene, document = _scene(values, words['mission'], file)
    where = f'{file}: engine'
    engine = parse(EngineParams, values.get('engine', {}), where)
    stated = {name: getattr(engine, name) for name in values.get('engine', {})}
    mismatch = _mismatch(words['mismatch'], scene, file)
    injection = None
    if words['fault'] != NONE:
        try:
            injection = parse_injection(words['fault'])
        except ConfigError as error:
            raise ConfigError(f'{file}: fault: {error}') from error
    if injection is not None and scene.mode not in injection.fault.modes:
        raise ConfigError(f'{file}: fault: {words["fault"]} is none of {scene.mode} mode')
    return Point(scene, stated, words['settings'] == 'exact', mismatch, injection, document)


def _scene(values: Mapping[str, Any], mission: str, file: Path) -> tuple[Scene, Mapping[str, Any]]:
    """Scene without its mission, and the content of that."""
    document: Mapping[str, Any] = {}
    if 'station' in values:
        for other in ('world', 'fixes'):
            if other in values:
                raise ConfigError(f'{file}: {other} stands beside station, which has neither')
        document = document_of(mission or StationScenario().mission, file)
        return StationScene(_station(values['station'], f'{file}: station')), document
    stated = dict(values.get('world', {}))
    if 'mission' in stated:
        raise ConfigError(f'{file}: world.mission: write mission beside world')
    if mission:
        document = document_of(mission, file)
        stated.setdefault('duration_s', load_mission(_found(mission, file)).duration_s)
    world = parse(WorldSpec, stated, f'{file}: world')
    if world.imu == 'recorded':
        raise ConfigError(f'{file}: world.imu: a campaign has no recorded IMU')
    return SinsScene(world, parse(FixSpec, values.get('fixes', {}), f'{file}: fixes')), document


def _found(mission: str, file: Path) -> str | Path:
    beside = file.parent / mission
    return beside if beside.is_file() else mission


def _station(values: Mapping[str, Any], where: str) -> StationScenario:
    """Scenario of its numbers; parameters of a station have no limits of their own."""
    usual = {f.name: f.default for f in fields(StationScenario)}
    typed = {}
    for name, value in values.items():
        if name == 'mission':
            raise ConfigError(f'{where}.mission: write mission beside station')
        if name not in usual:
            raise ConfigError(f'{where}: no parameter {name!r}; {names_near(str(name), usual)}')
        wanted: type[Any] = type(usual[name])
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (is_number and math.isfinite(value) if wanted is float else type(value) is wanted):
            raise ConfigError(f'{where}.{name}: {value!r} is no {wanted.__name__}')
        typed[name] = wanted(value)
    return StationScenario(**typed)


def _mismatch(name: str, scene: Scene, file: Path) -> Fault:
    if name == NONE:
        return Fault()
    if name not in ROWS:
        raise ConfigError(f'{file}: mismatch: no row {name!r}; {names_near(name, ROWS)}')
    row = ROWS[name]
    if row.mode != scene.mode:
        raise ConfigError(f'{file}: mismatch: {name} is a row of {row.mode} mode')
    if row.fault.start_s >= scene.duration_s:
        raise ConfigError(
            f'{file}: mismatch: {name} begins after {row.fault.start_s:g} s, the run ends after'
            f' {scene.duration_s:g} s'
        )
    return row.fault
