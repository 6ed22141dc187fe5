"""Pace of a playback: log times to deadlines of a steady clock, simulated time, lag."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from polar_nav_ros.topics import CLOCK

from .order import Message

_CLOCK = struct.Struct('<BBBBiI')
_SLICE_NS = 100_000_000
"""Longest pause [ns]: a signal is noticed after it."""
_S = 1_000_000_000


@dataclass(frozen=True)
class Timeline:
    """Deadline on the steady clock of each log time, all ns.

    Attributes
    ----------
    first_ns : int
        Log time that is due at `start_ns`.
    rate : float
        Multiple of the recorded speed.
    start_ns : int
        Of the steady clock.
    """

    first_ns: int
    rate: float
    start_ns: int

    def due_ns(self, log_ns: int) -> int:
        """Return when a log time is due; absolute, so that no error adds up."""
        return self.start_ns + round((log_ns - self.first_ns) / self.rate)


@dataclass
class Lag:
    """How much later than due messages were published.

    Attributes
    ----------
    count : int
        Number of messages.
    total_ns, largest_ns : int
        Sum, and largest.
    at_ns : int
        Log time of the message with the largest.
    """

    count: int = 0
    total_ns: int = 0
    largest_ns: int = 0
    at_ns: int = 0

    def add(self, lag_ns: int, log_ns: int) -> None:
        """Count one message."""
        self.count += 1
        self.total_ns += lag_ns
        if lag_ns > self.largest_ns:
            self.largest_ns, self.at_ns = lag_ns, log_ns


def within(
    messages: Iterable[Message], first_ns: int, last_ns: int, latched: Mapping[str, int]
) -> Iterator[Message]:
    """Yield the messages of a time span, those of latched topics before it first.

    Parameters
    ----------
    messages : iterable of Message
        By log time.
    first_ns, last_ns : int
        Both are within.
    latched : mapping of str to int
        Transient local topics with their depth: a subscriber that comes at `first_ns` would have
        got so many of the messages before.
    """
    before = {topic: deque[Message](maxlen=depth) for topic, depth in latched.items()}
    begun = False
    for message in messages:
        if message.log_ns > last_ns:
            break
        if message.log_ns < first_ns:
            if message.topic in before:
                before[message.topic].append(message)
            continue
        if not begun:
            begun = True
            yield from _released(before, first_ns)
        yield message
    if not begun:
        yield from _released(before, first_ns)


def with_clock(
    messages: Iterable[Message], first_ns: int, last_ns: int, period_ns: int
) -> Iterator[Message]:
    """Yield messages and between them /clock, each period from the first to the last time [ns].

    The clock comes before messages of the same time: none is from its receiver's future by more
    than a period.
    """
    tick_ns = first_ns
    for message in messages:
        while tick_ns <= min(message.log_ns, last_ns):
            yield Message(CLOCK, tick_ns, clock_cdr(tick_ns))
            tick_ns += period_ns
        yield message
    while tick_ns <= last_ns:
        yield Message(CLOCK, tick_ns, clock_cdr(tick_ns))
        tick_ns += period_ns


def clock_cdr(log_ns: int) -> bytes:
    """Return a serialized rosgraph_msgs/Clock; times after 2038 are those of 2038."""
    seconds, nanoseconds = divmod(log_ns, _S)
    return _CLOCK.pack(0, 1, 0, 0, min(seconds, 0x7FFFFFFF), nanoseconds)


def publish_all(
    messages: Iterable[Message],
    timeline: Timeline,
    publish: Callable[[Message], None],
    *,
    lag: Lag,
    now_ns: Callable[[], int],
    pause: Callable[[float], None],
    stopped: Callable[[], bool],
) -> bool:
    """Publish each message when it is due; returns whether all were before a stop.

    A message that is late is published at once, and `lag` counts by how much.

    Parameters
    ----------
    messages : iterable of Message
        By log time.
    timeline : Timeline
    publish : callable
    lag : Lag
        Counts.
    now_ns : callable
        Steady clock.
    pause : callable
        Waits so many seconds, or less.
    stopped : callable
        Whether to end.
    """
    for message in messages:
        if stopped():
            return False
        due_ns = timeline.due_ns(message.log_ns)
        while (left_ns := due_ns - now_ns()) > 0:
            pause(min(left_ns, _SLICE_NS) / _S)
            if stopped():
                return False
        lag.add(-left_ns, message.log_ns)
        publish(message)
    return True


def _released(before: Mapping[str, deque[Message]], first_ns: int) -> Iterator[Message]:
    kept = sorted((m for messages in before.values() for m in messages), key=lambda m: m.log_ns)
    for message in kept:
        yield message._replace(log_ns=first_ns)
