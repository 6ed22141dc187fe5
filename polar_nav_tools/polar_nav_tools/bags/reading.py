"""Fields of many messages as arrays, read from the blocks of a bag by compiled code.

Messages of the layouts of a `read_plan.ReadPlan` are read by a compiled scanner of records. Every
other message goes through `columns.read_columns`, with the same numbers; if a layout stays, the
scanner learns it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.spilled_table import Table
from polar_nav_tools.bags.kernels import records

from .columns import read_columns
from .contents import FileScan
from .errors import BagError
from .read_plan import ReadPlan, Wanted
from .reader import Bag
from .request import Request, Tables

_ODD = 4096
_CHANNELS = 1 << 16
_LOW = 0xFFFF_FFFF


class Reading:
    """One pass over a bag: the scanner's tables, and the arrays so far.

    Parameters
    ----------
    bag : Bag
        The bag with its topics and counts; its blocks are passed to `take`.
    request : Request
    """

    def __init__(self, bag: Bag, request: Request) -> None:
        self._bag = bag
        self._plan = ReadPlan(bag, request)
        self._out = Tables()
        self._out.payloads = {t: [] for t in request.raw}
        self._slots = np.full(_CHANNELS, -1, dtype=np.int16)
        self._buffer = np.empty(self._plan.size, np.uint8)
        self._tables = [
            Table({p.names[0]: p.of(np.empty(0, np.uint8)) for p in one.parts}, one.rows)
            for one in self._plan.wanted
        ]
        self._words = self._buffer.view(np.int64)
        self._odd = np.zeros((_ODD, 4), dtype=np.int64)
        self._io = np.zeros(1, dtype=np.int64)

    def begin(self, file: FileScan) -> frozenset[int]:
        """Channel numbers to read of the next file."""
        numbers = self._bag.channels_of(file, self._plan.slots)
        self._slots[:] = -1
        for number, topic in numbers.items():
            self._slots[number] = self._plan.slots[topic]
        return frozenset(numbers)

    def take(self, content: bytes, usable: int) -> None:
        """Read the next block of the file.

        Raises
        ------
        BagError
            If it differs from the scan of the bag, or a message is not of its type.
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
                    self._plan.tables,
                    self._plan.checks,
                    self._plan.template,
                    self._plan.parts,
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
            if at < usable:  # there was no room
                self._write()

    def _write(self) -> None:
        """Write the rows in the buffer to the tables of their topics."""
        for slot, (one, table) in enumerate(zip(self._plan.wanted, self._tables, strict=True)):
            rows = int(self._plan.tables[slot, records.ROWS]) - one.written
            if rows:
                columns = self._held(one, rows)
                table.append(
                    {
                        p.names[0]: _nanoseconds(column) if p.is_time else column
                        for p, column in zip(one.parts, columns, strict=True)
                    }
                )
                one.written += rows
                self._plan.aim(slot)

    def _held(self, one: Wanted, rows: int) -> list[NDArray[Any]]:
        """So many rows of a topic that are in the buffer, column by column; views."""
        return [
            p.of(self._buffer[place : place + p.width * rows])
            for p, place in zip(one.parts, one.places, strict=True)
        ]

    def tables(self) -> Tables:
        """Return all arrays, after the last block.

        Raises
        ------
        BagError
            If messages are missing.
        """
        self._write()
        for one, table in zip(self._plan.wanted, self._tables, strict=True):
            rows = int(self._plan.tables[self._plan.slots[one.topic], records.ROWS])
            if rows != one.rows:
                raise self._changed(f'{one.topic} has {rows} messages instead of {one.rows}')
            self._out.odd[one.topic] = one.odd
            self._out.columns[one.topic] = table.columns()
        return self._out

    def _odd_ones(self, content: bytes) -> None:
        """Read the messages that the scanner left: raw topics, and those of another layout."""
        found: dict[int, list[tuple[int, bytes]]] = {}
        known = len(self._plan.wanted)
        for slot, row, start, length in self._odd[: self._io[0]].tolist():
            data = content[start : start + length]
            if slot >= known:
                self._out.payloads[self._plan.raw[slot - known]].append(data)
            else:
                found.setdefault(slot, []).append((row, data))
        self._io[0] = 0
        learned = False
        for slot, rows in found.items():
            one = self._plan.wanted[slot]
            one.odd += len(rows)
            try:
                self._place_odd(one, rows)
                learned |= self._plan.learn(one, rows[-1][1])
            except BagError as error:
                raise self._plan.explained(one.topic, error) from error
        if learned:
            self._plan.set_layouts()

    def _place_odd(self, one: Wanted, rows: list[tuple[int, bytes]]) -> None:
        names = [n for p in one.parts for n in p.names]
        # Texts only to see that they are texts: so would decoding the message.
        got = read_columns(
            (data for _, data in rows), one.type_name, one.text, [*names, *one.texts]
        )
        at = np.array([row for row, _ in rows]) - one.written
        for p, column in zip(one.parts, self._held(one, one.room), strict=True):
            values = got[p.names[0]]
            if p.is_time:
                high = got[p.names[1]].astype(np.int64) << 32
                values = high | (values.astype(np.int64) & _LOW)
            elif len(p.names) > 1:
                values = np.stack([got[n] for n in p.names], axis=1)
            if values.shape[1:] != column.shape[1:]:
                raise BagError(f'field {p.names[0]} has rows of different length')
            column[at] = values

    def _changed(self, what: str) -> BagError:
        return BagError(f'{self._bag.path} was changed while it was read: {what}')


def _nanoseconds(raw: NDArray[np.int64]) -> NDArray[np.int64]:
    """Nanoseconds of seconds and nanoseconds of times, the low and the high half of numbers."""
    seconds = (raw << 32) >> 32  # signed
    return np.asarray(seconds * 1_000_000_000 + (raw >> 32 & _LOW))
