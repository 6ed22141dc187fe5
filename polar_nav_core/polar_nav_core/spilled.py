"""Large arrays in temporary files: a run of any length in bounded memory.

Rows of a long recording are written once and read a few times, in order. An array of `empty` is an
ordinary array; if it is large, it lies in a file of the temporary folder (`TMPDIR`) that goes with
it. The system keeps the pages that were touched in memory until `give_back`, which costs next to
nothing: whoever goes through many rows calls it every so many, as `by_rows` does.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from io import BufferedRandom
from typing import Any, Self
from weakref import WeakSet

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .errors import PolarNavError

LEAST_BYTES = 1 << 18
"""Size from which an array is spilled; smaller ones are together no load."""
ROWS = 1 << 13
"""Rows that are worked on at a time."""

_OWN_FILE = 1 << 21
"""Size from which an array has a file of its own."""
_SHARED_FILE = 1 << 24
ALIGNED = 64
"""Bytes at whose multiples arrays of one file begin."""

IN_MEMORY_BYTES = 1 << 26
"""Size up to which a `Spool` stays in memory."""

_files: WeakSet[mmap.mmap] = WeakSet()


class _Shared:
    """File of many arrays, one behind the other: a process may have few files open."""

    def __init__(self) -> None:
        self.begin_anew()

    def begin_anew(self) -> None:
        """Begin another file: a process that was forked has the pages of its parent."""
        self._lock = threading.Lock()
        self._pages: mmap.mmap | None = None
        self._used = 0

    def take(self, size: int) -> tuple[mmap.mmap, int]:
        """Return pages with room for so many bytes, and where it begins in them."""
        with self._lock:
            if self._pages is None or self._used + size > _SHARED_FILE:
                self._pages, self._used = _new_file(_SHARED_FILE), 0
            begin = self._used
            self._used += -(-size // ALIGNED) * ALIGNED
            return self._pages, begin


_shared = _Shared()
os.register_at_fork(after_in_child=_shared.begin_anew)


def empty(shape: int | Sequence[int], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return an array without values; a large one lies in a temporary file.

    Raises
    ------
    PolarNavError
        When the temporary folder has no room for it.
    """
    size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
    if size < LEAST_BYTES:
        return np.empty(shape, dtype)
    pages, begin = (_new_file(size), 0) if size >= _OWN_FILE else _shared.take(size)
    return np.ndarray(shape, dtype, buffer=pages, offset=begin)


def _new_file(size: int) -> mmap.mmap:
    """Return the pages of a new temporary file without a name."""
    file, pages = new_open_file(size)
    file.close()
    return pages


def new_open_file(size: int) -> tuple[BufferedRandom, mmap.mmap]:
    """Return a new temporary file without a name, and its pages."""
    try:
        with ExitStack() as undo:
            file = undo.enter_context(tempfile.TemporaryFile(prefix='polar-rows-'))
            # The room is taken now: a full disk later would end the process without a word.
            os.posix_fallocate(file.fileno(), 0, size)
            undo.pop_all()
    except OSError as error:
        raise no_room(size, error) from error
    pages = mmap.mmap(file.fileno(), size)
    _files.add(pages)
    return file, pages


def no_room(size: int, error: OSError) -> PolarNavError:
    """Error that says how many bytes the temporary folder has no room for."""
    return PolarNavError(
        f'{tempfile.gettempdir()}: no room for {size / 1e6:.0f} MB of a long recording '
        f'({error.strerror}); TMPDIR names another folder'
    )


def give_back() -> None:
    """Give the memory of all spilled arrays back to the system; their values stay."""
    for pages in tuple(_files):
        pages.madvise(mmap.MADV_DONTNEED)


def give_back_freed() -> None:
    """Give the memory of freed objects back to the system, too, of which the allocator keeps some.

    After a stage that made many; elsewhere than with glibc nothing happens.
    """
    give_back()
    trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)
    if trim is not None:
        trim(0)


def parts(count: int) -> Iterator[slice]:
    """Yield slices of so many rows, one after the other; gives back what each has touched."""
    for start in range(0, count, ROWS):
        yield slice(start, min(start + ROWS, count))
        give_back()


def by_rows(function: Callable[..., NDArray[Any]], *columns: NDArray[Any]) -> NDArray[Any]:
    """Return what a function of columns gives that works on each row by itself.

    Parameters
    ----------
    function : callable
        Gets some rows of each column, and returns as many.
    *columns : ndarray, shape (n, ...)
    """
    return several_by_rows(lambda *some: (function(*some),), *columns)[0]


def several_by_rows(
    function: Callable[..., tuple[NDArray[Any], ...]], *columns: NDArray[Any]
) -> tuple[NDArray[Any], ...]:
    """Return what a function gives that makes several columns; see `by_rows`."""
    count = len(columns[0])
    if count <= ROWS:
        found = function(*columns)
        give_back()
        return found
    out: tuple[NDArray[Any], ...] = ()
    for part in parts(count):
        found = function(*(column[part] for column in columns))
        out = out or tuple(empty((count, *x.shape[1:]), x.dtype) for x in found)
        for column, some in zip(out, found, strict=True):
            column[part] = some
    return out


def chosen(values: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Return copies of some rows of an array, by their numbers."""
    return by_rows(lambda some: values[some], rows)


def ascending(values: NDArray[np.int64]) -> bool:
    """Whether no value is smaller than the one before."""
    return all(
        bool((values[part][1:] >= values[part][:-1]).all())
        and (not part.start or bool(values[part.start] >= values[part.start - 1]))
        for part in parts(len(values))
    )


class Rows:
    """Rows of one type whose number is not known before.

    Parameters
    ----------
    dtype : data type
        Of a row; of a structured one, rows are tuples.
    shape : sequence of int
        Of a row.
    """

    def __init__(self, dtype: DTypeLike, shape: Sequence[int] = ()) -> None:
        self._shape = tuple(shape)
        self._array = empty((0, *self._shape), dtype)
        self._count = 0
        self._new: list[Any] = []

    def __len__(self) -> int:
        return self._count + len(self._new)

    def add(self, row: Any) -> None:  # noqa: ANN401 - of the type
        """Append one row."""
        self._new.append(row)
        if len(self._new) >= ROWS:
            self._settle()

    def extend(self, rows: NDArray[Any]) -> None:
        """Append copies of some rows."""
        self._settle()
        self._append(rows)

    def array(self) -> NDArray[Any]:
        """Return all rows so far; a view."""
        self._settle()
        return self._array[: self._count]

    def _settle(self) -> None:
        if self._new:
            self._append(self._new)
            self._new = []
            give_back()

    def _append(self, rows: Any) -> None:  # noqa: ANN401 - of the type
        stop = self._count + len(rows)
        if stop > len(self._array):
            wider = empty((stop + stop // 2, *self._shape), self._array.dtype)
            for part in parts(self._count):
                wider[part] = self._array[part]
            self._array = wider
        self._array[self._count : stop] = rows
        self._count = stop


class LastFirst:
    """Columns whose pieces come in the wrong order, the last one first.

    Parameters
    ----------
    most : mapping of str to int
        Most rows of a column, by its name.
    other : int
        Those of all other columns.
    """

    def __init__(self, most: Mapping[str, int], other: int = 0) -> None:
        self._most, self._other = most, other
        self._columns: dict[str, NDArray[Any]] = {}
        self._begin: dict[str, int] = {}

    def add(self, piece: Mapping[str, NDArray[Any]]) -> None:
        """Add copies of the columns of a piece; they may differ in length."""
        for name, rows in piece.items():
            column = self._columns.get(name)
            if column is None or not len(column):
                # Of a column that never has rows, none is made room for.
                most = self._most.get(name, self._other) if len(rows) else 0
                column = self._columns[name] = empty((most, *rows.shape[1:]), rows.dtype)
                self._begin[name] = most
            if len(rows):
                end = self._begin[name]
                self._begin[name] = end - len(rows)
                column[end - len(rows) : end] = rows

    def in_order(self) -> dict[str, NDArray[Any]]:
        """Return the columns, the first piece first; views."""
        give_back()
        return {name: column[self._begin[name] :] for name, column in self._columns.items()}


class Spool:
    """Numbers that are written piece by piece, and read again, perhaps changed on the way.

    What is short stays in memory, where nothing is copied. What is longer lies in a temporary file
    from then on, and takes memory for a piece only.

    Parameters
    ----------
    most_bytes : int
        Size up to which it stays in memory.
    """

    def __init__(self, most_bytes: int = IN_MEMORY_BYTES) -> None:
        self._memory = np.empty(most_bytes // 8)  # the system gives it as it is filled
        self._file: BufferedRandom | None = None
        self._piece = np.empty(0)
        self._end = 0

    @property
    def in_memory(self) -> bool:
        """Whether it is still short."""
        return self._file is None

    def begin_anew(self) -> None:
        """Write over what there is: that costs less than half as much as to write elsewhere."""
        self._end = 0

    def room(self, count: int) -> NDArray[np.float64]:
        """Return room for the next piece, which is to be filled and kept.

        What was read last may be gone.

        Raises
        ------
        PolarNavError
            When the temporary folder has no room for what there is.
        """
        if self._file is None and self._end + count > len(self._memory):
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the spool
            write(self._file, 0, self._memory[: self._end])
            self._memory = np.empty(0)
        return self._at(self._end, count)

    def keep(self, piece: NDArray[np.float64]) -> None:
        """Keep the piece that was filled.

        Raises
        ------
        PolarNavError
            When the temporary folder has no room for it.
        """
        if self._file is not None:
            write(self._file, self._end * piece.itemsize, piece)
        self._end += len(piece)

    def read(self, begin: int, count: int) -> NDArray[np.float64]:
        """Return some of the numbers; whoever changes them may have changed the record."""
        values = self._at(begin, count)
        if self._file is not None:
            self._file.seek(begin * values.itemsize)
            self._file.readinto(values.view(np.uint8).data)
        return values

    def _at(self, begin: int, count: int) -> NDArray[np.float64]:
        if self._file is None:
            return self._memory[begin : begin + count]
        if len(self._piece) < count:
            self._piece = np.empty(count + count // 4)
        return self._piece[:count]

    def close(self) -> None:
        """Let the file go."""
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def write(file: BufferedRandom, begin: int, values: NDArray[Any]) -> None:
    """Write values to a file, from a byte of it on."""
    try:
        file.seek(begin)
        file.write(values.view(np.uint8).data)
    except OSError as error:
        raise no_room(values.nbytes, error) from error
