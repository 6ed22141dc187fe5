"""Whether the sources of a mapping file can be heard and used, with a sentence where not.

A node knows of them what no filter does: that nobody publishes a topic, that its type or QoS does
not match, that its publisher is there and sends nothing. /diagnostics and nav/health say the same
of it. Nothing of this is recorded, and a replay has no such conditions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from polar_nav_core.engine.health.conditions import Condition, Culprit, Level

from .adapters.live import Source
from .diagnostics import Diagnosis
from .node import PolarNode
from .topics import STATE, TYPES, estimates_beside

_MANY = 10
"""Messages that cannot be used, all of a source, that are a WARN."""
_STANDING = 5
"""Diagnoses, one a second, for which something is wrong before it is in the log, too."""
_SHOWN = 3
"""Topics that might be meant, of many."""
_CONTENT = {
    'velocity': ('a velocity', 'NaN, marked as not valid, or not of the stated reference'),
    'depth': ('a depth', 'NaN, or no echo in range'),
    'heading': ('a heading', 'NaN, or an orientation that its sender calls unknown'),
}
"""By role: what an empty message lacks, and how."""
_POSITION = ('a position', 'NaN, zeros, or a status of no fix (of NavSatFix any below 0)')
_CULPRITS = {
    'imu': Culprit.IMU,
    'velocity': Culprit.DVL,
    'depth': Culprit.DEPTH,
    'heading': Culprit.HEADING,
    'position': Culprit.FIXES,
    'packet': Culprit.FIXES,
}
_REGULAR = ('velocity', 'depth', 'heading')
"""Roles whose sensors pause for no reason of their own; of the IMU, see `NavigationHealth`."""


class SourceHealth:
    """Looks at the sources of a node once a second.

    Parameters
    ----------
    node : PolarNode
        Its parameter ``sensor_silent_s`` says how long a sensor may send nothing.
    sources : iterable of Source
    name_of : callable
        Full name of a source's topic, after remapping.
    clock : callable
        Steady time [s].
    """

    def __init__(
        self,
        node: PolarNode[Any],
        sources: Iterable[Source],
        name_of: Callable[[Source], str],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._sources = tuple(sources)
        self._name_of = name_of
        self._clock = clock
        self._heard: dict[str, tuple[int, float]] = {}
        self._stood: dict[str, int] = {}
        self._found: list[tuple[Source, str]] = []

    def look(self) -> None:
        """Find what is wrong now; what stands for some seconds is logged."""
        self._found = [(s, text) for s in self._sources if (text := self._problem(s))]
        self._tell({self._name_of(s): text for s, text in self._found})

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What the last look found, for nav/health: a WARN each, with its sensor as culprit."""
        return tuple(
            Condition(f'source {self._name_of(s)}', Level.WARN, _CULPRITS[s.role], text)
            for s, text in self._found
        )

    def diagnosed(self, found: Diagnosis) -> Diagnosis:
        """Add what the last look found to a diagnosis; a WARN where nothing is worse."""
        counts = {f'unreadable {self._name_of(s)}': s.unreadable for s in self._sources}
        counts |= {f'without {_content(s)} {self._name_of(s)}': s.empty for s in self._sources}
        values = {**found.values, **{name: n for name, n in counts.items() if n}}
        values |= {f'source {self._name_of(s)}': self._offer(s) for s in self._sources}
        return replace(found, values=values).beside(*(text for _, text in self._found))

    def _tell(self, problems: Mapping[str, str]) -> None:
        """Log what has been wrong with a topic for some seconds, and that it is over."""
        for name in {**self._stood, **problems}:
            stood = self._stood.get(name, 0)
            if name in problems:
                self._stood[name] = stood + 1
                if stood + 1 == _STANDING:
                    self._node.get_logger().warning(problems[name])
            elif self._stood.pop(name) >= _STANDING:
                self._node.get_logger().info(f'{name} is as the mapping file states it')

    def _problem(self, source: Source) -> str:
        """Sentence on a source whose publisher is absent, unheard or silent; else empty."""
        name = self._name_of(source)
        silent = self._silent(source, name)
        if self._node.publishers_of(name):
            doubled = '' if source.role == 'packet' else self._node.doubled(name)
            return silent or _unusable(source, name) or doubled
        offered = self._node.get_publishers_info_by_topic(name)
        others = {str(i.topic_type) for i in offered} - {source.stream.type}
        if not offered:
            return f'nobody publishes {name}{self._elsewhere(source)}'
        if others:
            return f'{name} is published as {", ".join(sorted(others))}, not {source.stream.type}'
        return f'the QoS of {name} is incompatible: its publisher offers {_qos_text(offered)}'

    def _elsewhere(self, source: Source) -> str:
        """In brackets, topics of the type that others publish and no source stands for."""
        there = dict(self._node.get_topic_names_and_types())
        no_sensor = {self._name_of(s) for s in self._sources}
        no_sensor |= estimates_beside(n for n, types in there.items() if TYPES[STATE] in types)
        found = sorted(
            name
            for name, types in there.items()
            if source.stream.type in types
            and name not in no_sensor
            and self._node.get_publishers_info_by_topic(name)
        )
        more = ', ...' if len(found) > _SHOWN else ''
        return f' (of its type there is {", ".join(found[:_SHOWN])}{more})' if found else ''

    def _silent(self, source: Source, name: str) -> str:
        """Sentence on a sensor that sends nothing, by the steady clock; else empty."""
        count, now_s = self._node.taken_counts()[name], self._clock()
        before, since_s = self._heard.get(name, (-1, now_s))
        # The pace of lockstep is no sensor's, and nobody publishes what has no publisher.
        if count != before or self._node.params.lockstep or not self._node.publishers_of(name):
            since_s = now_s
        self._heard[name] = count, since_s
        if source.role not in _REGULAR or now_s - since_s <= self._node.params.sensor_silent_s:
            return ''
        return f'no message of {name} for {now_s - since_s:.0f} s, though it has a publisher'

    def _offer(self, source: Source) -> str:
        kind = 'best effort' if self._name_of(source) in self._node.relaxed else 'reliable'
        text = f'{source.stream.type}, {kind}'
        clock = source.clock
        if clock is None:
            return text
        return f'{text}, clock drifts by {clock.drift * 1e6:.1f} ppm, stepped {clock.steps} times'


def _content(source: Source) -> str:
    """What a message of a source that is empty lacks."""
    return _CONTENT.get(source.role, _POSITION)[0]


def _unusable(source: Source, name: str) -> str:
    """Sentence on a source whose messages so far were of no use, or cannot be; else empty."""
    if source.unreadable >= _MANY and not source.read:
        return (
            f'none of {source.unreadable} messages of {name} can be read as {source.stream.type}'
        )
    if source.read < _MANY:
        return ''
    if source.empty == source.read:
        what, why = _CONTENT.get(source.role, _POSITION)
        return f'none of {source.read} messages of {name} holds {what}: {why}'
    if source.unsure == source.read:
        return (
            f'none of {source.read} messages of {name} states a variance above zero, and all are '
            'refused: state `sigma` in the mapping file'
        )
    if 2 * source.aloft > source.read:
        return (
            f'{source.aloft} of {source.read} depths of {name} are above the surface: heights '
            '(`positive: up`), gauge pressures (`atmospheric_pressure: 0`) or another pressure of '
            'the air'
        )
    return ''


def _qos_text(offered: Iterable[Any]) -> str:
    profiles: list[Any] = [info.qos_profile for info in offered]
    words: Mapping[str, None] = dict.fromkeys(
        f'{p.reliability.name}, {p.durability.name}'.lower().replace('_', ' ') for p in profiles
    )
    return ' and '.join(words)
