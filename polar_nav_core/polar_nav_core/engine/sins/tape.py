"""Record of a filter's linear steps and updates, in the order in which they were made.

A smoother reads it backwards. Rings of the filter hold two minutes; `Tape.take` copies what is new
in them to a spool, so that a day needs hardly more memory than a minute.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Self

import numpy as np

from ... import spilled
from ...kernels.sins import state as fs
from ...kernels.sins.consider import COLUMNS
from ..events import InitialState
from ..params import EngineParams
from .filter import NavigationFilter
from .recorded import FixLog, Plan, Recorded
from .stretch import Form, Stretch, position_variance, stretch_in, write_stretch


class Tape:
    """Tape of one run.

    Parameters
    ----------
    every : int
        Covariance steps from one stored state to the next.
    fixes : FixLog, optional
    plan : Plan, optional
        Both as of `Recorded`.
    spool : Spool, optional
        Where the record is to lie: that of a tape which nobody reads any more.

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
    fixes : int
        Number of fixes that were fused or, where refused ones are logged, refused.
    """

    def __init__(
        self,
        every: int,
        fixes: FixLog | None = None,
        plan: Plan | None = None,
        spool: spilled.Spool | None = None,
    ) -> None:
        self._every, self._fixes, self._plan = every, fixes, plan
        self._is_own = spool is None
        self._spool = spilled.Spool() if spool is None else spool
        self._spool.begin_anew()
        self._forms: list[Form] = []
        self._variances: list[float] = []
        self._filter: NavigationFilter | None = None
        self._taken = 0
        self._states = 0
        self.parts: list[int] = []
        self.common = np.zeros(COLUMNS)
        self.hidden = False
        self.enlarged = self.considers = False
        self.fixes = 0
        self.dvl_stamps_ns = self.depth_stamps_ns = np.zeros(0, dtype=np.int64)

    def make(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> Recorded:
        """Fusion of an engine whose filter is recorded; the first, or after one that was lost."""
        self.take()
        fusion = Recorded(params, initial, stamp_ns, self._every, self._fixes, self._plan)
        self._filter = fusion.filter
        self._taken = 1  # the first entry is the start
        self._states = 0
        self.parts.append(len(self._forms))
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
        form, values, stretch = write_stretch(f, self._taken, self._states, self._spool)
        self._forms.append(form)
        last = self._variances[-1:] or [0.0]
        self._variances.append(position_variance(stretch.P) if len(stretch.P) else last[0])
        self.fixes += int((stretch.ranks == fs.FIX_RANK).sum())
        self._spool.keep(values)
        self.give_back()  # rows of a filter that is recorded come too seldom to see to that
        self._taken, self._states = int(f.log.counts[0]), int(f.log.counts[1])

    def give_back(self, *, freed: bool = False) -> None:
        """Give memory back to the system while the record is long; ``freed``: of objects, too.

        Of a short one it is little, and taken again page by page: 3 of the 90 ms of a pass over
        600 s.
        """
        if not self._spool.in_memory:
            spilled.give_back_freed() if freed else spilled.give_back()

    @property
    def total(self) -> Form:
        """Form of all stretches together."""
        steps, updates, rows, states = (sum(f[k] for f in self._forms) for k in range(4))
        model = any(form.model for form in self._forms)
        return Form(steps, updates, rows, states, self.considers, model)

    def backwards(self) -> Iterator[tuple[Stretch, bool, float]]:
        """The stretches from the last to the first, and whether another filter ended with it.

        And the trace of the position's covariance in the last state before it [m^2].

        Once: a stretch stands in the record, or where the one before it stood. What is to stay as
        it is has to be copied.
        """
        ends = {first - 1 for first in self.parts} | {len(self._forms) - 1}
        offset = sum(form.size for form in self._forms)
        nothing = np.zeros((0, COLUMNS))
        for number in range(len(self._forms) - 1, -1, -1):
            form = self._forms[number]
            offset -= form.size
            stretch = stretch_in(self._spool.read(offset, form.size), form)
            if not form.considers:  # until then nothing was considered
                of_state, of_update = form.states * stretch.P.shape[1], form.updates * 3
                if self.considers or len(nothing) < max(of_state, of_update):
                    nothing = np.zeros((max(of_state, of_update), COLUMNS))
                stretch = replace(
                    stretch,
                    sensitivity=nothing[:of_state].reshape(
                        form.states, stretch.P.shape[1], COLUMNS
                    ),
                    moved=nothing[:of_update].reshape(form.updates, 3, COLUMNS),
                )
            before = self._variances[number - 1] if number and number - 1 not in ends else 0.0
            yield stretch, number in ends, before

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_own:
            self._spool.close()
