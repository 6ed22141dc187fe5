"""Topics of a bag that are played, and their names on the graph."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from polar_nav_core.errors import ConfigError
from polar_nav_ros.topics import (
    CLOCK,
    DECODED,
    DIAGNOSTICS,
    ODOMETRY,
    RUN_INFO,
    STATE,
    STATION_DECODED,
    TYPES,
)

from ..bags.reader import Topic, listed

_FULL_NAME = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')
_SHARED_OUTPUTS = (DIAGNOSTICS, RUN_INFO, '/rosout', '/parameter_events', '/lockstep/ack')
_NAVIGATION = STATE.split('/')[0] + '/'


@dataclass(frozen=True)
class Selection:
    """Options on topics and names.

    Attributes
    ----------
    topics, exclude : sequence of str
        Names in the bag, or patterns with ``*``; no `topics` means all.
    inputs : bool
        Leave out what vehicles of this project computed in the recorded run.
    remap : mapping of str to str
        Other names for single topics; `namespace` is not put before these.
    namespace : str
        Put before all other names but /clock; empty for none.
    clock : bool
        /clock is made from log times, so that a recorded one is left out.
    """

    topics: Sequence[str] = ()
    exclude: Sequence[str] = ()
    inputs: bool = False
    remap: Mapping[str, str] = field(default_factory=dict)
    namespace: str = ''
    clock: bool = False


def choose(available: Mapping[str, Topic], selection: Selection) -> dict[str, str]:
    """Return the names on the graph of the selected topics, by name in the bag.

    Raises
    ------
    ConfigError
        If an option names a topic that is not there, a name is none that ROS allows, two topics
        would get one name, or nothing is left.
    """
    chosen = _matching('--topics', selection.topics, available) or set(available)
    chosen -= _matching('--exclude', selection.exclude, available)
    if selection.inputs:
        chosen -= outputs_of(available.values())
    if selection.clock:
        chosen.discard(CLOCK)
    if not chosen:
        raise ConfigError(f'no topic is left to play; the bag has {listed(sorted(available))}')
    missing = sorted(set(selection.remap) - set(available))
    if missing:
        raise ConfigError(f'--remap: the bag has no topic {listed(missing)}')
    names = {name: _published(name, selection) for name in sorted(chosen)}
    _require_distinct(names, selection.clock)
    return names


def outputs_of(topics: Iterable[Topic]) -> set[str]:
    """Return the topics that nodes of this project computed: navigation, diagnostics, run info.

    A vehicle is any namespace with a nav/state; odometry of others may be a sensor.
    """
    found = list(topics)
    vehicles = [
        t.name.removesuffix(STATE)
        for t in found
        if t.name.endswith(f'/{STATE}') and t.type == TYPES[STATE]
    ]
    return {t.name for t in found if t.name in _SHARED_OUTPUTS} | {
        t.name
        for t in found
        for vehicle in vehicles
        if t.name.startswith(vehicle) and _is_computed(t.name.removeprefix(vehicle))
    }


def parse_remaps(texts: Sequence[str]) -> dict[str, str]:
    """Return new names by old ones, from ``OLD:=NEW``.

    Raises
    ------
    ConfigError
        For a text of another form, or a name given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        old, sign, new = text.partition(':=')
        if not sign:
            raise ConfigError(f'--remap {text!r} is not OLD:=NEW')
        if old in found:
            raise ConfigError(f'--remap: {old} is named twice')
        found[old] = new if new.startswith('/') else f'/{new}'
    return found


def split_names(texts: Sequence[str]) -> list[str]:
    """Return names of options that may be repeated and may hold several, with commas."""
    return [name.strip() for text in texts for name in text.split(',') if name.strip()]


def _is_computed(name: str) -> bool:
    return name.startswith((_NAVIGATION, f'{ODOMETRY}/')) or name in (
        ODOMETRY,
        DECODED,
        STATION_DECODED,
    )


def _matching(option: str, patterns: Sequence[str], available: Collection[str]) -> set[str]:
    found: set[str] = set()
    for pattern in patterns:
        full = pattern if pattern.startswith(('/', '*')) else f'/{pattern}'
        matched = {name for name in available if fnmatchcase(name, full)}
        if not matched:
            have = listed(sorted(available))
            raise ConfigError(f'{option}: the bag has no topic {full}; it has {have}')
        found |= matched
    return found


def _published(name: str, selection: Selection) -> str:
    new = selection.remap.get(name)
    if new is None:
        space = selection.namespace.strip('/')
        new = f'/{space}{name}' if space and name != CLOCK else name
    if not _FULL_NAME.fullmatch(new) or '__' in new:
        raise ConfigError(f'{name}: {new!r} is no name of a ROS topic; --remap gives it another')
    return new


def _require_distinct(names: Mapping[str, str], clock: bool) -> None:
    taken = {CLOCK: '--clock'} if clock else {}
    for name, new in names.items():
        if new in taken:
            raise ConfigError(f'{taken[new]} and {name} would both be published as {new}')
        taken[new] = name
