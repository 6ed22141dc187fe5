"""Lives of a follower in a bag: one that is killed and started again begins anew in the same bag.

Each life is replayed by itself, from the first message of each topic that its node took (it names
them on nav/clock, where it has a state file) and, where it was restored, from the saved state
that it published. A node that was killed has processed everything before its last output, and
nothing that counts after it; what came until the next one was started, nobody has taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from rclpy.serialization import deserialize_message

from polar_nav_core.engine.events import ClockStep, Event, Fix, Receipt, Verdict
from polar_nav_follower import session
from polar_nav_msgs.msg import Command, FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Taken
from polar_nav_ros.navigation_outputs import receipt_from_msg
from polar_nav_ros.navigation_session import MODEL_OUTPUTS
from polar_nav_ros.stamps import stamp_ns_of_cdr, to_ns

from ..bags.errors import BagError

TYPES: dict[str, type[Any]] = {
    topics.STATE: NavState,
    topics.RECEIPT: FixReceipt,
    **MODEL_OUTPUTS,
}
"""Outputs that a replay reproduces."""
_OWN = (topics.COMMAND, topics.RESTORE)
"""Inputs that the node itself publishes."""
_NO_LIMIT = 1 << 62


@dataclass(frozen=True)
class Life:
    """What one process of a follower took and published.

    Attributes
    ----------
    messages : list of (str, message)
        Inputs by topic without the vehicle, each topic in its order.
    live : mapping of str to list of bytes
        What it published on the compared topics; up to the hole in a recording that has one.
    refused : list of Receipt
        What it refused because it came too late.
    steps : list of ClockStep
        Of the clocks of its topics, as it found them.
    arrivals_ns : list of int
        When the messages were recorded [ns].
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
    """

    messages: list[tuple[str, Any]]
    live: Mapping[str, list[bytes]]
    refused: list[Receipt]
    steps: list[ClockStep] = field(default_factory=list)
    arrivals_ns: list[int] = field(default_factory=list)
    until_ns: int | None = None
    torn: bool = False
    dropped: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    unheard: Mapping[str, int] = field(default_factory=dict)

    def events(self, run: session.Session, where: str) -> list[Event]:
        """Events in their total order, without those that the live node refused.

        Raises
        ------
        BagError
            For a message that can be decoded and still makes no sense; ``where`` precedes its
            topic.
        """
        refused = Counter(refusal_key(r) for r in self.refused)
        events: list[Event] = []
        for step in self.steps:
            run.engine.clock.note(step)
        for topic, message in self.messages:
            try:
                event = run.recorded_event_of(topic, message)
            except ValueError as error:
                raise BagError(f'{where}/{topic} makes no sense: {error}') from error
            if event is None:
                continue
            key = event_key(event)
            if refused[key]:
                refused[key] -= 1
            elif self.until_ns is None or event.stamp_ns <= self.until_ns:
                events.append(event)
        # Contents of packets, for people: the live run published them, a replay does not.
        for _ in run.decoded():
            pass
        events.sort(key=lambda e: e.key)
        return events

    def decided(self, events: Iterable[Event]) -> Counter[str]:
        """Number of messages by topic that a node processed or refused."""
        return Counter(e.topic for e in (*events, *self.refused))

    def matching(self, topic: str, replayed: list[bytes]) -> list[bytes]:
        """Replayed messages of a topic, without those that no recorder could have.

        Messages that were published right before the end of a node that was killed may be on their
        way still; the first ones may have come before the recorder found the topic.
        """
        live = self.live[topic]
        limit = len(live) if self.torn or self.until_ns is not None else None
        late = self.unheard.get(topic, 0)
        # A recorder that was late by more lacks inputs, too: the replay begins where it does.
        if late and replayed[:limit] != live and replayed[late:][:limit] == live:
            return live
        return replayed[:limit]

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


class Records:
    """Messages of a follower in the order of its bag, each with its place in it.

    Parameters
    ----------
    by_name : mapping of str to str
        Topics without the vehicle by their full names.
    compared : iterable of str
        Topics of its outputs.
    """

    def __init__(self, by_name: Mapping[str, str], compared: Iterable[str]) -> None:
        self.by_name = by_name
        self.compared = tuple(compared)
        self.inputs: list[tuple[int, str, Any, int]] = []
        self.outputs: list[tuple[int, str, bytes]] = []
        self.steps: list[tuple[int, ClockStep]] = []
        self.ends: list[tuple[int, Mapping[str, int]]] = []
        self.births: list[int] = []
        self.holes: list[int] = []
        self._place = 0
        self._of: dict[tuple[str, int], list[int]] = {}

    def of(self, start: ClockStep) -> list[int]:
        """Places of the messages on the topic of a start that have its stamp."""
        if not self._of:
            for place, topic, message, _ in self.inputs:
                key = topic, stamp_of(message)
                self._of.setdefault(key, []).append(place)
        return self._of.get((start.topic, start.own_ns), [])

    def input(self, topic: str, message: Any, arrival_ns: int) -> None:  # noqa: ANN401
        """Add a message that a node may have taken."""
        self.inputs.append((self._next(), topic, message, arrival_ns))

    def output(self, topic: str, data: bytes) -> None:
        """Add a message that it published."""
        self.outputs.append((self._next(), topic, data))

    def step(self, step: ClockStep) -> None:
        """Add a step of a clock, or the start of a topic."""
        self.steps.append((self._next(), step))

    def end(self, taken: Mapping[str, int]) -> None:
        """Add the orderly end of a node, with the messages taken per full topic name."""
        self.ends.append((self._next(), taken))

    def born(self) -> None:
        """Add the description of a node: nothing after it is of the one before.

        A recorder that is started again hears it once more.
        """
        self.births.append(self._next())

    def hole(self) -> None:
        """Add a hole in the recording."""
        self.holes.append(self._next())

    def _next(self) -> int:
        self._place += 1
        return self._place


def lives_of(records: Records, imu: str, *, injected: bool = False) -> list[Life]:
    """Lives in a bag, one at least; those that published nothing are left out.

    Parameters
    ----------
    records : Records
    imu : str
        Topic of the IMU, with whose first message a life begins.
    injected : bool
        Whether faults were put into the bag: what was counted is of other messages.
    """
    if injected:
        return [_life(records, (0, _NO_LIMIT), {}, last=True, limited=False)]
    bounds = [*_begins(records, imu), _NO_LIMIT]
    if len(bounds) == 1 or any(place < bounds[0] for place, *_ in records.outputs):
        bounds.insert(0, 0)  # from before the recording, or without a state file
    found: list[Life] = []
    taken_to: dict[str, int] = {}
    for begin, end in pairwise(bounds):
        last = end == _NO_LIMIT
        starts = _starts(records, begin, end, taken_to)
        if starts is not None:
            taken_to |= starts
        life = _life(records, (begin, end), starts, last=last)
        if any(life.live.values()) or (last and not found):
            found.append(life)
    return found


def _begins(records: Records, imu: str) -> list[int]:
    """Place from which on each life that names its first messages is recorded."""
    out: list[int] = []
    before = 0
    for place, step in records.steps:
        if step.is_start and step.topic == imu:
            own = [born for born in records.births if before < born < place]
            out.append(own[-1] if own else place)
            before = place
    return out


def _starts(
    records: Records, begin: int, end: int, after: Mapping[str, int]
) -> dict[str, int] | None:
    """Place of the first message that a life took, by topic; None where it names none.

    Of messages with the same stamp it is the one that was recorded nearest to its naming.
    """
    named = [(p, step) for p, step in records.steps if begin <= p < end and step.is_start]
    found: dict[str, int] = {}
    for place, step in named:
        same = [k for k in records.of(step) if k > after.get(step.topic, 0)]
        # One that the recorder has lost: the node took those that came after it, too.
        found[step.topic] = min(same, key=lambda k: abs(k - place), default=place)
    return found if named else None


def _life(
    records: Records,
    bounds: tuple[int, int],
    starts: Mapping[str, int] | None,
    *,
    last: bool,
    limited: bool = True,
) -> Life:
    begin, end = bounds
    published: dict[str, list[bytes]] = {topic: [] for topic in records.compared}
    live: dict[str, list[bytes]] = {topic: [] for topic in records.compared}
    hole = next((place for place in records.holes if begin <= place < end), _NO_LIMIT)
    newest = begin
    for place, topic, data in records.outputs:
        if begin <= place < end:
            published[topic].append(data)
            newest = place
            if place < hole:
                live[topic].append(data)
    limits = next((t for p, t in reversed(records.ends) if begin <= p < end), None)
    # The last one, too, where it names its starts: it was not started again, or runs still.
    killed = limits is None and limited and (not last or bool(starts))
    most = {
        topic: _NO_LIMIT if limits is None or not limited else limits.get(full, _NO_LIMIT)
        for full, topic in records.by_name.items()
    }
    heard: list[tuple[str, Any, int]] = []
    for place, topic, message, arrival_ns in records.inputs:
        if topic in _OWN or isinstance(message, Taken):
            # The node itself has published it, or that it used it.
            if not begin <= place < end:
                continue
        else:
            first = starts.get(topic, _NO_LIMIT) if starts else 0
            if place < first or (killed and place > newest):
                continue
        heard.append((topic, message, arrival_ns))
    receipts = [deserialize_message(d, FixReceipt) for d in published[topics.RECEIPT]]
    heard = _with_a_receipt(heard, receipts, most.get(topics.RX, _NO_LIMIT))
    newest_ns = _newest_ns(published)
    came = Counter(t for t, m, _ in heard if t not in _OWN and stamp_of(m) <= newest_ns)
    messages: list[tuple[str, Any]] = []
    arrivals_ns: list[int] = []
    taken: Counter[str] = Counter()
    for topic, message, arrival_ns in heard:
        taken[topic] += 1
        if taken[topic] <= most.get(topic, _NO_LIMIT):
            messages.append((topic, message))
            arrivals_ns.append(arrival_ns)
    return Life(
        messages=messages,
        live=live,
        refused=[receipt_from_msg(r) for r in receipts if never_an_event(r)],
        steps=[s for p, s in records.steps if begin <= p < end and not s.is_start],
        arrivals_ns=arrivals_ns,
        until_ns=newest_ns if killed else None,
        torn=hole != _NO_LIMIT,
        dropped={t: (n - most[t], n) for t, n in came.items() if n > most.get(t, _NO_LIMIT)},
    )


def _with_a_receipt(
    heard: list[tuple[str, Any, int]], receipts: list[FixReceipt], most: int
) -> list[tuple[str, Any, int]]:
    """Messages without the packets that a node never took of more than its queue holds.

    In a flood the middleware drops packets for the node that the recorder gets. The node gives
    every packet that it takes a receipt with its time of reception, and has counted them.
    """
    packets = sum(topic == topics.RX for topic, _, _ in heard)
    times = Counter(
        to_ns(r.receive_time) for r in receipts if r.topic == topics.RX and not r.revision
    )
    if packets <= most or times.total() != most:
        return heard
    kept = []
    for topic, message, arrival_ns in heard:
        if topic == topics.RX:
            time_ns = to_ns(message.receive_time)
            if not times[time_ns]:
                continue
            times[time_ns] -= 1
        kept.append((topic, message, arrival_ns))
    return kept


def stamp_of(message: Any) -> int:  # noqa: ANN401 - of any topic
    """Stamp of an input [ns], of a mapped source that with which it counted."""
    return message.stamp_ns if isinstance(message, Taken) else to_ns(message.header.stamp)


def _newest_ns(live: Mapping[str, list[bytes]]) -> int:
    """Stamp of the newest output [ns], of whatever version; 0 without one."""
    return max((stamp_ns_of_cdr(d[-1]) for d in live.values() if d), default=0)


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


def taken_counts(shutdown: Command) -> dict[str, int]:
    """Messages per full topic name that a node had received at its end, from its last command.

    Raises
    ------
    BagError
        When the command has not one count for each topic: its bytes were changed.
    """
    names, counts = list(shutdown.taken_topics), [int(n) for n in shutdown.taken_counts]
    if len(names) != len(counts):
        raise BagError(
            f'the last message on {topics.COMMAND} is damaged: it names {len(names)} topics and '
            f'{len(counts)} counts'
        )
    return dict(zip(names, counts, strict=True))
