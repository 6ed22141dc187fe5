"""One life of a follower: what a process of it took, as events, and what it published."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from polar_nav_core import spilled
from polar_nav_core.arrays import Ints
from polar_nav_core.engine.events import ClockStep, Event, Fix, OrderKey
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.order import NEVER_NS
from polar_nav_follower import session
from polar_nav_msgs.msg import FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.navigation_session import MODEL_OUTPUTS
from polar_nav_ros.stamps import to_ns

from ..bags.errors import BagError
from .records import Heard, Live, Timed, stamp_in

TYPES: dict[str, type[Any]] = {
    topics.STATE: NavState,
    topics.RECEIPT: FixReceipt,
    **MODEL_OUTPUTS,
}
"""Outputs that a replay reproduces."""


@dataclass(frozen=True)
class Life:
    """What one process of a follower took and published.

    Attributes
    ----------
    messages : sequence of (str, message)
        Inputs by topic without the vehicle, each topic in its order; read when gone through.
    live : mapping of str to list of bytes
        What it published on the compared topics; up to the hole in a recording that has one. Read
        when it is asked for.
    refused : list of Receipt
        What it refused because it came too late.
    steps : list of ClockStep
        Of the clocks of its topics, as it found them.
    arrivals_ns : sequence of int
        When the messages were recorded [ns], where faults were put into the bag.
    until_ns : int or None
        Stamp of the last output of a node that was killed [ns]; None where it ended in order.
    torn : bool
        Whether the recording has a hole in this life: what came of the messages in it, nobody can
        replay.
    dropped : mapping of str to (int, int)
        By topic, messages in the recording that the node never took although they came before its
        last output: at least how many, of how many. Empty for a node that did not end in order.
    unheard : mapping of str to int
        By compared topic, what it had published before the recorder heard the topic.
    found_ns : int
        Stamp up to which the recorder had not found a node that was started again [ns]; 0 for the
        first one.
    """

    messages: Sequence[tuple[str, Any]]
    live: Mapping[str, list[bytes]]
    refused: list[Receipt]
    steps: list[ClockStep] = field(default_factory=list)
    arrivals_ns: Sequence[int] | Ints = ()
    until_ns: int | None = None
    torn: bool = False
    dropped: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    unheard: Mapping[str, int] = field(default_factory=dict)
    found_ns: int = 0

    def events(self, run: session.Session, before: session.Session, where: str) -> Iterator[Event]:
        """Events in their total order, without those that the live node refused.

        They are nearly in order as they were recorded: an event waits until none that is left can
        come before it. A session made alike finds when that is.

        Raises
        ------
        BagError
            For a message that can be decoded and still makes no sense, before the first event;
            ``where`` precedes its topic.
        """
        earliest_ns = self._earliest_left(before, where)
        waiting: list[tuple[OrderKey, int, Event]] = []
        for number, event in self._kept(run, where):
            heapq.heappush(waiting, (event.key, number, event))
            while waiting and waiting[0][0][0] < earliest_ns[number + 1]:
                yield heapq.heappop(waiting)[-1]
            if number % spilled.ROWS == 0:
                spilled.give_back()
        while waiting:
            yield heapq.heappop(waiting)[-1]

    def _earliest_left(self, run: session.Session, where: str) -> Ints:
        """Earliest stamp of each message's event and of all that were recorded after it [ns].

        A sensor's event has the stamp of its message, which need not be decoded for that.
        """
        for step in self.steps:
            run.engine.clock.note(step)
        stamps, counted = spilled.Rows(np.int64), Counter[str]()
        for topic, stamp_ns, message in self._timed():
            if message is None:
                offset_ns = run.engine.clock.offset_ns(topic, counted[topic]) if self.steps else 0
                stamps.add(stamp_ns + offset_ns)
            else:
                event = _event_of(run, topic, message(), where)
                stamps.add(NEVER_NS if event is None else event.stamp_ns)
            counted[topic] += 1
        stamps.add(NEVER_NS)
        earliest_ns, after_ns = stamps.array(), NEVER_NS
        for part in reversed([*spilled.parts(len(earliest_ns))]):
            backwards = np.minimum.accumulate(earliest_ns[part][::-1])
            earliest_ns[part] = np.minimum(backwards[::-1], after_ns)
            after_ns = int(earliest_ns[part.start])
        spilled.give_back()
        return earliest_ns

    def _timed(self) -> Iterator[Timed]:
        if isinstance(self.messages, Heard):
            return self.messages.timed()
        return ((topic, 0, partial(_same, message)) for topic, message in self.messages)

    def _kept(self, run: session.Session, where: str) -> Iterator[tuple[int, Event]]:
        """Events as they were recorded, without those that the live node refused, numbered."""
        refused = Counter(refusal_key(r) for r in self.refused)
        for step in self.steps:
            run.engine.clock.note(step)
        for number, (topic, message) in enumerate(self.messages):
            event = _event_of(run, topic, message, where)
            if event is None:
                continue
            key = event_key(event) if refused else None
            if key is not None and refused[key]:
                refused[key] -= 1
            elif self.until_ns is None or event.stamp_ns <= self.until_ns:
                yield number, event

    def matching(self, topic: str, replayed: list[bytes]) -> tuple[list[bytes], int]:
        """Replayed messages of a topic, without those that no recorder could have.

        And how many of those came before the recorder had found the topic: only as many as explain
        why what was recorded is something else. Messages that were published right before the end
        of a node that was killed may be on their way still.
        """
        live = self.live[topic]
        limit = len(live) if self.torn or self.until_ns is not None else None
        # A recorder that was late by more lacks inputs, too: the replay begins where it does.
        late = [0, self.unheard.get(topic, 0)]
        if self.found_ns:
            ends = (k for k, data in enumerate(replayed) if stamp_in(data) > self.found_ns)
            late += range(1, next(ends, len(replayed)) + 1)
        missed = next((k for k in late if replayed[k:][:limit] == live), 0)
        return replayed[missed:][:limit], missed

    @property
    def published(self) -> bool:
        """Whether it published anything."""
        return self.live.any if isinstance(self.live, Live) else any(self.live.values())

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps of its first and last estimate [ns]; None without one."""
        states = self.live[topics.STATE]
        if not states:
            return None
        first, last = (
            to_ns(deserialize_message(d, NavState).header.stamp) for d in (states[0], states[-1])
        )
        return first, last


def _event_of(
    run: session.Session,
    topic: str,
    message: Any,  # noqa: ANN401 - of the topic
    where: str,
) -> Event | None:
    try:
        event = run.recorded_event_of(topic, message)
    except ValueError as error:
        raise BagError(f'{where}/{topic} makes no sense: {error}') from error
    # Contents of packets, for people: the live run published them, a replay does not.
    for _ in run.decoded():
        pass
    return event


def _same(message: Any) -> Any:  # noqa: ANN401 - of any topic
    return message


def never_an_event(receipt: Any) -> bool:  # noqa: ANN401 - a FixReceipt
    """Whether a message was refused for its stamp, before it reached the engine.

    A fix from the future was an event: its receipt names a source.
    """
    return receipt.verdict == Verdict.TOO_LATE or (
        receipt.verdict == Verdict.FROM_FUTURE and not receipt.source
    )


def refusal_key(r: Receipt) -> tuple[str, str, int, int]:
    """Key of a refused message, from its receipt."""
    return (r.topic, r.source, r.sequence, r.receive_ns or r.validity_ns)


def event_key(event: Event) -> tuple[str, str, int, int]:
    """Key of a refused message, from its event."""
    source = event.source if isinstance(event, Fix) else ''
    return (event.topic, source, event.sequence, event.stamp_ns)
