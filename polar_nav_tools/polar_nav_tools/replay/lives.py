"""Lives of a follower in a bag: one that is killed and started again begins anew in the same bag.

Each life is replayed by itself, from the first message of each topic that its node took (it names
them on nav/clock, where it has a state file) and, where it was restored, from the saved state
that it published. A node that was killed has processed everything before its last output, and
nothing that counts after it; what came until the next one was started, nobody has taken.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from polar_nav_core import spilled
from polar_nav_core.arrays import Ints
from polar_nav_core.engine.events import ClockStep, Event, Fix, OrderKey
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.order import NEVER_NS
from polar_nav_follower import session
from polar_nav_msgs.msg import Command, FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.navigation_outputs import receipt_from_msg
from polar_nav_ros.navigation_session import MODEL_OUTPUTS
from polar_nav_ros.stamps import to_ns

from ..bags.errors import BagError
from .records import Heard, Live, Records, Timed

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
    first = records.outputs['place'][:1]
    if len(bounds) == 1 or (first < bounds[0]).any():
        bounds.insert(0, 0)  # from before the recording, or without a state file
    found: list[Life] = []
    taken_to: dict[str, int] = {}
    for begin, end in pairwise(bounds):
        last = end == _NO_LIMIT
        starts = _starts(records, begin, end, taken_to)
        if starts is not None:
            taken_to |= starts
        life = _life(records, (begin, end), starts, last=last)
        if life.published or (last and not found):
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
    outputs = records.outputs
    mine = (outputs['place'] >= begin) & (outputs['place'] < end)
    hole = next((place for place in records.holes if begin <= place < end), _NO_LIMIT)
    newest = int(outputs['place'][mine].max(initial=begin))
    limits = next((t for p, t in reversed(records.ends) if begin <= p < end), None)
    # The last one, too, where it names its starts: it was not started again, or runs still.
    killed = limits is None and limited and (not last or bool(starts))
    most = {
        topic: _NO_LIMIT if limits is None or not limited else limits.get(full, _NO_LIMIT)
        for full, topic in records.by_name.items()
    }
    inputs = records.inputs

    def may_be_mine(rows: NDArray[Any]) -> NDArray[np.bool_]:
        found = np.zeros(len(rows), dtype=bool)
        place = rows['place']
        for topic, number in records.topics.items():
            if topic in _OWN or topic in records.mapped:
                # The node itself has published it, or that it used it.
                wanted = (place >= begin) & (place < end)
            else:
                wanted = place >= (starts.get(topic, _NO_LIMIT) if starts else 0)
                if killed:
                    wanted &= place <= newest
            found |= wanted & (rows['topic'] == number)
        return found

    heard = spilled.by_rows(may_be_mine, inputs)
    refused: list[Receipt] = []
    times: Counter[int] = Counter()
    for at, data in records.receipts:
        if begin <= at < end:
            receipt = deserialize_message(data, FixReceipt)
            if never_an_event(receipt):
                refused.append(receipt_from_msg(receipt))
            if receipt.topic == topics.RX and not receipt.revision:
                times[to_ns(receipt.receive_time)] += 1
    _keep_those_with_a_receipt(records, heard, times, most.get(topics.RX, _NO_LIMIT))
    newest_ns = _newest_ns(records, mine)
    dropped: dict[str, tuple[int, int]] = {}
    for topic, number in records.topics.items():
        limit = most.get(topic, _NO_LIMIT)
        taken = came = 0
        for part in spilled.parts(len(inputs)):
            rows = part.start + np.flatnonzero(heard[part] & (inputs['topic'][part] == number))
            came += int((inputs['stamp_ns'][rows] <= newest_ns).sum())
            heard[rows[max(0, limit - taken) :]] = False
            taken += len(rows)
        if topic not in _OWN and came > limit:
            dropped[topic] = came - limit, came
    return Life(
        messages=Heard(records, heard),
        live=Live(records.read_outputs, records.compared, mine & (outputs['place'] < hole)),
        refused=refused,
        steps=[s for p, s in records.steps if begin <= p < end and not s.is_start],
        arrivals_ns=() if limited else inputs['arrival_ns'][heard],
        until_ns=newest_ns if killed else None,
        torn=hole != _NO_LIMIT,
        dropped=dropped,
    )


def _keep_those_with_a_receipt(
    records: Records, heard: NDArray[np.bool_], times: Counter[int], most: int
) -> None:
    """Leave out the packets that a node never took of more than its queue holds.

    In a flood the middleware drops packets for the node that the recorder gets. The node gives
    every packet that it takes a receipt with its time of reception (``times``), and has counted
    them.
    """
    number = records.number(topics.RX)
    packets = spilled.by_rows(lambda r, h: h & (r['topic'] == number), records.inputs, heard)
    if np.count_nonzero(packets) <= most or times.total() != most:
        return
    for row, (topic, message) in enumerate(records.read_inputs()):
        if topic == topics.RX and packets[row]:
            time_ns = to_ns(message().receive_time)
            heard[row] = times[time_ns] > 0
            times[time_ns] -= 1


def _newest_ns(records: Records, mine: NDArray[np.bool_]) -> int:
    """Stamp of the newest output [ns], by the last one of each topic; 0 without one."""
    outputs, newest_ns = records.outputs, 0
    for topic in records.compared:
        rows = np.flatnonzero(mine & (outputs['topic'] == records.number(topic)))
        if len(rows):
            newest_ns = max(newest_ns, int(outputs['stamp_ns'][rows[-1]]))
    return newest_ns


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
