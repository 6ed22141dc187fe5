"""Opens any bag: MCAP through this project's reader, sqlite3 and ROS 1 through rosbags.

Out: topics with types and counts, and for a topic its columns with the log times. The bytes of
all three kinds end as CDR with a ros2msg definition, so one vectorised decoder reads them all.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..bags.columns import Columns, read_columns
from ..bags.decode import store_of
from ..bags.errors import BagError
from ..bags.layout import layout_of
from ..bags.opening import Progress, open_bag
from ..bags.reader import Bag, Topic
from .definitions import text_of
from .mcap_records import log_times, topic_columns, topic_records

Stamps = NDArray[np.int64]

_MAGIC_ROS1 = b'#ROSBAG V2.0'
_ADVICE_ROS1 = '`rosbag reindex` of ROS 1 makes a new index for what is whole'
_ADVICE_SQLITE = '`sqlite3 FILE.db3 .recover | sqlite3 NEW.db3` saves what SQLite still finds'
_HEADER = 'std_msgs/msg/Header'
_FREQUENT = 0.1
"""Share of a bag's messages from which two compiled passes over all cost less than one that makes
an object of each message of the topic."""


class Source(Protocol):
    """A bag of any kind."""

    path: Path
    kind: str
    problems: list[str]

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""
        ...

    def text(self, topic: str) -> str:
        """Return the ros2msg definition of a topic's type."""
        ...

    def records(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Yield (log time [ns], CDR bytes) in the order of the bag."""
        ...


@dataclass(frozen=True)
class Table:
    """Fields of all messages of a topic.

    Attributes
    ----------
    topic, type : str
        Where they come from.
    log_ns : (n,) array
        When each was recorded.
    columns : dict of str to array
        By field path.
    constants : dict of str to value
        Constants of the type's definition.
    """

    topic: str
    type: str
    log_ns: Stamps
    columns: Columns
    constants: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.log_ns)


def require(source: Source, topic: str) -> Topic:
    """Return a topic that has messages.

    Raises
    ------
    BagError
        Naming the topics that the bag has.
    """
    found = source.topics.get(topic)
    if found is None or not found.count:
        have = ', '.join(t.name for t in source.topics.values() if t.count) or 'none'
        raise BagError(f'{source.path} has no message on {topic}; it has {have}')
    return found


def field_paths(source: Source, topic: str) -> tuple[str, ...]:
    """Return every field of a topic's first message that can be a column."""
    found = require(source, topic)
    _, data = next(source.records(topic))
    store = store_of(source.text(topic), found.type)
    return tuple(layout_of(store, found.type, data).leaves)


def read_table(
    source: Source,
    topic: str,
    fields: Sequence[str],
    rows: Sequence[tuple[str, ...]] = (),
) -> Table:
    """Decode some fields of all messages of a topic.

    Parameters
    ----------
    source : Source
    topic : str
    fields : sequence of str
    rows : sequence of tuple of str
        Some of the fields that are wanted as one array: under the first of them there may stand
        all, shape (n, k). It saves the memory of a copy.

    Raises
    ------
    BagError
        When there is no message, or one cannot be decoded.
    """
    found = require(source, topic)
    if isinstance(source, McapSource) and found.count > _FREQUENT * source.bag.message_count:
        text = source.text(topic)
        quick = topic_columns(source.bag, topic, fields, rows)
        if quick is not None:
            return Table(
                topic,
                found.type,
                log_times(source.bag, topic),
                quick,
                _constants(text, found.type),
            )
    log_ns = array('q')

    def payloads() -> Iterator[bytes]:
        for stamp_ns, data in source.records(topic):
            log_ns.append(stamp_ns)
            yield data

    text = source.text(topic)
    try:
        columns = read_columns(payloads(), found.type, text, fields)
        constants = _constants(text, found.type)
    except BagError as error:
        if str(source.path) in str(error):
            raise
        raise BagError(f'{source.path}: {topic}: {error}') from error
    return Table(topic, found.type, np.array(log_ns, dtype=np.int64), columns, constants)


def _constants(text: str, kind: str) -> dict[str, Any]:
    return {name: value for name, _, value in store_of(text, kind).fielddefs[kind][0]}


def open_source(path: str | Path, progress: Progress | None = None) -> Source:
    """Open a bag: an MCAP file, a rosbag2 folder (MCAP or sqlite3), a .db3 file or a ROS 1 bag.

    Raises
    ------
    BagError
        When there is no bag, or it cannot be read.
    """
    path = Path(path)
    if path.suffix == '.bag':
        _check_ros1(path)
        return RosbagsSource(path, is_ros1=True)
    if path.suffix == '.db3':
        path = path.parent
    if path.is_dir() and any(path.glob('*.db3')):
        if not (path / 'metadata.yaml').is_file():
            raise BagError(
                f'{path}: a sqlite3 bag without metadata.yaml; `ros2 bag reindex` makes it anew'
            )
        return RosbagsSource(path, is_ros1=False)
    return McapSource(open_bag(path, progress))


def _check_ros1(path: Path) -> None:
    """Refuse what is no ROS 1 bag at all, which the library takes for one."""
    if not path.is_file():
        raise BagError(f'{path}: no such file')
    try:
        with path.open('rb') as file:
            front = file.read(len(_MAGIC_ROS1))
    except OSError as error:
        raise BagError(f'{path}: cannot be read ({error.strerror})') from error
    if not front:
        raise BagError(f'{path} is empty (0 bytes)')
    if front != _MAGIC_ROS1:
        raise BagError(
            f'{path} is not a ROS 1 bag (it begins with {front!r}, not {_MAGIC_ROS1!r})'
        )


def _why(error: Exception) -> str:
    said = str(error).splitlines()[0] if str(error) else ''
    return f'{type(error).__name__}: {said}' if said else type(error).__name__


class McapSource:
    """An MCAP bag, whole or damaged, through `polar_nav_tools.bags`."""

    kind = 'rosbag2, MCAP'

    def __init__(self, bag: Bag) -> None:
        self.path = bag.path
        self.bag = bag
        self.problems = bag.problems

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""
        return self.bag.topics

    def text(self, topic: str) -> str:
        """Return the ros2msg definition of a topic's type."""
        channel = self.bag.channel(topic)
        if channel.encoding != 'cdr':
            raise BagError(f'{self.path}: {topic} is encoded as {channel.encoding!r}, not as cdr')
        return channel.schema_text or text_of(channel.type)

    def records(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Yield (log time [ns], CDR bytes) in the order of the bag."""
        yield from topic_records(self.bag, topic)


class RosbagsSource:
    """A sqlite3 or ROS 1 bag through rosbags; messages of ROS 1 are turned into CDR."""

    def __init__(self, path: Path, *, is_ros1: bool) -> None:
        self.path = path
        self.kind = 'ROS 1 bag' if is_ros1 else 'rosbag2, sqlite3'
        self.problems: list[str] = []
        self._is_ros1 = is_ros1
        self._advice = _ADVICE_ROS1 if is_ros1 else _ADVICE_SQLITE
        self._stores: dict[str, Typestore] = {}
        with self._opened() as reader:
            self._all = list(reader.connections)
        self._topics = self._find_topics()

    @contextmanager
    def _opened(self) -> Iterator[Ros1Reader | Ros2Reader]:
        try:
            reader = Ros1Reader(self.path) if self._is_ros1 else Ros2Reader(self.path)
            reader.open()
        except Exception as error:  # a library on a file of any content
            raise BagError(
                f'{self.path}: this {self.kind} is damaged ({_why(error)}); {self._advice}'
            ) from error
        try:
            yield reader
        finally:
            reader.close()

    def _find_topics(self) -> dict[str, Topic]:
        counts: dict[str, int] = {}
        types: dict[str, str] = {}
        for connection in self._all:
            name = connection.topic
            first = types.setdefault(name, connection.msgtype)
            if connection.msgtype != first:
                self.problems.append(
                    f'{name} is a {first} and a {connection.msgtype}; the latter is ignored'
                )
                continue
            counts[name] = counts.get(name, 0) + connection.msgcount
        return {n: Topic(n, types[n], counts[n]) for n in sorted(types)}

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""
        return self._topics

    def _connections(self, topic: str) -> list[Connection]:
        kind = self._topics[topic].type
        return [c for c in self._all if c.topic == topic and c.msgtype == kind]

    def text(self, topic: str) -> str:
        """Return the ros2msg definition of a topic's type."""
        kind = require(self, topic).type
        return str(self._store(topic).generate_msgdef(kind, ros_version=2)[0])

    def _store(self, topic: str) -> Typestore:
        kind = self._topics[topic].type
        if kind not in self._stores:
            described = self._connections(topic)[0].msgdef
            given = described.format == MessageDefinitionFormat.MSG and described.data.strip()
            try:
                types = get_types_from_msg(described.data if given else text_of(kind), kind)
                if self._is_ros1 and _HEADER in types:
                    # ROS 2 has no `seq`; rosbags leaves it out when it turns the bytes into CDR.
                    constants, fields = types[_HEADER]
                    types[_HEADER] = (constants, [f for f in fields if f[0] != 'seq'])
                store = get_typestore(Stores.EMPTY)
                store.register(_with_times(types))
            except BagError:
                raise
            except Exception as error:  # a parser on text from a file
                raise BagError(
                    f'{self.path}: {topic}: the definition of {kind} is not understood ({error})'
                ) from error
            self._stores[kind] = store
        return self._stores[kind]

    def records(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Yield (log time [ns], CDR bytes) in the order of the bag."""
        kind = require(self, topic).type
        store = self._store(topic) if self._is_ros1 else None
        wanted = {c.id for c in self._connections(topic)}
        with self._opened() as reader:
            chosen = [c for c in reader.connections if c.id in wanted]
            messages = iter(reader.messages(chosen))
            while True:
                try:
                    _, log_ns, data = next(messages)
                    cdr = bytes(data if store is None else store.ros1_to_cdr(data, kind))
                except StopIteration:
                    return
                except Exception as error:  # bytes from a file can fail in any way
                    raise BagError(
                        f'{self.path}: a message on {topic} cannot be read as {kind} '
                        f'({_why(error)}); {self._advice}'
                    ) from error
                yield log_ns, cdr


def _with_times(types: Any) -> Any:  # noqa: ANN401 - type definitions as rosbags has them
    """Add the two types that ROS 1 builds in, where they are used and not defined."""
    basic = get_typestore(Stores.ROS2_JAZZY).fielddefs
    for name in ('builtin_interfaces/msg/Time', 'builtin_interfaces/msg/Duration'):
        types.setdefault(name, basic[name])
    return types
