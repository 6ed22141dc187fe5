"""A bag with injected faults, for a filter to be run on it.

In: a recorded bag. Out: another one with the same messages but for the faults, and without what
the follower published: no live run has received these messages. It states in the description of
its run what was injected. A pure function of the bag, the faults and the seed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import inputs_of
from polar_nav_msgs.msg import AcousticPacket
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.navigation_session import SENSORS

from ..bags.errors import BagError
from ..bags.reader import Bag, BagMessage
from ..bags.recover import add_topic
from ..bags.run_records import INJECTED_KEY
from ..bags.writer import BagWriter
from ..replay.recorded import choose_description
from .faults import Injection, inject
from .messages import STREAM_OF, change, reading_of
from .readings import Reading

_TYPES: dict[str, type[Any]] = {**SENSORS, topics.RX: AcousticPacket}
_OUTPUTS = (
    topics.STATE, topics.RECEIPT, topics.HEALTH, topics.CURRENT, topics.MODEL,
    topics.IDENTIFICATION, topics.FIX, topics.ODOMETRY, topics.DECODED, topics.STATION_DECODED,
    topics.CLOCK_STEP,
)  # fmt: skip
"""What a follower publishes, which an injected bag has not."""


@dataclass(frozen=True)
class Injected:
    """Result of `inject_bag`.

    Attributes
    ----------
    target : Path
        The new bag.
    faults : tuple of str
        As stated in it.
    changed, left_out, added : int
        Messages with other content, stamp or arrival; those that are gone; those that were added.
    """

    target: Path
    faults: tuple[str, ...]
    changed: int
    left_out: int
    added: int

    def to_dict(self) -> dict[str, Any]:
        """Result as values for JSON."""
        return {
            'path': str(self.target),
            'faults': list(self.faults),
            'changed': self.changed,
            'left_out': self.left_out,
            'added': self.added,
        }


def inject_bag(
    bag: Bag, injections: Sequence[Injection], target: Path, seed: int, vehicle: str | None = None
) -> Injected:
    """Result of writing a bag with faults.

    Parameters
    ----------
    bag : Bag
    injections : sequence of Injection
    target : Path
        Directory of the new bag; must not exist.
    seed : int
        Of what faults draw at random.
    vehicle : str, optional
        Which follower receives the faults, when there are several.

    Raises
    ------
    BagError
        For a bag without a follower, or with faults already.
    ConfigError
        For a fault that the bag cannot have.
    """
    if bag.injected:
        raise BagError(f'{bag.path} has injected faults already ({bag.injected})')
    name, described = choose_description(bag, vehicle)
    params = from_mapping(FollowerParams, described.params)
    _require_mode(injections, params.mode)
    streams = {f'/{name}/{t}': STREAM_OF[t] for t in inputs_of(params) if t in STREAM_OF}
    gone = {f'/{name}/{t}' for t in _OUTPUTS}
    records = [r for r in bag.records() if r.topic not in gone]
    before = {
        n: reading_of(streams[r.topic], n, _decoded(name, r), r.log_time_ns)
        for n, r in enumerate(records)
        if r.topic in streams
    }
    after = inject(list(before.values()), injections, seed)
    faults = tuple(one.text for one in injections)
    merged = _merged(records, before, after)
    info = _counted(bag.run_info, Counter(record.topic for _, record in merged))
    info[INJECTED_KEY] = {'faults': faults, 'seed': seed, 'of': bag.path.name}
    with BagWriter(target, info) as writer:
        for topic in bag.topics:
            if topic not in gone:
                add_topic(writer, bag, topic)
        for reading, record in merged:
            old = None if reading is None else before[reading.number]
            if reading is None or old is None or reading is old:
                writer.write(*_unchanged(record, counted_anew=reading is not None))
                continue
            message = _decoded(name, record)
            try:
                change(message, old, reading)
            except ValueError as error:
                raise ConfigError(f'no message can hold this fault: {error}') from error
            published_ns = record.publish_time_ns + reading.arrival_ns - old.arrival_ns
            writer.write(record.topic, to_bytes(message), reading.arrival_ns, published_ns)
        writer.finish()
    kept = [r.number for r in after]
    return Injected(
        target,
        faults,
        changed=sum(r is not before[r.number] for r in after),
        left_out=len(before) - len(set(kept)),
        added=len(kept) - len(set(kept)),
    )


def _counted(run_info: Mapping[str, Any], counts: Mapping[str, int]) -> dict[str, Any]:
    """Description of the run with the recorder's counts for the messages that there are now."""
    recording = run_info.get('recording')
    if not isinstance(recording, dict) or not isinstance(recording.get('topics'), dict):
        return dict(run_info)
    topics_now = {
        name: {**facts, 'count': counts[name]} if isinstance(facts, dict) else facts
        for name, facts in recording['topics'].items()
        if name in counts
    }
    return {**run_info, 'recording': {**recording, 'topics': topics_now}}


def _unchanged(
    record: BagMessage, *, counted_anew: bool
) -> tuple[str, bytes, int, int, int | None]:
    """Arguments of `BagWriter.write`; topics of other messages keep their numbers."""
    number = None if counted_anew else record.sequence
    return record.topic, record.data, record.log_time_ns, record.publish_time_ns, number


def _require_mode(injections: Sequence[Injection], mode: str) -> None:
    for one in injections:
        if mode not in one.fault.modes:
            have = ' or '.join(one.fault.modes)
            raise ConfigError(f'{one.text} is of mode {have}; the follower ran in mode {mode}')


def _decoded(vehicle: str, record: BagMessage) -> Any:  # noqa: ANN401 - of the topic
    kind = _TYPES[record.topic.removeprefix(f'/{vehicle}/')]
    try:
        return deserialize_message(record.data, kind)
    except (RuntimeError, ValueError, MemoryError) as error:
        raise BagError(f'a message on {record.topic} is no {kind.__name__} message') from error


def _merged(
    records: list[BagMessage], before: dict[int, Reading], after: list[Reading]
) -> list[tuple[Reading | None, BagMessage]]:
    """All messages in the order of their arrival; those that arrive at once as in the bag."""
    others = [(r.log_time_ns, n, None, r) for n, r in enumerate(records) if n not in before]
    inputs = [(r.arrival_ns, r.number, r, records[r.number]) for r in after]
    both = sorted([*others, *inputs], key=lambda item: item[:2])
    return [(reading, record) for _, _, reading, record in both]
