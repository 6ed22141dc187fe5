"""Which runs of an analysis decide the exit status, and the levels of the run that went live."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.health.span import Look, Span, span_of
from polar_nav_ros.topics import DIAGNOSTICS, HEALTH

from ..bags import Bag
from ..graph.options import USUAL_CONFIGURATION

LIVE = 'live run'
_LEVELS = {level.value: level for level in Level}


def judged_of(configurations: Sequence[str]) -> tuple[str, ...]:
    """Names of the replayed runs that decide: the only one, or of several the usual one."""
    if len(configurations) == 1:
        return tuple(configurations)
    return tuple(name for name in configurations if name == USUAL_CONFIGURATION)


def live_span(bag: Bag, vehicle: str) -> Span:
    """Levels of the run that went live, as its follower published them.

    From nav/health, or from /diagnostics of a bag from before that topic; nobody looked where a
    bag has neither.
    """
    topic = f'/{vehicle}/{HEALTH}'
    looks = _of_health if _count(bag, topic) else _of_diagnostics
    return span_of(looks(bag, vehicle))


def _count(bag: Bag, topic: str) -> int:
    return bag.topics[topic].count if topic in bag.topics else 0


def _of_health(bag: Bag, vehicle: str) -> Iterator[Look]:
    for _, message in bag.read(f'/{vehicle}/{HEALTH}'):
        sentence = message.conditions[0] if message.conditions else ''
        yield Look(_level(message.level), str(sentence))


def _of_diagnostics(bag: Bag, vehicle: str) -> Iterator[Look]:
    if not _count(bag, DIAGNOSTICS):
        return
    name = f'/{vehicle}/follower_node'
    for _, message in bag.read(DIAGNOSTICS):
        for status in message.status:
            if status.name == name:
                yield Look(_level(status.level), str(status.message))


def _level(value: Any) -> Level:  # noqa: ANN401 - bytes of rclpy, a number of other readers
    number = value[0] if isinstance(value, bytes) else int(value)
    return _LEVELS.get(number, Level.ERROR)
