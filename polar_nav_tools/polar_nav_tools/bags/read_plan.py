"""Plan of one pass over a bag: topics, offsets of their fields, the scanner's tables.

Messages with the layout of the first one of their topic (`layout.py`: the same size, the same
lengths, the same texts) are read by a compiled scanner of records; the bytes that it compares and
copies are listed here.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_tools.bags.kernels import records

from .decode import store_of
from .errors import BagError
from .layout import ENCAPSULATION, Layout, layout_of
from .reader import Bag
from .request import Fields, Request

_WORD = 8
_STAGE_BYTES = 1 << 20
"""Of the buffer: so little that what is written stays in the processor's cache."""
_LEAST_ROOM = 64


@dataclass(frozen=True)
class Part:
    """One column: its fields, and kind of number."""

    names: tuple[str, ...]
    dtype: np.dtype[Any]
    count: int  # numbers per message
    is_row: bool

    @property
    def is_time(self) -> bool:
        """Whether it is seconds (low) and nanoseconds (high) of a time."""
        return len(self.names) > 1 and not self.is_row

    @property
    def width(self) -> int:
        """Number of bytes per message."""
        return self.dtype.itemsize * self.count

    def of(self, raw: NDArray[np.uint8]) -> NDArray[Any]:
        """View of the bytes of so many rows as a column."""
        rows = len(raw) // self.width
        return raw.view(self.dtype).reshape((rows, self.count) if self.is_row else rows)


@dataclass
class Wanted:
    """One topic read into columns, of which the buffer has room for some rows at a time."""

    topic: str
    type_name: str
    text: str
    rows: int
    parts: list[Part]
    texts: tuple[str, ...]
    example: bytes
    layout: Layout
    odd: int = 0
    room: int = 0
    written: int = 0
    """Rows that have left the buffer."""
    places: tuple[int, ...] = ()
    """Where the rows of each part begin in the buffer."""


class ReadPlan:
    """Columns of the topics of a bag, and the layouts by which the scanner recognizes messages.

    Parameters
    ----------
    bag : Bag
    request : Request

    Attributes
    ----------
    wanted : list of Wanted
        Topics read into columns; their indices in the list are their slots.
    raw : list of str
        Topics read as serialized messages; their slots follow.
    slots : dict of str to int
        Slot of each topic.
    size : int
        Bytes of the buffer.
    tables, checks, parts, template : arrays
        For the scanner; see `kernels.records`.

    Raises
    ------
    BagError
        When a topic is not CDR, or a field does not exist.
    """

    def __init__(self, bag: Bag, request: Request) -> None:
        wanted, raw = request
        self._bag = bag
        present = [t for t in wanted if t in bag.topics and bag.topics[t].count]
        self.wanted = [self._first_look(topic, wanted[topic]) for topic in present]
        self.size = self._divide()
        self.raw = [t for t in raw if t in bag.topics and bag.topics[t].count]
        self.slots = {t: i for i, t in enumerate([*present, *self.raw])}
        self.tables = np.zeros((max(len(self.slots), 1), records.PART_END + 1), dtype=np.int64)
        for topic, slot in self.slots.items():
            self.tables[slot, [records.CAPACITY, records.ROOM]] = bag.topics[topic].count
        self.set_layouts()

    def _divide(self) -> int:
        """Give each topic its share of the buffer; returns the bytes of the buffer."""
        every = sum(p.width * one.rows for one in self.wanted for p in one.parts)
        share, end = min(1.0, _STAGE_BYTES / max(every, 1)), 0
        for one in self.wanted:
            one.room = min(one.rows, max(_LEAST_ROOM, int(share * one.rows)))
            sizes = [-(-p.width * one.room // _WORD) * _WORD for p in one.parts]
            ends = list(accumulate(sizes, initial=end))
            one.places, end = tuple(ends[:-1]), ends[-1]
        return max(end, _WORD)

    def set_layouts(self) -> None:
        """Fill the tables of the scanner with the layout of each topic."""
        checks: list[tuple[int, int, int]] = []
        parts: list[tuple[int, int, int]] = []
        template = bytearray()
        for slot, one in enumerate(self.wanted):
            row = self.tables[slot]
            row[records.CHECK], row[records.PART] = len(checks), len(parts)
            for offset, length in _constant(one.layout):
                checks.append((offset, length, len(template)))
                template += one.example[offset : offset + length]
            for p in one.parts:
                parts.append((one.layout.leaves[p.names[0]].offset, p.width, 0))
            row[records.CHECK_END], row[records.PART_END] = len(checks), len(parts)
            plain = one.layout.order == '<' and sys.byteorder == 'little'
            row[records.SIZE] = len(one.example) if plain else -1
        self.tables[len(self.wanted) :, records.SIZE] = -1
        self.checks = np.array(checks, dtype=np.int64).reshape(-1, 3)
        self.parts = np.array(parts, dtype=np.int64).reshape(-1, 3)
        self.template = np.frombuffer(bytes(template) or b'\0', dtype=np.uint8)
        for slot in range(len(self.wanted)):
            self.aim(slot)

    def aim(self, slot: int) -> None:
        """Have the next row of a topic, and all as there is room for, at the topic's places."""
        one, row = self.wanted[slot], self.tables[slot]
        done = one.written
        row[records.ROOM] = done + one.room
        mine = self.parts[row[records.PART] : row[records.PART_END]]
        mine[:, records.PLACE] = one.places - done * mine[:, records.LENGTH]

    def learn(self, one: Wanted, example: bytes) -> bool:
        """Replace the layout of a topic by that of a message, if the columns stay the same."""
        layout = layout_of(store_of(one.text, one.type_name), one.type_name, example)
        for p in one.parts:
            first, leaf = one.layout.leaves[p.names[0]], layout.leaves.get(p.names[0])
            if leaf is None or (leaf.format, leaf.count) != (first.format, first.count):
                return False
        one.layout, one.example = layout, example
        return True

    def explained(self, topic: str, error: BagError) -> BagError:
        """Return an error that names bag and topic."""
        if str(self._bag.path) in str(error):
            return error
        return BagError(f'{self._bag.path}: {topic}: {error}')

    def _first_look(self, topic: str, fields: Fields) -> Wanted:
        channel = self._bag.channel(topic)
        example = next(iter(self._bag.payloads(topic)))
        rows = self._bag.topics[topic].count
        try:
            layout = layout_of(store_of(channel.schema_text, channel.type), channel.type, example)
            parts = [_part(layout, names) for names in fields]
        except BagError as error:
            raise self.explained(topic, error) from error
        texts = tuple(name for name, leaf in layout.leaves.items() if leaf.is_text)
        return Wanted(
            topic, channel.type, channel.schema_text, rows, parts, texts, example, layout
        )


def _part(layout: Layout, names: str | tuple[str, ...]) -> Part:
    fields = (names,) if isinstance(names, str) else names
    missing = [n for n in fields if n not in layout.leaves or layout.leaves[n].is_text]
    if missing:
        raise BagError(f'there is no field {missing[0]} that could be a column')
    leaves = [layout.leaves[n] for n in fields]
    is_time = [leaf.format for leaf in leaves] == ['i4', 'u4']
    dtype = np.dtype(leaves[0].format)
    for number, leaf in enumerate(leaves):
        same = is_time or leaf.format == leaves[0].format
        if not same or leaf.offset - leaves[0].offset != number * dtype.itemsize:
            raise BagError(f'fields {", ".join(fields)} do not stand side by side')
    if leaves[0].count == 0:
        raise BagError(f'field {fields[0]} is empty')
    if is_time:
        return Part(fields, np.dtype(np.int64), 1, False)
    is_row = len(fields) > 1 or leaves[0].count is not None
    count = len(fields) if len(fields) > 1 else (leaves[0].count or 1)
    return Part(fields, dtype, count, is_row)


def _constant(layout: Layout) -> list[tuple[int, int]]:
    """Offsets and sizes of the bytes that define a layout: encapsulation, lengths and texts."""
    found = [(0, 2), *((at, 4) for at in layout.lengths)]
    for leaf in layout.leaves.values():
        size = int(leaf.format[1:]) if leaf.is_text else 0
        if size:
            found.append((leaf.offset, size))
    joined: list[tuple[int, int]] = []
    for at, size in sorted(found):
        if joined and sum(joined[-1]) == at and at > ENCAPSULATION:
            joined[-1] = (joined[-1][0], joined[-1][1] + size)
        else:
            joined.append((at, size))
    return joined
