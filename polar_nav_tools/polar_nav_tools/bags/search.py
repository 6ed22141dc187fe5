"""Search for the next intact chunk behind a damaged stretch of an MCAP file."""

from __future__ import annotations

import re

from . import chunks
from .chunks import HEADER, Damage
from .window import Window

_PIECE = 1 << 20
_MOST = 1000
# Pattern of a chunk: opcode, length, two times, size, checksum, the compression's name.
_CHUNK_LIKE = re.compile(rb'\x06.{36}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4)', re.DOTALL)
_CHUNK_LIKE_BYTES = 45


class Search:
    """Search for chunks in one file; ends after a thousand false matches of the pattern."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._tried = 0

    def next_chunk(self, start: int) -> int | None:
        """Return the offset of the next intact chunk, None if there is none."""
        at = start
        while at < self._window.size and self._tried < _MOST:
            match = _CHUNK_LIKE.search(self._window.get(at, _PIECE + _CHUNK_LIKE_BYTES))
            if match is None:
                at += _PIECE
                continue
            at += match.start()
            self._tried += 1
            if self._is_intact(at):
                return at
            at += 1
        return None

    def _is_intact(self, at: int) -> bool:
        _, length = HEADER.unpack(self._window.get(at, HEADER.size))
        if length > self._window.size - at - HEADER.size:
            return False
        body_at = at + HEADER.size
        try:
            front = self._window.get(body_at, min(length, chunks.CHUNK_FRONT))
            head = chunks.read_chunk_head(bytes(front), length)
            data = self._window.get(body_at + head.data_at, head.data_size)
            chunks.inflate(head.compression, data, head.size, head.crc)
        except Damage:
            return False
        return True
