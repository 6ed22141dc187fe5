"""Columns of a long run that are written once, in one temporary file (`spilled`)."""

from __future__ import annotations

from collections.abc import Mapping
from io import BufferedRandom
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from . import spilled

_BLOCK_ROWS = 1 << 10
"""Rows of a table that go to its file at a time."""


class Table:
    """Columns that are written from the first row to the last, once, and read then.

    Large ones lie in one temporary file. Rows go there by the block: to write them through memory
    costs a fault for each page, and several times as much.

    Parameters
    ----------
    like : mapping of str to ndarray, shape (n, ...)
        Arrays of the type and the shape of a row of each column.
    rows : int
        Rows to make room for at once.
    """

    def __init__(self, like: Mapping[str, NDArray[Any]], rows: int) -> None:
        self._blocks = {
            name: np.empty((_BLOCK_ROWS, *column.shape[1:]), column.dtype)
            for name, column in like.items()
        }
        self._waiting = self._written = 0
        self._columns: dict[str, NDArray[Any]] = {}
        self._file: BufferedRandom | None = None
        self._make_room(max(rows, 1))

    def __len__(self) -> int:
        return self._written + self._waiting

    def append(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append copies of some rows of each column."""
        count, at = len(next(iter(columns.values()))), 0
        while at < count:
            some = min(count - at, _BLOCK_ROWS - self._waiting)
            for name, block in self._blocks.items():
                block[self._waiting : self._waiting + some] = columns[name][at : at + some]
            self._waiting += some
            at += some
            if self._waiting == _BLOCK_ROWS:
                self._write()

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all rows of each column; views. No rows can be appended then."""
        self._write()
        if self._file is not None:
            self._file.close()
        return {name: column[: self._written] for name, column in self._columns.items()}

    def _write(self) -> None:
        """Write the rows that wait."""
        if not self._waiting:
            return
        stop = self._written + self._waiting
        if stop > self._room:
            self._make_room(stop + stop // 2)
        for name, block in self._blocks.items():
            self._put(name, self._written, block[: self._waiting])
        if self._file is not None:
            self._file.flush()
        self._written, self._waiting = stop, 0

    def _put(self, name: str, row: int, values: NDArray[Any]) -> None:
        if self._file is None:
            self._columns[name][row : row + len(values)] = values
        else:
            begin = self._begin[name] + row * (values.nbytes // len(values))
            spilled.write(self._file, begin, values)

    def _make_room(self, rows: int) -> None:
        """Make room for so many rows, and write those there that were written before."""
        before, self._room = self._columns, rows
        sizes = {n: b[:1].nbytes * rows for n, b in self._blocks.items()}
        unit = spilled.ALIGNED
        ends = np.cumsum([-(-size // unit) * unit for size in sizes.values()]).tolist()
        self._begin = dict(zip(sizes, [0, *ends[:-1]], strict=True))
        if self._file is not None:
            self._file.close()
        self._file, pages = (
            spilled.new_open_file(ends[-1])
            if ends[-1] >= spilled.LEAST_BYTES
            else (None, bytearray(ends[-1]))
        )
        if self._file is not None:
            finalize(self, self._file.close)
        self._columns = {
            n: np.ndarray((rows, *b.shape[1:]), b.dtype, buffer=pages, offset=self._begin[n])
            for n, b in self._blocks.items()
        }
        if before:
            for part in spilled.parts(self._written):
                for name, column in before.items():
                    self._put(name, part.start, column[part])
