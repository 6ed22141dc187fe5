"""Subscriptions of the sources of a mapping file, and the record of what was used of them.

A source asks for reliable messages and, when a publisher offers best effort only, for those. What
is used is published in blocks on `nav/inputs`, reliably, before what it leads to: with best effort
a recorder and this node lose different messages, and a replay uses what this node used.
"""

from __future__ import annotations

import hashlib
from array import array
from collections.abc import Callable
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.serialization import deserialize_message
from rclpy.validate_topic_name import validate_topic_name

from polar_nav_core.errors import ConfigError
from polar_nav_msgs.msg import Inputs

from .adapters.live import CONSTANTS, Source, Sources, Taken
from .adapters.mapping import Stream
from .adapters.start_topic import StartTopic
from .node import PolarNode
from .source_health import SourceHealth
from .stamps import to_msg
from .topics import HEADING, INPUTS

_BLOCK_NS = 1_000_000_000
_MOST = 2000


def digest_of(data: bytes) -> int:
    """Digest of a message's serialized bytes, as nav/inputs states it.

    Filled up with zeros to a multiple of four bytes, as they are on the way between processes: a
    node in the publisher's process gets them as they were, and a recorder in another does not.
    """
    digest = hashlib.blake2b(data, digest_size=8)
    digest.update(bytes(-len(data) % 4))
    return int.from_bytes(digest.digest(), 'little')


def bound(sources: Sources) -> dict[str, type[Any]]:
    """Message classes of sources, found by the names of their types, to which they are bound.

    Raises
    ------
    ConfigError
        For a type that the mapping does not state, or that is not installed, and for what is no
        name of a topic.
    """
    found: dict[str, type[Any]] = {}
    for source in sources:
        kind = class_of(source.stream, sources.place)
        constants = {n: getattr(kind, n) for n in CONSTANTS if hasattr(kind, n)}
        source.bind(kind(), constants, sources.place)
        found[source.topic] = kind
    return found


def class_of(stream: Stream, where: str) -> type[Any]:
    """Message class of a topic, by the name of its type.

    Raises
    ------
    ConfigError
        As `bound`, beginning with ``where``.
    """
    topic, name = stream.topic, stream.type
    if not name:
        raise ConfigError(
            f'{where}: {topic}: type is missing; a running vehicle needs it, as in '
            '`type: sensor_msgs/msg/Imu`'
        )
    try:
        validate_topic_name(topic)
    except InvalidTopicNameException as error:
        why = str(error).splitlines()[0].rstrip(':').removeprefix('Invalid topic name: ')
        raise ConfigError(f'{where}: {topic!r} is no name of a topic: {why}') from error
    package, _, short = name.split('/')
    try:
        return getattr(import_module(f'{package}.msg'), short)  # type: ignore[no-any-return]
    except ImportError as error:
        raise ConfigError(
            f'{where}: {topic}: {name} needs the package {package}, which is not installed here '
            f'({error})'
        ) from error
    except AttributeError as error:
        near = _spelled_alike(short, package)
        raise ConfigError(
            f'{where}: {topic}: package {package} has no message {short}'
            + (f'; did you mean {near}?' if near else '')
        ) from error


def _spelled_alike(short: str, package: str) -> str:
    """Name of the package's message that is nearest to a misspelt one; empty without any."""
    names = {n.lower(): n for n in dir(import_module(f'{package}.msg')) if n[:1].isupper()}
    return ''.join(names[n] for n in get_close_matches(short.lower(), names, n=1))


class SourcePorts:
    """Subscriptions of a node to the sources of a mapping file.

    Parameters
    ----------
    node : PolarNode
    sources : Sources
    start : StartTopic, optional
        Topic that the start is from.

    Attributes
    ----------
    health : SourceHealth
        What is wrong with them.
    """

    def __init__(
        self, node: PolarNode[Any], sources: Sources, start: StartTopic | None = None
    ) -> None:
        self._node = node
        self._sources = sources
        self._kinds = bound(sources)
        self._start_kind: type[Any] | None = None
        if start is not None:
            where = f'{sources.place}: initial'
            self._start_kind = class_of(start.stream, where)
            start.bind(self._start_kind(), {}, where)
        self._start = start
        self._require_one_type()
        self._names: dict[str, str] = {}
        self._inputs = node.advertise(Inputs, INPUTS)
        self._blocks = 0
        self._rows: list[tuple[int, int, int, int, int]] = []
        self.health = SourceHealth(node, sources, self._name)

    def _require_one_type(self) -> None:
        """Refuse a topic that stands in the file with two types: no publisher has both."""
        streams = [s.stream for s in self._sources]
        streams += [] if self._start is None else [self._start.stream]
        types: dict[str, str] = {}
        for stream in streams:
            name = self._node.resolve_topic_name(stream.topic)
            if types.setdefault(name, stream.type) != stream.type:
                raise ConfigError(
                    f'{self._sources.place}: {name} is stated as {types[name]} and as '
                    f'{stream.type}: a topic has one type'
                )

    @property
    def beside(self) -> tuple[str, ...]:
        """Topics of the session that only a mapping brings."""
        return self._sources.beside

    @property
    def fixes(self) -> bool:
        """Whether a source brings positions or packets."""
        return any(s.role in ('position', 'packet') for s in self._sources)

    @property
    def headings(self) -> bool:
        """Whether a source measures the heading."""
        return self._sources.of(HEADING) is not None

    @property
    def start(self) -> tuple[StartTopic, type[Any]] | None:
        """Topic that the start is from, and its message class."""
        if self._start is None or self._start_kind is None:
            return None
        return self._start, self._start_kind

    def has(self, topic: str) -> bool:
        """Whether a source stands for a topic of the session."""
        return self._sources.of(topic) is not None

    def subscribe(
        self,
        topic: str,
        take: Callable[[Any], None],
        *,
        after_others: bool = False,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Subscribe to the source that stands for a topic of the session.

        Parameters
        ----------
        topic : str
        take : callable
            Gets each message as `Taken`.
        after_others, then
            As of `PolarNode.subscribe`.
        """
        source = self._sources.of(topic)
        if source is None:
            raise ValueError(f'no source stands for {topic}')
        number = next(i for i, s in enumerate(self._sources) if s is source)
        kind = self._kinds[topic]

        def on_bytes(data: bytes) -> None:
            arrival_ns = self._node.get_clock().now().nanoseconds
            try:
                message = deserialize_message(data, kind)
                stamp_ns = source.own_stamp_ns(message, arrival_ns)
            except (RuntimeError, ValueError, MemoryError):  # bytes of anybody on the network
                source.unreadable += 1
                return
            mapped_ns = source.validity_ns(stamp_ns, arrival_ns)
            arrival_ns = source.received_ns(mapped_ns, arrival_ns)
            self._note((number, stamp_ns, arrival_ns, mapped_ns, digest_of(data)))
            take(Taken(message, arrival_ns, mapped_ns))

        subscription = self._node.subscribe(
            kind, source.stream.topic, on_bytes, raw=True, after_others=after_others, then=then
        )
        self._names[topic] = str(subscription.topic_name)

    def _note(self, row: tuple[int, int, int, int, int]) -> None:
        if (self._rows and row[2] - self._rows[0][2] >= _BLOCK_NS) or len(self._rows) >= _MOST:
            self.flush()
        self._rows.append(row)

    def flush(self) -> None:
        """Publish what was used since the last block."""
        if not self._rows:
            return
        source, stamp, arrival, mapped, digest = zip(*self._rows, strict=True)
        message = Inputs(
            sequence=self._blocks,
            topics=[self._name(s) for s in self._sources],
            source=array('H', source),
            stamp=array('q', stamp),
            arrival=array('q', arrival),
            mapped=array('q', mapped),
            digest=array('Q', digest),
        )
        message.header.stamp = to_msg(arrival[-1])
        self._inputs.publish(message)
        self._blocks += 1
        self._rows.clear()

    def _name(self, source: Source) -> str:
        """Full name of a source's topic, after remapping."""
        return self._names.get(source.topic, source.stream.topic)
