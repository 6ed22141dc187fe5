"""Local copy of an object with holes: what was asked for, fetched once, a piece ahead.

A piece is what one visit to the storage brings: up to `PIECE_BYTES`, in ranges with no more than
`GAP_BYTES` between the parts that are wanted. While one piece is read, a thread fetches the next
one. The copy is a file without a name in the temporary folder; it is gone with the last reader.
"""

from __future__ import annotations

import io
import os
import tempfile
import threading
import weakref
from bisect import bisect_right
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from ..errors import BagError
from . import storage
from .storage import Found

PIECE_BYTES = 16 << 20
"""Most bytes fetched at once, but for a chunk that is larger."""
GAP_BYTES = 512 << 10
"""Unwanted bytes that cost less than another request for what follows them."""
_RANGES = 64
"""Most requests for one piece."""
TAIL_BYTES = 128 << 10
"""Bytes read first, at the end: a bag's index, or the place of a longer one."""
_BLOCK = 1 << 12

Range = tuple[int, int]


class Piece:
    """Ranges fetched at once."""

    def __init__(self, ranges: list[Range]) -> None:
        self.ranges = ranges
        self.coming: Future[None] | None = None


class SparseCopy:
    """What was fetched of one object.

    Parameters
    ----------
    found : Found
        The object.
    """

    def __init__(self, found: Found) -> None:
        self.found = found
        self.requests = 0
        """Requests for bytes so far."""
        self.bytes = 0
        """Bytes fetched so far."""
        file = tempfile.TemporaryFile(prefix='polar-bag-')  # noqa: SIM115 - lives as long as this
        self._fd = file.fileno()
        weakref.finalize(self, file.close)
        os.ftruncate(self._fd, found.size)
        self._here = bytearray(-(-found.size // _BLOCK))  # 1 for each block that is in the file
        self._planned = bytearray(len(self._here))  # 1 for each that is there or in a piece
        self._lock = threading.Lock()
        self._pieces: list[Piece] = []
        self._starts: list[int] = []
        self._fetch = ThreadPoolExecutor(1, 'polar-bag-ahead')
        tail = storage.last_bytes(found, TAIL_BYTES)
        self._keep(found.size - len(tail), tail)

    def plan(self, ranges: Iterable[Range]) -> None:
        """Tell what is going to be read, in any order: it is then fetched in few requests."""
        wanted = [r for r in ranges if not self._all(self._here, *r)]
        if all(self._all(self._planned, *r) for r in wanted):
            return
        self._pieces = _pieces(joined(wanted, self.found.size))
        self._starts = [piece.ranges[0][0] for piece in self._pieces]
        self._planned = bytearray(self._here)
        for piece in self._pieces:
            for start, end in piece.ranges:
                _mark(self._planned, start, end, self.found.size)

    def plan_all(self) -> None:
        """Tell that everything is going to be read."""
        size = self.found.size
        self.plan((at, min(at + PIECE_BYTES, size)) for at in range(0, size, PIECE_BYTES))

    def read(self, start: int, size: int) -> bytes:
        """Bytes from an offset on; fewer than asked for only at the end.

        Raises
        ------
        BagError
            If they cannot be fetched.
        """
        end = min(start + size, self.found.size)
        if start >= end:
            return b''
        if not self._all(self._here, start, end):
            self._bring(start, end)
        return os.pread(self._fd, end - start, start)

    def fileno(self) -> int:
        """Return the descriptor of the copy."""
        return self._fd

    def _bring(self, start: int, end: int) -> None:
        number = max(bisect_right(self._starts, start) - 1, 0)
        while number < len(self._pieces) and self._starts[number] < end:
            if any(a < end and start < b for a, b in self._pieces[number].ranges):
                self._wait(number)
            number += 1
        self._ordered(number)
        if not self._all(self._here, start, end):  # nobody has announced it
            self._get([_whole_blocks(start, end, self.found.size)])

    def _wait(self, number: int) -> None:
        """Wait for a piece; one that did not come is ordered again the next time."""
        try:
            self._ordered(number).result()
        except BagError:
            self._pieces[number].coming = None
            raise

    def _ordered(self, number: int) -> Future[None]:
        """Return the fetching of a piece, which is ordered if it was not."""
        if number >= len(self._pieces):
            done: Future[None] = Future()
            done.set_result(None)
            return done
        piece = self._pieces[number]
        if piece.coming is None:
            piece.coming = self._fetch.submit(self._get, piece.ranges)
        return piece.coming

    def _get(self, ranges: list[Range]) -> None:
        missing = [r for r in ranges if not self._all(self._here, *r)]
        if missing:
            for (start, _), data in zip(
                missing, storage.fetched(self.found.url, missing), strict=True
            ):
                self._keep(start, data)

    def _keep(self, start: int, data: bytes) -> None:
        """Write bytes to the copy; only then are they there."""
        os.pwrite(self._fd, data, start)
        with self._lock:
            self.requests += 1
            self.bytes += len(data)
            _mark(self._here, start, start + len(data), self.found.size)

    @staticmethod
    def _all(marks: bytearray, start: int, end: int) -> bool:
        """Whether all blocks with some bytes are marked."""
        return marks.find(0, start // _BLOCK, -(-end // _BLOCK)) < 0


def _mark(marks: bytearray, start: int, end: int, size: int) -> None:
    """Mark the blocks that lie wholly between two offsets; the last one of a file may be short."""
    first, last = -(-start // _BLOCK), len(marks) if end == size else end // _BLOCK
    if last > first:
        marks[first:last] = b'\1' * (last - first)


def _whole_blocks(start: int, end: int, size: int) -> Range:
    return start // _BLOCK * _BLOCK, min(-(-end // _BLOCK) * _BLOCK, size)


def joined(ranges: Iterable[Range], size: int) -> list[Range]:
    """Ranges of whole blocks, those near one another joined; none longer than a piece."""
    from fsspec.utils import merge_offset_ranges

    blocks = [_whole_blocks(a, b, size) for a, b in ranges]
    if not blocks:
        return []
    _, starts, ends = merge_offset_ranges(
        [''] * len(blocks),
        [a for a, _ in blocks],
        [b for _, b in blocks],
        max_gap=GAP_BYTES,
        max_block=PIECE_BYTES,
    )
    out: list[Range] = []
    for start, end in zip(starts, ends, strict=True):
        # Chunks that end and begin in one block overlap there.
        begin = max(start, out[-1][1]) if out else start
        if end is not None and end > begin:
            out.append((begin, end))
    return out


def _pieces(ranges: list[Range]) -> list[Piece]:
    out: list[Piece] = []
    size = 0
    for one in ranges:
        length = one[1] - one[0]
        if out and size + length <= PIECE_BYTES and len(out[-1].ranges) < _RANGES:
            out[-1].ranges.append(one)
            size += length
        else:
            out.append(Piece([one]))
            size = length
    return out


class Stream(io.RawIOBase):
    """Reader of a copy, as of any file."""

    def __init__(self, copy: SparseCopy) -> None:
        super().__init__()
        self._copy = copy
        self._at = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the descriptor of the copy."""
        return self._copy.fileno()

    def tell(self) -> int:
        """Return the offset."""
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """Go to an offset."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._copy.found.size}
        self._at = max(0, base[whence] + offset)
        return self._at

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next bytes."""
        left = max(0, self._copy.found.size - self._at)
        data = self._copy.read(self._at, left if size is None or size < 0 else min(size, left))
        self._at += len(data)
        return data

    def readinto(self, buffer: Any, /) -> int:  # noqa: ANN401 - a writable buffer
        """Fill a buffer."""
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)
