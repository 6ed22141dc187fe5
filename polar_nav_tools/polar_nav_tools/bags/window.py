"""A file by place: small pieces next to each other cost no calls to the system."""

from __future__ import annotations

from typing import BinaryIO

PIECE = 1 << 19
"""Bytes that are read at once, at least."""


class Window:
    """Bytes of a file that were read last.

    Not a memory map: a file that somebody cuts off meanwhile gives less bytes, and no signal.

    Parameters
    ----------
    file : binary file
    size : int
        Bytes it has.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.size = size
        self._file = file
        self._at = 0
        self._held = memoryview(b'')

    def get(self, at: int, size: int) -> memoryview:
        """Return bytes from a place on; less than asked for only at the end of the file."""
        start = at - self._at
        if start < 0 or start + size > len(self._held):
            self._file.seek(at)
            self._held = memoryview(self._file.read(max(size, PIECE)))
            self._at, start = at, 0
        return self._held[start : start + size]

    def held(self, at: int) -> memoryview:
        """Return what is at hand from a place on that `get` was asked for just now."""
        return self._held[at - self._at :]
