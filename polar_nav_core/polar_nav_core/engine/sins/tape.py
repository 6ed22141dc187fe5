"""Record of a filter's linear steps and updates, in the order in which they were made.

A smoother reads it backwards. Rings of the filter hold two minutes; `Tape.take` copies what is new
in them to a temporary file, so that a day needs no more memory than a minute.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, Self

import numpy as np

from ... import spilled
from ...kernels.sins import state as fs
from ...kernels.sins.consider import COLUMNS
from ..events import InitialState
from ..params import EngineParams
from .filter import NavigationFilter
from .recorded import FixLog, Plan, Recorded
from .stretch import Stretch, stretch_of

_COLUMNS = tuple(x.name for x in fields(Stretch))
_Form = tuple[tuple[np.dtype[Any], tuple[int, ...]], ...]


class Tape:
    """Tape of one run.

    Parameters
    ----------
    every : int
        Covariance steps from one stored state to the next.
    fixes : FixLog, optional
    plan : Plan, optional
        Both as of `Recorded`.

    Attributes
    ----------
    parts : list of int
        Stretches before each filter that was recorded: one, and one more for each that was lost.
    common : (COLUMNS,) array
        1-sigma of the common errors of the newest filter.
    hidden : bool
        Whether its last three states are not published: errors of a leader or of headings.
    enlarged : bool
        Whether a filter enlarged its covariance on the way, for a gate to open again.
    considers : bool
        Whether common errors were considered.
    """

    def __init__(self, every: int, fixes: FixLog | None = None, plan: Plan | None = None) -> None:
        self._every, self._fixes, self._plan = every, fixes, plan
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the tape
        self._offsets: list[int] = []
        # Lengths of the columns of each stretch, and what is the same in most: dtypes and shapes.
        self._lengths: list[tuple[int, ...]] = []
        self._forms: list[_Form] = []
        self._filter: NavigationFilter | None = None
        self._taken = 0
        self._states = 0
        self.parts: list[int] = []
        self.common = np.zeros(COLUMNS)
        self.hidden = False
        self.enlarged = self.considers = False
        self.dvl_stamps_ns = self.depth_stamps_ns = np.zeros(0, dtype=np.int64)

    def make(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> Recorded:
        """Fusion of an engine whose filter is recorded; the first, or after one that was lost."""
        self.take()
        fusion = Recorded(params, initial, stamp_ns, self._every, self._fixes, self._plan)
        self._filter = fusion.filter
        self._taken = 1  # the first entry is the start
        self._states = 0
        self.parts.append(len(self._offsets))
        settings = fusion.filter.settings
        self.common = np.asarray(settings.common, dtype=np.float64).copy()
        self.hidden = settings.shares_leader or settings.heading.on
        return fusion

    def take(self) -> None:
        """Copy what was logged since the last call.

        Raises
        ------
        PolarNavError
            When the rings went round in between.
        """
        f = self._filter
        if f is None or int(f.log.counts[0]) == self._taken:
            return
        openings = f.state.counters[[*range(fs.OPENINGS, fs.OPENINGS + 3), fs.HEADING_OPENINGS]]
        self.enlarged |= bool(openings.any())
        self.considers |= f.considers
        self.dvl_stamps_ns, self.depth_stamps_ns = f.streams.dvl_stamps, f.streams.depth_stamps
        stretch = stretch_of(f, self._taken, self._states)
        self._offsets.append(self._file.seek(0, 2))
        columns = [np.ascontiguousarray(getattr(stretch, name)) for name in _COLUMNS]
        self._lengths.append(tuple(map(len, columns)))
        form = tuple((column.dtype, column.shape[1:]) for column in columns)
        same = bool(self._forms) and self._forms[-1] == form
        self._forms.append(self._forms[-1] if same else form)
        for column in columns:
            self._file.write(column.reshape(-1).view(np.uint8).data)
        spilled.give_back()  # rows of a filter that is recorded come too seldom to see to that
        self._taken, self._states = int(f.log.counts[0]), int(f.log.counts[1])

    def backwards(self) -> Iterator[tuple[Stretch, bool]]:
        """The stretches from the last to the first, and whether another filter ended with it."""
        ends = {first - 1 for first in self.parts} | {len(self._offsets) - 1}
        for number in range(len(self._offsets) - 1, -1, -1):
            self._file.seek(self._offsets[number])
            arrays = {}
            described = zip(_COLUMNS, self._lengths[number], self._forms[number], strict=True)
            for name, length, (dtype, shape) in described:
                arrays[name] = np.empty((length, *shape), dtype)
                self._file.readinto(arrays[name].reshape(-1).view(np.uint8).data)
            if not len(arrays['sensitivity']):  # until then nothing was considered
                for name, like in (('sensitivity', 'P'), ('moved', 'H')):
                    arrays[name] = np.zeros((*arrays[like].shape[:2], COLUMNS))
            yield Stretch(**arrays), number in ends

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
