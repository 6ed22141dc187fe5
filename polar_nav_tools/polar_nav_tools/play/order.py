"""Messages of a bag in the order of their log times, with little memory."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple


class Message(NamedTuple):
    """One serialized message with its log time [ns]."""

    topic: str
    log_ns: int
    data: bytes


@dataclass
class Span:
    """Times of a bag's messages.

    Attributes
    ----------
    first_ns, last_ns : int
        Oldest and newest log time of all topics.
    window_ns : int
        How far a message of the counted topics stands at most behind the newest one before it.
    counts : dict of str to int
        Messages by topic.
    """

    first_ns: int = 0
    last_ns: int = 0
    window_ns: int = 0
    counts: dict[str, int] = field(default_factory=dict)


def measure(times: Iterable[tuple[str, int]], chosen: Collection[str]) -> Span:
    """Return times and counts of (topic, log time [ns]) in the order of the file.

    Parameters
    ----------
    times : iterable
    chosen : collection of str
        Topics that are counted, and whose order matters.
    """
    first: int | None = None
    last = newest = window = 0
    counts: dict[str, int] = {}
    for topic, log_ns in times:
        first = log_ns if first is None else min(first, log_ns)
        last = max(last, log_ns)
        if topic in chosen:
            newest = max(newest, log_ns)
            window = max(window, newest - log_ns)
            counts[topic] = counts.get(topic, 0) + 1
    return Span(first or 0, last, window, counts)


def in_order(messages: Iterable[Message], window_ns: int) -> Iterator[Message]:
    """Yield messages by log time; equal ones in the order of the file.

    Only messages within the window of `measure` are kept in memory: nothing that comes later can
    be older than the newest one less the window.
    """
    if window_ns == 0:
        yield from messages
        return
    waiting: list[tuple[int, int, Message]] = []
    newest = 0
    for place, message in enumerate(messages):
        newest = max(newest, message.log_ns)
        heapq.heappush(waiting, (message.log_ns, place, message))
        while waiting[0][0] <= newest - window_ns:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
