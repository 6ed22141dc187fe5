"""Bytes of a file by offset, buffered: small adjacent reads cost no system calls."""

from __future__ import annotations

from typing import BinaryIO

PIECE = 1 << 19
"""Least number of bytes read at once."""


class Window:
    """Buffer with the last bytes read from a file.

    Not a memory map: a file truncated meanwhile returns fewer bytes, and raises no signal.

    Parameters
    ----------
    file : binary file
    size : int
        Number of bytes of the file.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.size = size
        self._file = file
        self._at = 0
        self._held = memoryview(b'')

    def get(self, at: int, size: int) -> memoryview:
        """Return bytes from an offset on; fewer than requested only at the end of the file."""
        start = at - self._at
        if start < 0 or start + size > len(self._held):
            self._file.seek(at)
            self._held = memoryview(self._file.read(max(size, PIECE)))
            self._at, start = at, 0
        return self._held[start : start + size]

    def held(self, at: int) -> memoryview:
        """Return the buffered bytes from an offset that the last `get` read."""
        return self._held[at - self._at :]
