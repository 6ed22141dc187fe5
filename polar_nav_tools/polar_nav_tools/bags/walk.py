"""The records of a block, counted by compiled code: what `chunks.walk` does, for large bags."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polar_nav_core.kernels import records

from . import chunks
from .contents import Tally

_CHANNELS = 1 << 16


class CompiledWalk:
    """Goes through blocks of one file.

    Parameters
    ----------
    tallies : dict of int to Tally
        Of the file, by channel; brought up to date after each block.
    """

    def __init__(self, tallies: dict[int, Tally]) -> None:
        self._tallies = tallies
        self._table = np.zeros((_CHANNELS, 5), dtype=np.uint64)
        self._seen = np.zeros(_CHANNELS, dtype=np.bool_)

    def walk(
        self, block: bytes, on_other: Callable[[int, bytes], None]
    ) -> tuple[int, frozenset[int]]:
        """Count the messages of a block; up to where its records are whole, and its channels."""
        content = np.frombuffer(block, dtype=np.uint8)
        size, at = len(block), 0
        self._known()
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
        channels = np.flatnonzero(self._seen).tolist()
        self._seen[channels] = False
        for channel in channels:
            count, first, last, first_sequence, last_sequence = self._table[channel].tolist()
            self._tallies[channel] = Tally(count, first, last, first_sequence, last_sequence)
        return at, frozenset(channels)

    def _known(self) -> None:
        """Start from what was counted elsewhere: small blocks are walked without this."""
        for channel, t in self._tallies.items():
            self._table[channel] = (
                t.count,
                t.first_ns,
                t.last_ns,
                t.first_sequence,
                t.last_sequence,
            )
