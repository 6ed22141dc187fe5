"""What sqlite3 and ROS 1 bags have in common: the library rosbags reads both."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ...bags.errors import BagError
from ...bags.reader import Topic
from ..definitions import Definitions
from .base import Rows, Timed, require


class RosbagsSource(ABC):
    """A bag that the library rosbags opens; its kinds differ in what is abstract here."""

    kind: str
    advice: str
    """What can be done about a damaged one."""

    run_info: Mapping[str, Any] = {}
    """No recorder of this project writes such bags."""

    def __init__(self, path: Path, definitions: Definitions | None = None) -> None:
        self.path = path
        self._definitions = definitions or Definitions()
        self.problems: list[str] = []
        self._stores: dict[str, Typestore] = {}
        with self._opened() as reader:
            self._all = list(reader.connections)
        self._topics = self._find_topics()

    @abstractmethod
    def reader(self) -> Ros1Reader | Ros2Reader:
        """Return the library's reader, not opened."""

    @abstractmethod
    def understood(self, types: Typesdict) -> Typesdict:
        """Return the types of a definition as those of ROS 2."""

    @abstractmethod
    def cdr(self, data: bytes | memoryview, kind: str, store: Typestore) -> bytes:
        """Return the bytes of a message as CDR."""

    @abstractmethod
    def front(self, data: bytes | memoryview) -> bytes:
        """Return the first bytes of a message with a header as CDR, its stamp included."""

    @contextmanager
    def _opened(self) -> Iterator[Ros1Reader | Ros2Reader]:
        try:
            reader = self.reader()
            reader.open()
        except Exception as error:  # a library on a file of any content
            raise BagError(
                f'{self.path}: this {self.kind} is damaged ({_why(error)}); {self.advice}'
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
                types = get_types_from_msg(
                    described.data if given else self._definitions.text_of(kind), kind
                )
                store = get_typestore(Stores.EMPTY)
                store.register(_with_times(self.understood(types)))
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
        store = self._store(topic)
        wanted = {c.id for c in self._connections(topic)}
        with self._opened() as reader:
            chosen = [c for c in reader.connections if c.id in wanted]
            messages = iter(reader.messages(chosen))
            while True:
                try:
                    _, log_ns, data = next(messages)
                    cdr = self.cdr(data, kind, store)
                except StopIteration:
                    return
                except Exception as error:  # bytes from a file can fail in any way
                    raise BagError(
                        f'{self.path}: a message on {topic} cannot be read as {kind} '
                        f'({_why(error)}); {self.advice}'
                    ) from error
                yield log_ns, cdr

    def headed(self, topic: str) -> bool:
        """Return whether messages of a topic begin with a header; False where nobody knows."""
        kind = self._topics[topic].type
        try:
            fields = self._store(topic).fielddefs[kind][1]
        except BagError:
            return False
        return bool(fields) and fields[0][1][1] == 'std_msgs/msg/Header'

    def fronts(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, log time [ns], CDR bytes up to the stamp at least) of all messages."""
        headed = {name: self.headed(name) for name, topic in self._topics.items() if topic.count}
        with self._opened() as reader:
            messages = iter(reader.messages())
            while True:
                try:
                    connection, log_ns, data = next(messages)
                except StopIteration:
                    return
                except Exception as error:  # a library on a file of any content
                    raise BagError(
                        f'{self.path}: this {self.kind} is damaged ({_why(error)}); {self.advice}'
                    ) from error
                name = connection.topic
                if connection.msgtype == self._topics[name].type:
                    yield name, log_ns, self.front(data) if headed.get(name) else bytes(data)

    def columns(self, topic: str, fields: Sequence[str], rows: Rows) -> Timed | None:
        """Return None: there is no quicker way than message by message."""
        del topic, fields, rows
        return None


def _with_times(types: Typesdict) -> Typesdict:
    """Add the two types that ROS 1 builds in, where they are used and not defined."""
    basic = get_typestore(Stores.ROS2_JAZZY).fielddefs
    for name in ('builtin_interfaces/msg/Time', 'builtin_interfaces/msg/Duration'):
        types.setdefault(name, basic[name])
    return types


def _why(error: Exception) -> str:
    said = str(error).splitlines()[0] if str(error) else ''
    return f'{type(error).__name__}: {said}' if said else type(error).__name__
