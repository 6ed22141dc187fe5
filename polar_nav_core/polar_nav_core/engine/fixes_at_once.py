"""Fixes of a whole run, many in one call of the compiled loop, with the receipts of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import FilterDivergence
from ..link.fields import TICK_NS, WRAP
from ..order import FIX_RANK, FUSED
from .collector import Collector
from .driver import WholeArrays
from .engine import Engine
from .events import Event, Fix
from .looks import Look
from .plausibility import believed
from .results import FixResult
from .sins.whole import SinsArrays
from .verdicts import Verdict

_STRETCH = 1024
"""Most fixes that go to the compiled loop at a time."""


def diverge(engine: Engine, arrays: WholeArrays, why: FilterDivergence, stamp_ns: int) -> None:
    """Restore a filter that was lost in the compiled loop, and continue with the new one."""
    engine.last_imu_ns, cursors = arrays.stamp_ns, arrays.cursors()
    engine.diverge(str(why), stamp_ns)
    arrays.hand_over(engine.fusion, cursors)


class FixesAtOnce:
    """Fixes that only gate or history can refuse, many at a time in the compiled loop.

    It counts, admits and writes receipts as `Engine.process` does for single events.

    Parameters
    ----------
    engine : Engine
    arrays : SinsArrays
        Inputs of the run, in the streams of the engine's filter.
    collector : Collector
        Rows and receipts of the run.
    """

    def __init__(self, engine: Engine, arrays: SinsArrays, collector: Collector[Any]) -> None:
        self._engine = engine
        self._arrays = arrays
        self._collector = collector

    def fuse(self, events: Sequence[Event | Look], start: int) -> int:
        """Fuse fixes from a place among events on, with all data before them.

        Returns
        -------
        int
            Number of fixes up to the first that is refused or has to be judged in Python.
        """
        engine, arrays = self._engine, self._arrays
        fixes = self._plain(events, start)
        if not fixes:
            return 0
        first, settled = arrays.fixes, 0
        arrays.put_fixes(fixes)
        try:
            full = True
            while full:
                full = arrays.advance(fixes[-1].receive_ns, FIX_RANK + 1)
                settled = self._settle(fixes, first, settled)
                self._collector.note(engine)
                if full:
                    self._collector.drain()
        except FilterDivergence as error:
            settled = self._settle(fixes, first, settled)
            self._collector.note(engine)
            on_fix = first + settled < arrays.fixes
            at_ns = fixes[settled].receive_ns if on_fix else arrays.stamp_ns
            diverge(engine, arrays, error, at_ns)
            if on_fix:
                self._lost(fixes[settled])
                settled += 1
        else:
            arrays.drop_fixes()
            engine.last_imu_ns = arrays.stamp_ns
        return settled

    def _plain(self, events: Sequence[Event | Look], start: int) -> list[Fix]:
        """Fixes from a place on that only the filter's history or gate can refuse."""
        found: list[Fix] = []
        ticks: set[int] = set()
        ledger = self._engine.ledger
        # One by one: to slice a list is to touch every event of it.
        for number in range(start, min(start + _STRETCH, len(events))):
            event = events[number]
            if not isinstance(event, Fix) or not ledger.integrity.quiet:
                break
            if event.delay_sigma > 0.0:  # widened by the velocity of then
                break
            if math.isfinite(event.surface_depth):  # the depth of then decides
                break
            tick = event.validity_ns // TICK_NS % WRAP  # another of it may be a copy
            if tick in ticks:
                break
            if ledger.refusal(event, event.validity_ns):
                break
            if believed(event, self._engine.params.min_fix_sigma) is not event:
                break
            ticks.add(tick)
            found.append(event)
        return found

    def _settle(self, fixes: list[Fix], first: int, settled: int) -> int:
        """Write receipts of the filter's decisions; returns the number of fixes with a receipt.

        ``first`` is the number of the first fix in the streams.
        """
        engine, collector, arrays = self._engine, self._collector, self._arrays
        outcomes, notes = arrays.decisions(first + settled)
        # All were fused, but for the last one perhaps: the compiled loop stops there.
        others = np.flatnonzero(outcomes[:, 0] != FUSED)
        fused = int(others[0]) if len(others) else len(outcomes)
        if fused:
            done = fixes[settled : settled + fused]
            collector.note_fused(engine, [fix.validity_ns for fix in done], notes[:fused, 2])
            engine.admit(done[0])
            if fused > 1:  # those between are in order
                engine.admit(done[-1])
            collector.receipts.extend_fused(
                engine.ledger.fused(done, outcomes[:fused], notes[:fused])
            )
            arrays.settled(done, outcomes[:fused])
            settled += fused
        if fused < len(outcomes) and outcomes[fused, 0] >= 0.0:  # else the filter was lost here
            steps, stamp_ns, rows = notes[fused].tolist()
            collector.note(engine, rows)
            result = FixResult(arrays.outcome_of(outcomes[fused]), steps)
            arrays.settled([fixes[settled]], outcomes[fused : fused + 1])
            self._decided(fixes[settled], result, stamp_ns)
            settled += 1
        return settled

    def _decided(self, fix: Fix, result: FixResult, stamp_ns: int) -> None:
        """Write the receipt of a fix that the gate refused."""
        engine = self._engine
        engine.admit(fix)
        engine.ledger.came(fix)
        engine.ledger.remember(fix, fix.validity_ns, fused=False)
        receipt = engine.ledger.decided(fix, fix, result, stamp_ns)
        engine.verdicts[receipt.verdict] += 1
        self._collector.receipts.append(receipt)
        engine.reconsider(result.outcome)

    def _lost(self, fix: Fix) -> None:
        """Write the receipt of a fix at which the filter diverged."""
        engine = self._engine
        engine.admit(fix)
        engine.ledger.came(fix)
        self._collector.receipts.append(
            engine.refuse(fix, Verdict.NOT_READY, engine.why_lost, fix.receive_ns)
        )
