"""Recording without ROS: log times, counts and losses of messages.

Comes in: serialized messages, in bursts, as the node takes them from its subscriptions. Goes out:
the same bytes in a bag (`polar_nav_tools.bags.writer`), in an order and with times that make
sense:

- `reception`: log time is when the message arrived at this computer, by its system clock.
- `simulation`: log time is simulated time: that of the message's header stamp, but never later
  than simulated now (the newest `/clock`, or, without one, the newest header stamp) and never
  before the message recorded last. A delayed acoustic packet thus stands where it arrived, and the
  wall clock stamp of a diagnostic message does no harm.

In both, log time never goes back, and messages of one topic keep the order in which they arrived.
Publish time is the header stamp, the time of validity, where there is one, else the log time; and
never later than that.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..bags.qos import Qos
from ..bags.schemas import definition
from ..bags.writer import BagWriter

CLOCK_TYPE = 'rosgraph_msgs/msg/Clock'
# Their stamps are of the wall clock, also in a simulation, where they mean nothing.
_WALL_CLOCK_PACKAGES = ('diagnostic_msgs', 'rcl_interfaces')
_STAMP = {0: struct.Struct('>iI'), 1: struct.Struct('<iI')}
_STAMP_END = 12
_S = 1_000_000_000


@dataclass
class TopicCount:
    """Number and bytes of the messages recorded of one topic.

    `lost` counts holes in the publisher's own numbers; None when several publishers share the
    topic, whose numbers then say nothing. `recorded` is whether the present file has the topic,
    `before` what was lost before that file. `unheard` is what its publisher had published before
    the first message that came here. `kept` is whether publishers keep messages for who finds them
    late, whose stamps say nothing of the present.
    """

    type: str
    header: bool
    kept: bool = False
    count: int = 0
    bytes: int = 0
    lost: int | None = 0
    last_publication: int | None = None
    last_key: int = 0
    recorded: bool = False
    before: int = 0
    unheard: int = 0
    offered: Sequence[Qos] = ()


@dataclass(frozen=True)
class Rotation:
    """When a bag goes on in a next file.

    Attributes
    ----------
    open_next : callable
        Makes the writer of that file.
    max_bytes : int
        Of a file [bytes]; 0: any.
    max_ns : int
        Log time in a file [ns]; 0: any.
    """

    open_next: Callable[[], BagWriter]
    max_bytes: int = 0
    max_ns: int = 0

    def is_due(self, size: int, span_ns: int) -> bool:
        """Whether a file of a size [bytes] and a span of log time [ns] is full."""
        return 0 < self.max_bytes <= size or 0 < self.max_ns <= span_ns


@dataclass(order=True)
class _Waiting:
    """A message of the current burst, sorted by time, then by order of arrival."""

    key: int
    place: int
    topic: str = field(compare=False)
    data: bytes = field(compare=False)
    stamp_ns: int | None = field(compare=False)
    kept: bool = field(compare=False)


class Recording:
    """One bag being recorded.

    Parameters
    ----------
    writer : BagWriter
        Where it goes.
    simulated : bool
        Log time is simulated time, not that of reception.
    offered : callable
        From a topic to the profiles that its publishers offer, asked at its first message.
    rotation : Rotation, optional
        When the bag goes on in a next file.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        simulated: bool,
        offered: Callable[[str], Sequence[Qos]] = lambda _: (),
        rotation: Rotation | None = None,
    ) -> None:
        self._writer = writer
        self._rotation = rotation
        self._bytes: Counter[str] = Counter()  # in the present file
        self._file_ns: int | None = None
        self._finished: dict[Path, dict[str, Any]] = {}
        self._simulated = simulated
        self._offered = offered
        self._topics: dict[str, TopicCount] = {}
        self._burst: list[_Waiting] = []
        self._now_ns = 0
        self._has_clock = False
        self._last_ns = 0

    @property
    def topics(self) -> dict[str, TopicCount]:
        """Counts per topic."""
        return self._topics

    @property
    def message_count(self) -> int:
        """Number of messages recorded so far, of all topics."""
        return sum(t.count for t in self._topics.values())

    @property
    def byte_count(self) -> int:
        """Number of bytes of the messages recorded so far."""
        return sum(t.bytes for t in self._topics.values())

    @property
    def lost(self) -> int:
        """Number of messages known to be lost before the recorder."""
        return sum(t.lost or 0 for t in self._topics.values())

    @property
    def file_bytes(self) -> int:
        """Size of the file so far [bytes]."""
        return self._writer.size

    @property
    def waiting(self) -> int:
        """Number of messages not yet written because simulated time is still unknown."""
        return len(self._burst)

    def add_topic(self, topic: str, type_name: str, *, kept: bool = False) -> None:
        """Add a topic to the bag; ``kept`` as of `TopicCount`.

        Raises
        ------
        BagError
            If its type is not installed.
        """
        described = definition(type_name)
        header = described.has_header or described.type == CLOCK_TYPE
        if self._simulated and described.type.startswith(_WALL_CLOCK_PACKAGES):
            header = False
        self._topics.setdefault(topic, TopicCount(described.type, header, kept))

    def take(
        self, topic: str, data: bytes, received_ns: int, publication: int | None = None
    ) -> None:
        """Queue one message for the next `commit`.

        Parameters
        ----------
        topic, data : str, bytes
            A topic that was added, and the serialized message.
        received_ns : int
            When it arrived, system clock.
        publication : int, optional
            Its number by the publisher's count, if the topic has one publisher only.
        """
        entry = self._topics[topic]
        entry.count += 1
        entry.bytes += len(data)
        _count_losses(entry, publication)
        stamp = _stamp_ns(data) if entry.header else None
        key = received_ns
        if self._simulated:
            key = self._now_ns if stamp is None else stamp
            if stamp is not None and not entry.kept:
                self._advance(entry.type, stamp)
        entry.last_key = key = max(key, entry.last_key)
        self._burst.append(_Waiting(key, len(self._burst), topic, data, stamp, entry.kept))

    def commit(self) -> None:
        """Write the queued messages in the order of their times.

        Raises
        ------
        BagError
            When the file cannot be written any more.
        """
        if self._simulated and not self._now_ns:
            return  # no time to file it under yet: only descriptions come before the simulation
        self._write_burst()
        self._writer.tick()

    def finish(self, **facts: object) -> Path:
        """Directory of the bag, after writing all messages and counts."""
        self._write_burst()
        for name in self._topics:
            self._declare(name)
        return self._writer.finish({'recording': {**self._of_file(), **facts}}, self._finished)

    def _of_file(self) -> dict[str, object]:
        """Counts of the present file, for its end."""
        counts = self._writer.counts
        topics = {
            name: {
                'count': counts[name],
                'bytes': self._bytes[name],
                'lost': None if t.lost is None else t.lost - t.before,
                'unheard': t.unheard,
            }
            for name, t in sorted(self._topics.items())
            if t.recorded
        }
        return {'state': 'finished', 'message_count': sum(counts.values()), 'topics': topics}

    def _rotate(self, rotation: Rotation) -> None:
        """End the present file, and go on in a next one."""
        self._writer.finish_file({'recording': self._of_file()})
        self._finished[self._writer.path] = self._writer.metadata
        self._writer = rotation.open_next()
        self._bytes.clear()
        self._file_ns = None
        for entry in self._topics.values():
            entry.recorded, entry.before, entry.unheard = False, entry.lost or 0, 0

    def abandon(self) -> None:
        """Close the file without finishing the bag."""
        self._writer.abandon()

    def _advance(self, type_name: str, stamp_ns: int) -> None:
        if type_name == CLOCK_TYPE:
            if not self._has_clock:  # from now on the only source of time
                self._has_clock, self._now_ns = True, 0
            self._now_ns = max(self._now_ns, stamp_ns)
        elif not self._has_clock:
            self._now_ns = max(self._now_ns, stamp_ns)

    def _write_burst(self) -> None:
        burst, self._burst = self._burst, []
        burst.sort()
        if self._simulated and self._last_ns == 0 and burst:
            # What came before the simulation stands right before its first message.
            times = [w.key for w in burst if 0 < w.key <= self._now_ns and not w.kept]
            self._last_ns = min(times, default=self._now_ns)
        for w in burst:
            time_ns = w.key if not self._simulated else min(w.key, self._now_ns)
            self._last_ns = time_ns = max(time_ns, self._last_ns)
            if self._file_ns is None:
                self._file_ns = time_ns
            elif self._rotation is not None and self._rotation.is_due(
                self._writer.size, time_ns - self._file_ns
            ):
                self._rotate(self._rotation)
                self._file_ns = time_ns
            self._declare(w.topic)
            self._bytes[w.topic] += len(w.data)
            # A stamp may lie ahead of the clock that messages are filed by; a publication cannot.
            publish_ns = min(w.stamp_ns, time_ns) if w.stamp_ns else time_ns
            self._writer.write(w.topic, w.data, time_ns, publish_ns)

    def _declare(self, topic: str) -> None:
        entry = self._topics[topic]
        if not entry.recorded:
            entry.recorded = True
            entry.offered = entry.offered or tuple(self._offered(topic))
            self._writer.add_topic(topic, entry.type, offered=entry.offered)


def _count_losses(entry: TopicCount, publication: int | None) -> None:
    if publication is None:
        entry.lost = None
    elif entry.lost is not None:
        last = entry.last_publication
        if last is None:
            entry.unheard = publication - 1  # publishers count from 1
        elif publication > last + 1:
            entry.lost += publication - last - 1
        entry.last_publication = publication  # smaller than before: the publisher was restarted


def _stamp_ns(data: bytes) -> int | None:
    """Stamp [ns] in the first eight bytes of a message's content; None without a valid one."""
    if len(data) < _STAMP_END or data[0] != 0 or data[1] not in _STAMP:
        return None
    seconds, nanoseconds = _STAMP[data[1]].unpack_from(data, 4)
    stamp = int(seconds) * _S + int(nanoseconds)
    return stamp if stamp > 0 else None
