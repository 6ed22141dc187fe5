"""An opened bag: topics, messages, and its problems, known before anything is read from it.

In: a bag directory or an .mcap file, finished, unfinished, cut off or damaged. Out: `Bag`, with
topics and counts, the run's description, serialized or decoded messages in the order of the file,
and `problems`: one sentence for each missing part. A bag without problems is whole: every checksum
was compared and every count agrees.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from polar_nav_ros.topics import RUN_INFO

from . import chunks
from .contents import Channel, FileScan, Tally, numbers_of
from .decode import Decoder
from .errors import BagError, WrongRequestError
from .problems import holes, problems_of
from .run_records import INJECTED_KEY, PHASE_KEY, json_or_none, run_records
from .schemas import Definition, starts_with_header

if TYPE_CHECKING:
    from .request import ReadAhead


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str
    type: str
    count: int


class BagMessage(NamedTuple):
    """One serialized message with its topic, times and sequence number."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


class Bag:
    """An opened bag, returned by `opening.open_bag`.

    Attributes
    ----------
    path : Path
        As given.
    files : tuple of FileScan
        The MCAP files in it, in order.
    problems : list of str
        Sentences about missing or damaged parts; empty if the bag is whole.
    remarks : tuple of str
        Sentences about how it was read, where that is worth knowing.
    read_ahead : ReadAhead or None
        Arrays read during the opening; `read_tables` returns them, once.
    """

    read_ahead: ReadAhead | None = None
    remarks: tuple[str, ...] = ()

    def __init__(self, path: Path, scans: Iterable[FileScan], problems: Iterable[str]) -> None:
        self.path = path
        self.files = tuple(scans)
        self._channels: dict[str, Channel] = {}
        for file in self.files:
            for channel in file.channels.values():
                self._channels.setdefault(channel.topic, channel)
        self._decoder = Decoder(str(path))
        self.problems = [*problems, *problems_of(self.files, self._channels)]

    @property
    def is_complete(self) -> bool:
        """Whether nothing is known to be missing."""
        return not self.problems

    @property
    def is_verified(self) -> bool:
        """Whether every byte was read and compared; at an address only what is used is."""
        return all(f.is_verified for f in self.files)

    @property
    def message_count(self) -> int:
        """Number of readable messages."""
        return sum(t.count for t in self.topics.values())

    @property
    def ignored_bytes(self) -> int:
        """Number of bytes that could not be read."""
        return sum(f.ignored_bytes for f in self.files)

    @cached_property
    def topics(self) -> dict[str, Topic]:
        """Topics by name, in order of name, topics without a message included."""
        return {
            name: Topic(name, self._channels[name].type, sum(t.count for t in self.tallies(name)))
            for name in sorted(self._channels)
        }

    def tallies(self, topic: str) -> list[Tally]:
        """Return counts, first and last log time of a topic, one for each channel that has it."""
        return list(self._tallies.get(topic, ()))

    @cached_property
    def _tallies(self) -> dict[str, list[Tally]]:
        """Tallies by topic, in one pass: a bag may have 65,000 channels."""
        found: dict[str, list[Tally]] = {}
        for file in self.files:
            for number, topic in numbers_of(file, self._channels, None).items():
                if number in file.tallies:
                    found.setdefault(topic, []).append(file.tallies[number])
        return found

    def channel(self, topic: str) -> Channel:
        """Return the channel of a topic: type, definition, metadata."""
        if topic not in self._channels:
            raise BagError(f'{self.path} has no topic {topic}; it has {listed(self.topics)}')
        return self._channels[topic]

    def definition(self, topic: str) -> Definition:
        """Return the message definition that is embedded for a topic."""
        channel = self.channel(topic)
        return Definition(
            type=channel.type,
            text=channel.schema_text,
            type_hash=channel.metadata.get('topic_type_hash', ''),
            has_header=starts_with_header(channel.schema_text),
        )

    def require(self, topics: Iterable[str], *, named: bool = False) -> None:
        """Raise BagError unless all topics have messages.

        Raises
        ------
        BagError
            Naming every one that the bag does not have; WrongRequestError where ``named`` says
            that the user did.
        """
        missing = [t for t in topics if t not in self.topics or not self.topics[t].count]
        if missing:
            have = [t.name for t in self.topics.values() if t.count]
            kind = WrongRequestError if named else BagError
            raise kind(f'{self.path} has no message on {listed(missing)}; it has {listed(have)}')

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, log time [ns], CDR bytes) in the order of the file.

        Parameters
        ----------
        topics : collection of str, optional
            Only these; all by default. One that is not in the bag has no messages (`require`).
        """
        for message in self.records(topics):
            yield message.topic, message.log_time_ns, message.data

    def records(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Yield messages in the order of the file with all their numbers."""
        for file in self.files:
            yield from _file_records(file, numbers_of(file, self._channels, topics))

    def payloads(self, topic: str) -> Iterator[bytes]:
        """Yield the CDR bytes of one topic, after checking that they are CDR.

        Raises
        ------
        BagError
            If there is none, or the topic has another encoding than ROS 2's.
        """
        self.require([topic])
        for file in self.files:
            numbers = self.channels_of(file, [topic])
            for content, usable, _ in blocks_of(file, numbers.keys()):
                yield from chunks.payloads(content, usable, numbers)

    def read(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (log time [ns], message) of one topic, decoded.

        With the installed Python class of the message where its definition is the one in the bag,
        else with a class made from the definition in the bag: field names are the same, arrays are
        NumPy arrays.

        Raises
        ------
        BagError
            If there is no such message, or one cannot be decoded.
        """
        self.require([topic])
        decode = self._decoder.for_channel(self.channel(topic))
        for _, log_time_ns, data in self.messages([topic]):
            yield log_time_ns, decode(data)

    def metadata(self, name: str) -> list[dict[str, str]]:
        """Return the MCAP metadata records of one name, in order."""
        return [m for f in self.files for record, m in f.metadata if record == name]

    @cached_property
    def run_info(self) -> dict[str, Any]:
        """Description of the run by the recorder: that of the start, updated by that of the end.

        Empty for bags of other recorders.
        """
        info: dict[str, Any] = {}
        for file in self.files:
            for _, record in run_records(file):
                info |= {k: json_or_none(v) for k, v in record.items() if k != PHASE_KEY}
        return info

    def unheard(self, topic: str) -> int:
        """Number of messages published before the recorder heard the topic; 0 where unknown."""
        # Before the first file: what came before another one may stand in the file before it.
        for _, record in run_records(self.files[0]):
            found = json_or_none(record.get('recording', ''))
            for key in ('topics', topic, 'unheard'):
                found = found.get(key) if isinstance(found, dict) else None
            if isinstance(found, int):
                return found
        return 0

    @property
    def injected(self) -> str:
        """Faults that `polar inject` put into the bag, with its seed; empty for a recording."""
        found = self.run_info.get(INJECTED_KEY)
        if not isinstance(found, dict):
            return ''
        return f'{listed(map(str, found.get("faults", ())))}, seed {found.get("seed")}'

    @cached_property
    def node_infos(self) -> dict[str, dict[str, Any]]:
        """Descriptions of nodes on /run_info: node name to {node, package, version, params}.

        Of several messages of a node the last one counts; messages of another form are ignored,
        and so are parameters that are no mapping.
        """
        found: dict[str, dict[str, Any]] = {}
        try:
            for _, message in self.read(RUN_INFO):
                content = json_or_none(getattr(message, 'data', ''))
                if isinstance(content, dict) and isinstance(content.get('node'), str):
                    if not isinstance(content.get('params', {}), dict):
                        del content['params']
                    found[content['node']] = content
        except BagError:
            return found  # no such topic, another use of its name, or a damaged message
        return found

    def node_params(self, node: str) -> dict[str, Any]:
        """Return the parameters that a node ran with.

        Parameters
        ----------
        node : str
            Fully qualified, e.g. ``/follower/follower_node``.

        Raises
        ------
        BagError
            If the bag has no description of it on /run_info.
        """
        params = self.node_infos.get(node, {}).get('params')
        if not isinstance(params, dict):
            have = listed(sorted(self.node_infos)) if self.node_infos else 'none'
            raise BagError(
                f'{self.path}: no parameters of node {node} were recorded on {RUN_INFO}; '
                f'nodes there: {have}'
            )
        return dict(params)

    def announce(self, topics: Collection[str]) -> None:
        """Tell which topics are going to be read: at an address they are then fetched together."""
        for file in self.files:
            numbers = numbers_of(file, self._channels, topics)
            file.announce([b for b in file.blocks if not b.channels.isdisjoint(numbers)])

    def channels_of(self, file: FileScan, topics: Collection[str]) -> dict[int, str]:
        """Return the channel numbers of topics in a file, after checking that they are CDR."""
        for topic in topics:
            found = self.channel(topic)
            if found.encoding != 'cdr':
                form = repr(found.encoding)
                raise BagError(f'{self.path}: {topic} is encoded as {form}, not as cdr')
        return numbers_of(file, self._channels, topics)

    @property
    def holes_ns(self) -> list[tuple[int, int]]:
        """Log times [ns] between which nothing was recorded: a recorder was started again."""
        return [(last_ns, first_ns) for last_ns, first_ns, _ in holes(self.files)]


def blocks_of(file: FileScan, channels: Set[int]) -> Iterator[tuple[bytes, int, int]]:
    """Yield the blocks with messages of some channels: records, usable bytes, block.

    Checksums were compared when the bag was opened; they are again where the file is not the same
    any more by its size and time.
    """
    try:
        with file.path.open('rb') as stream:
            now = os.fstat(stream.fileno())
            same = (now.st_size, now.st_mtime_ns) == (file.size, file.modified_ns)
            wanted = [b for b in file.blocks if not channels.isdisjoint(b.channels)]
            file.announce(wanted)
            for block in wanted:
                yield file.load(block, stream, checked=not same), block.usable, block.offset
            file.check_read(channels)
    except (OSError, chunks.Damage) as error:
        raise BagError(f'{file.path} was changed while it was read: {error}') from error


def _file_records(file: FileScan, names: dict[int, str]) -> Iterator[BagMessage]:
    for content, usable, _ in blocks_of(file, names.keys()):
        for number, sequence, log_time, publish_time, data in chunks.messages(content, usable):
            name = names.get(number)
            if name is not None:
                yield BagMessage(name, log_time, publish_time, sequence, data)


def listed(names: Iterable[str]) -> str:
    """Text of names for a sentence, at most a dozen."""
    names = list(names)
    shown = ', '.join(names[:12]) if names else 'none'
    return shown if len(names) <= 12 else f'{shown} and {len(names) - 12} more'
