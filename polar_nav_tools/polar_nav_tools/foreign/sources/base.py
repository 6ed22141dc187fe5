"""What a bag of any kind is to its readers: topics, definitions, messages, tables of numbers."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...bags.columns import Columns, read_columns
from ...bags.decode import store_of
from ...bags.errors import BagError, WrongRequestError
from ...bags.layout import layout_of
from ...bags.reader import Topic

Stamps = NDArray[np.int64]
Rows = Sequence[tuple[str, ...]]
"""Fields that are wanted as one array."""
Timed = tuple[Stamps, Columns]
"""Log times [ns] and columns of the messages of a topic."""


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

    def columns(self, topic: str, fields: Sequence[str], rows: Rows) -> Timed | None:
        """Return log times and columns if there is a quicker way than `records`."""
        ...

    @property
    def run_info(self) -> Mapping[str, Any]:
        """What a recorder of this project wrote about the run; empty for others."""
        ...

    def headed(self, topic: str) -> bool:
        """Return whether messages of a topic begin with a header; False where nobody knows."""
        ...

    def fronts(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, log time [ns], CDR bytes up to the stamp at least) of all messages."""
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


def not_described(source: Source) -> tuple[str, ...]:
    """Return the types of messages that cannot be decoded: nobody has their definition."""
    found = set()
    for topic in source.topics.values():
        if topic.count and topic.type not in found:
            try:
                source.text(topic.name)
            except BagError:
                found.add(topic.type)
    return tuple(sorted(found))


def require(source: Source, topic: str, *, named: bool = False) -> Topic:
    """Return a topic that has messages.

    Raises
    ------
    BagError
        Naming the topics that the bag has; WrongRequestError where ``named`` says that the user
        did.
    """
    found = source.topics.get(topic)
    if found is None or not found.count:
        have = ', '.join(t.name for t in source.topics.values() if t.count) or 'none'
        kind = WrongRequestError if named else BagError
        raise kind(f'{source.path} has no message on {topic}; it has {have}')
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
    rows: Rows = (),
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
    quick = source.columns(topic, fields, rows)
    if quick is not None:
        return Table(topic, found.type, *quick, _constants(source.text(topic), found.type))
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
