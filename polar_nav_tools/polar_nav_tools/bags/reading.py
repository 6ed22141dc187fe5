"""Fields of many messages: compiled, straight from the blocks of a bag to arrays.

Messages with the layout of the first one of their topic (`layout.py`: the same size, the same
lengths, the same texts) are taken by a compiled scanner of records. Every other message goes
through `columns.read_columns`, with the same numbers; if a layout stays, the scanner learns it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_tools.bags.kernels import records

from .columns import read_columns
from .contents import FileScan
from .decode import store_of
from .errors import BagError
from .layout import ENCAPSULATION, Layout, layout_of
from .reader import Bag
from .request import Fields, Request, Tables

_ODD = 4096
_SLICE = 1 << 18
_CHANNELS = 1 << 16
_WORD = 8
_LOW = 0xFFFF_FFFF


@dataclass(frozen=True)
class _Part:
    """One column: its fields, kind of number, and where it starts in the buffer."""

    names: tuple[str, ...]
    dtype: np.dtype[Any]
    count: int  # numbers per message
    is_row: bool
    place: int

    @property
    def is_time(self) -> bool:
        """Whether it is seconds (low) and nanoseconds (high) of a time."""
        return len(self.names) > 1 and not self.is_row

    @property
    def width(self) -> int:
        """Bytes per message."""
        return self.dtype.itemsize * self.count


@dataclass
class _Wanted:
    """One topic that becomes columns."""

    topic: str
    type_name: str
    text: str
    rows: int
    parts: list[_Part]
    texts: tuple[str, ...]
    example: bytes
    layout: Layout
    odd: int = 0


class Reading:
    """One pass over a bag: the kernel's tables, and what came out so far.

    Parameters
    ----------
    bag : Bag
        Tells what there is; its blocks are given to `take`.
    request : Request
    """

    def __init__(self, bag: Bag, request: Request) -> None:
        wanted, raw = request
        self._bag = bag
        self._out = Tables()
        present = [t for t in wanted if t in bag.topics and bag.topics[t].count]
        self._place = 0
        self._wanted = [self._first_look(topic, wanted[topic]) for topic in present]
        self._raw = [t for t in raw if t in bag.topics and bag.topics[t].count]
        self._topics = {t: i for i, t in enumerate([*present, *self._raw])}
        self._slots = np.full(_CHANNELS, -1, dtype=np.int16)
        self._buffer = np.empty(max(self._place, _WORD), dtype=np.uint8)
        self._words = self._buffer.view(np.int64)
        self._odd = np.zeros((_ODD, 4), dtype=np.int64)
        self._io = np.zeros(1, dtype=np.int64)
        self._tables = np.zeros((max(len(self._topics), 1), 7), dtype=np.int64)
        for topic, slot in self._topics.items():
            self._tables[slot, records.CAPACITY] = bag.topics[topic].count
        self._out.payloads = {t: [] for t in raw}
        self._set_layouts()

    def begin(self, file: FileScan) -> frozenset[int]:
        """Begin with a file; returns the channels that are wanted of it."""
        numbers = self._bag.channels_of(file, self._topics)
        self._slots[:] = -1
        for number, topic in numbers.items():
            self._slots[number] = self._topics[topic]
        return frozenset(numbers)

    def take(self, content: bytes, usable: int) -> None:
        """Take the next block of the file.

        Raises
        ------
        BagError
            When it does not have what the bag tells of, or a message is none of its type.
        """
        block = np.frombuffer(content, dtype=np.uint8)
        at = 0
        while at < usable:
            at = int(
                records.take(
                    block,
                    at,
                    usable,
                    self._slots,
                    self._tables,
                    self._checks,
                    self._template,
                    self._parts,
                    self._buffer,
                    self._words,
                    self._odd,
                    self._io,
                )
            )
            if at == records.BROKEN:
                raise self._changed('a block has other records than before')
            if self._io[0]:
                self._odd_ones(content)

    def tables(self) -> Tables:
        """Return what came out, after the last block.

        Raises
        ------
        BagError
            When messages are missing.
        """
        for one in self._wanted:
            rows = int(self._tables[self._topics[one.topic], records.ROWS])
            if rows != one.rows:
                raise self._changed(f'{one.topic} has {rows} messages instead of {one.rows}')
            self._out.odd[one.topic] = one.odd
            self._out.columns[one.topic] = {
                p.names[0]: _nanoseconds(column) if p.is_time else column
                for p, column in ((p, self._column(p, one.rows)) for p in one.parts)
            }
        return self._out

    # -- what is looked for

    def _first_look(self, topic: str, fields: Fields) -> _Wanted:
        channel = self._bag.channel(topic)
        example = next(iter(self._bag.payloads(topic)))
        rows = self._bag.topics[topic].count
        try:
            layout = layout_of(store_of(channel.schema_text, channel.type), channel.type, example)
            parts = [self._part(layout, names, rows) for names in fields]
        except BagError as error:
            raise self._explained(topic, error) from error
        texts = tuple(name for name, leaf in layout.leaves.items() if leaf.is_text)
        return _Wanted(
            topic, channel.type, channel.schema_text, rows, parts, texts, example, layout
        )

    def _part(self, layout: Layout, names: str | tuple[str, ...], rows: int) -> _Part:
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
            part = _Part(fields, np.dtype(np.int64), 1, False, self._place)
        else:
            is_row = len(fields) > 1 or leaves[0].count is not None
            count = len(fields) if len(fields) > 1 else (leaves[0].count or 1)
            part = _Part(fields, dtype, count, is_row, self._place)
        self._place += -(-part.width * rows // _WORD) * _WORD
        return part

    def _set_layouts(self) -> None:
        """Tell the kernel the layout of each topic."""
        checks: list[tuple[int, int, int]] = []
        parts: list[tuple[int, int, int]] = []
        template = bytearray()
        for slot, one in enumerate(self._wanted):
            row = self._tables[slot]
            row[records.CHECK], row[records.PART] = len(checks), len(parts)
            for offset, length in _constant(one.layout):
                checks.append((offset, length, len(template)))
                template += one.example[offset : offset + length]
            for p in one.parts:
                parts.append((one.layout.leaves[p.names[0]].offset, p.width, p.place))
            row[records.CHECK_END], row[records.PART_END] = len(checks), len(parts)
            plain = one.layout.order == '<' and sys.byteorder == 'little'
            row[records.SIZE] = len(one.example) if plain else -1
        self._tables[len(self._wanted) :, records.SIZE] = -1
        self._checks = np.array(checks, dtype=np.int64).reshape(-1, 3)
        self._parts = np.array(parts, dtype=np.int64).reshape(-1, 3)
        self._template = np.frombuffer(bytes(template) or b'\0', dtype=np.uint8)

    # -- what the kernel left

    def _odd_ones(self, content: bytes) -> None:
        """Take what the kernel left: raw topics, and messages of another layout."""
        found: dict[int, list[tuple[int, bytes]]] = {}
        known = len(self._wanted)
        for slot, row, start, length in self._odd[: self._io[0]].tolist():
            data = content[start : start + length]
            if slot >= known:
                self._out.payloads[self._raw[slot - known]].append(data)
            else:
                found.setdefault(slot, []).append((row, data))
        self._io[0] = 0
        learned = False
        for slot, rows in found.items():
            one = self._wanted[slot]
            one.odd += len(rows)
            try:
                self._place_odd(one, rows)
                learned |= self._learn(one, rows[-1][1])
            except BagError as error:
                raise self._explained(one.topic, error) from error
        if learned:
            self._set_layouts()

    def _place_odd(self, one: _Wanted, rows: list[tuple[int, bytes]]) -> None:
        names = [n for p in one.parts for n in p.names]
        # Texts only to see that they are texts: so would decoding the message.
        got = read_columns(
            (data for _, data in rows), one.type_name, one.text, [*names, *one.texts]
        )
        at = np.array([row for row, _ in rows])
        for p in one.parts:
            column = self._column(p, one.rows)
            values = got[p.names[0]]
            if p.is_time:
                high = got[p.names[1]].astype(np.int64) << 32
                values = high | (values.astype(np.int64) & _LOW)
            elif len(p.names) > 1:
                values = np.stack([got[n] for n in p.names], axis=1)
            if values.shape[1:] != column.shape[1:]:
                raise BagError(f'field {p.names[0]} has rows of different length')
            column[at] = values

    def _learn(self, one: _Wanted, example: bytes) -> bool:
        """Make the layout of a message that of its topic, if the columns stay what they are."""
        layout = layout_of(store_of(one.text, one.type_name), one.type_name, example)
        for p in one.parts:
            first, leaf = one.layout.leaves[p.names[0]], layout.leaves.get(p.names[0])
            if leaf is None or (leaf.format, leaf.count) != (first.format, first.count):
                return False
        one.layout, one.example = layout, example
        return True

    def _column(self, part: _Part, rows: int) -> NDArray[Any]:
        raw = self._buffer[part.place : part.place + part.width * rows]
        return raw.view(part.dtype).reshape((rows, part.count) if part.is_row else rows)

    def _changed(self, what: str) -> BagError:
        return BagError(f'{self._bag.path} was changed while it was read: {what}')

    def _explained(self, topic: str, error: BagError) -> BagError:
        if str(self._bag.path) in str(error):
            return error
        return BagError(f'{self._bag.path}: {topic}: {error}')


def _nanoseconds(raw: NDArray[Any]) -> NDArray[np.int64]:
    """Turn seconds and nanoseconds to nanoseconds, in place."""
    for i in range(0, len(raw), _SLICE):
        part = raw[i : i + _SLICE]
        seconds = (part << 32) >> 32  # signed
        part[...] = seconds * 1_000_000_000 + (part >> 32 & _LOW)
    return raw


def _constant(layout: Layout) -> list[tuple[int, int]]:
    """Places and sizes of what makes a layout: encapsulation, lengths and texts."""
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
