"""Counts of the records of a block by compiled code: `chunks.walk` for large bags."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polar_nav_tools.bags.kernels import records

from . import chunks
from .contents import Tally

_CHANNELS = 1 << 16


class CompiledWalk:
    """Counter of the messages in the blocks of one file."""

    def __init__(self) -> None:
        self._table = np.zeros((_CHANNELS, 5), dtype=np.uint64)
        self._marks = bytearray(_CHANNELS)
        self._seen = np.frombuffer(self._marks, dtype=np.bool_)
        self._sets: dict[tuple[int, ...], frozenset[int]] = {}  # the same few again and again
        self._order: dict[int, None] = {}  # channels in order of occurrence

    def walk(
        self, block: bytes, on_other: Callable[[int, bytes], None]
    ) -> tuple[int, frozenset[int]]:
        """Number of bytes of whole records in a block, and its channels; counts its messages."""
        content = np.frombuffer(block, dtype=np.uint8)
        size, at = len(block), 0
        while at < size:
            at = int(records.tally(content, at, size, self._table, self._seen))
            if at == size:
                break
            if block[at] == chunks.OP_MESSAGE:  # one that is not whole
                break
            end = chunks.other(block, at, on_other)
            if end is None:
                break
            at = end
        return at, self._channels()

    def tallies(self) -> dict[int, Tally]:
        """Return the counts so far, by channel."""
        return {channel: Tally(*self._table[channel].tolist()) for channel in self._order}

    def _channels(self) -> frozenset[int]:
        """Channels marked by the kernel; a search for bytes is quicker than one of NumPy."""
        marks, found = self._marks, []
        channel = marks.find(1)
        while channel >= 0:
            found.append(channel)
            marks[channel] = 0
            channel = marks.find(1, channel + 1)
        key = tuple(found)
        channels = self._sets.get(key)
        if channels is None:
            channels = self._sets[key] = frozenset(key)
            self._order.update(dict.fromkeys(key))
        return channels
