"""What a run leaves: its track piece by piece, receipts and identifications."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Generic

import numpy as np

from ..identification.result import Identification
from .engine import Engine
from .inputs import Stamps
from .outputs import Output, Receipt
from .pieces import Pieces
from .receipt_rows import Receipts
from .track import T, copied, in_one_piece, joined

_SINGLES = 256
"""Estimates given one by one that are joined at a time."""


class Collector(Generic[T]):
    """Collects the pieces of a track, receipts and identifications of a run.

    Parameters
    ----------
    pieces : Pieces
        Of the mode.
    sink : callable, optional
        Gets the pieces, which are overwritten after the call; by default they are kept.
    """

    def __init__(self, pieces: Pieces[T], sink: Callable[[T], None] | None = None) -> None:
        self._pieces = pieces
        self._kept: list[T | slice] = []
        """Pieces, and rows that still stand where they were written."""
        self._sink = sink
        self._single: list[T] = []
        self.rows = pieces.rows
        self._fixes = np.zeros((len(self.rows.stamps), 3), dtype=np.int64)
        self._noted = self._drained = self._copied = 0
        self.receipts = Receipts()
        self.identifications: list[Identification] = []

    def collect(self, outputs: Iterator[Output]) -> None:
        """Store outputs of the engine: receipts, identifications, single estimates."""
        for output in outputs:
            if isinstance(output, Receipt):
                self.receipts.append(output)
            elif isinstance(output, Identification):
                self.identifications.append(output)
            else:
                self._drain_rows()
                self._single.append(self._pieces.of_estimate(output))
                if len(self._single) >= _SINGLES:
                    self._drain_single()

    def note(self, engine: Engine, until: int | None = None) -> None:
        """Write the engine's counts of fixes into the rows added since the last call.

        Up to row ``until``, where that is given.
        """
        n = int(self.rows.io[1]) if until is None else until
        if n > self._noted:
            self._fixes[self._noted : n] = engine.fix_counts()
            self._noted = n

    def note_fused(self, engine: Engine, validities_ns: Sequence[int], until: Stamps) -> None:
        """Write counts of fixes into rows between fixes that were fused but are not yet counted.

        Up to row ``until[k]`` it is fix k that is still to come.
        """
        received, fused, newest_ns = engine.fix_counts()
        begin, end = self._noted, max(self._noted, int(until[-1]))
        before = np.searchsorted(until, np.arange(begin, end), side='right')  # fixes, by row
        rows = self._fixes[begin:end]
        rows[:, 0], rows[:, 1] = received + before, fused + before
        rows[:, 2] = np.maximum.accumulate([newest_ns, *validities_ns])[before]
        self._noted = end

    def drain(self) -> None:
        """Pass all waiting rows to the sink."""
        self._drain_single()
        self._drain_rows()

    def _drain_single(self) -> None:
        if self._single:
            piece, self._single = joined(self._single), []
            if self._sink is None:
                self._kept.append(piece)
            else:
                self._sink(piece)

    def _drain_rows(self) -> None:
        part = slice(self._drained, self._noted)
        if part.start == part.stop:
            return
        self._drain_single()
        if self._sink is not None:
            self._sink(self._of_rows(part))
        else:
            before = self._kept[-1] if self._kept else None
            if isinstance(before, slice) and before.stop == part.start:
                self._kept[-1] = slice(before.start, part.stop)
            else:
                self._kept.append(part)
            if part.stop < len(self.rows.stamps):
                self._drained = part.stop
                return
            waiting = self._kept[self._copied :]
            self._kept[self._copied :] = [
                copied(self._of_rows(k)) if isinstance(k, slice) else k for k in waiting
            ]
            self._copied = len(self._kept)
        self.rows.io[1] = self._noted = self._drained = 0

    def _of_rows(self, part: slice) -> T:
        return self._pieces.of_rows(part, self._fixes[part])

    def _piece(self, kept: T | slice) -> T:
        return self._of_rows(kept) if isinstance(kept, slice) else kept

    def track(self) -> T:
        """Track of all rows that were kept; what is not whole in memory is copied."""
        pieces = [self._piece(kept) for kept in self._kept or [slice(0)]]
        return joined(pieces) if len(pieces) > 1 else in_one_piece(pieces[0])
