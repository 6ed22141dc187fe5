"""A whole run at once: sensor data as arrays in, the track and the receipts out.

The engine is the same as in the node, down to the last bit; only the driver differs: whatever
stands between two position fixes goes through one compiled loop, with `back_propagate` the fixes
too, up to one that is refused. Experiments, Monte Carlo runs and
fast replays use this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FilterDivergence
from ..kernels.sins import events as fe
from ..kernels.sins import run as filter_run
from ..kernels.sins import state as fs
from ..order import NEVER_NS
from .engine import Engine
from .events import Array, Event, Fix, ImuSample, Rank, Receipt, Verdict
from .inputs import Inputs, Stamps
from .params import EngineParams
from .results import FixResult
from .sins import aiding
from .sins.filter import NavigationFilter
from .sins.fusion import Fusion
from .sins.streams import put_late_fix, room_for_fixes
from .track import Collector, RowSink, Track

__all__ = ['Inputs', 'Progress', 'Result', 'RowSink', 'Stamps', 'Track', 'run']

Progress = Callable[[float], None]
"""Called with the share of the run that is done."""

_STRETCH = 1024
"""Fixes that the compiled loop is given at a time, at most."""
_PIECE = 1 << 16


@dataclass(frozen=True)
class Result:
    """What a run gave: the track, the receipts and why the filter stopped, if it did.

    The track is empty where a sink took its rows.
    """

    track: Track
    receipts: tuple[Receipt, ...]
    divergence: str
    verdicts: Mapping[Verdict, int] = field(default_factory=dict)


def run(
    params: EngineParams,
    inputs: Inputs,
    *,
    progress: Progress | None = None,
    one_by_one: bool = False,
    sink: RowSink | None = None,
    told: bool = False,
) -> Result:
    """Run an engine over the inputs; an estimate every ``params.output_period_s``.

    Parameters
    ----------
    params : EngineParams
    inputs : Inputs
    progress : callable, optional
    one_by_one : bool
        Take event by event, as a node does: slower, the same bits.
    sink : callable, optional
        Takes the rows instead of the result: half a day of covariances does not fit in memory.
    told : bool
        Leave the covariances out of the rows, and put in what nav/state tells (`nav_columns`).
    """
    engine = Engine(params)
    collector = Collector(sink, aiding.make_aiding(params), told=told)
    if one_by_one or not engine.compiled:
        for event in inputs.events():
            collector.take(engine.process(event))
        collector.take(engine.finish())
    else:
        _Compiled(engine, inputs, collector, progress).run()
    collector.drain()
    receipts = tuple(collector.receipts)
    return Result(collector.track(), receipts, engine.divergence, dict(engine.verdicts))


class _Compiled:
    """Drives an engine with arrays: fixes and whatever is odd in Python, the rest compiled."""

    def __init__(
        self, engine: Engine, inputs: Inputs, collector: Collector, progress: Progress | None
    ) -> None:
        self._engine = engine
        self._inputs = inputs
        self._collector = collector
        self._progress = progress
        self._rows = collector.rows
        self._fusion: Fusion | None = None
        self._sort_out()

    def _sort_out(self) -> None:
        """Part what the compiled loop can take from what gets a receipt or is passed over."""
        x = self._inputs
        imu = _finite(x.omega_ib_b) & _finite(x.f_b)
        good = slice(None) if imu.all() else np.flatnonzero(imu)
        stamps_ns = x.imu_stamps_ns[good]
        self._gaps, repeated = _steps(stamps_ns, self._engine.params.max_imu_gap_s * 1e9)
        if repeated:
            imu[np.flatnonzero(imu)[1:][np.diff(stamps_ns) == 0]] = False
        variances = np.diagonal(x.dvl_covariance_m, axis1=1, axis2=2)
        dvl = (
            x.dvl_valid
            & _finite(x.dvl_v_m)
            & _finite(x.dvl_covariance_m.reshape(-1, 9))
            & (variances > 0.0).all(axis=1)
        )
        control = _finite(x.control_force_b) & _finite(x.control_torque_b)
        depth = np.isfinite(x.depth) & np.isfinite(x.depth_variance) & (x.depth_variance > 0.0)
        self._first = int(np.argmax(imu)) if imu.any() else None
        self._kept = replace(
            x,
            imu_stamps_ns=_rows_of(x.imu_stamps_ns, imu),
            omega_ib_b=_rows_of(x.omega_ib_b, imu),
            f_b=_rows_of(x.f_b, imu),
            dvl_stamps_ns=_rows_of(x.dvl_stamps_ns, dvl),
            dvl_v_m=_rows_of(x.dvl_v_m, dvl),
            dvl_covariance_m=_rows_of(x.dvl_covariance_m, dvl),
            depth_stamps_ns=_rows_of(x.depth_stamps_ns, depth),
            depth=_rows_of(x.depth, depth),
            depth_variance=_rows_of(x.depth_variance, depth),
            control_stamps_ns=_rows_of(x.control_stamps_ns, control),
            control_force_b=_rows_of(x.control_force_b, control),
        )
        self._odd: list[Event] = sorted(
            [
                *x.fixes,
                *(x.imu_sample(int(k)) for k in np.flatnonzero(~imu)),
                *(x.dvl_ping(int(k)) for k in np.flatnonzero(~dvl)),
                *(x.depth_sample(int(k)) for k in np.flatnonzero(~depth)),
                *(x.control_sample(int(k)) for k in np.flatnonzero(~control)),
            ],
            key=lambda event: event.key,
        )

    def run(self) -> None:
        """Drive the engine to the end of the inputs."""
        start = None
        if self._first is not None:
            first = self._inputs.imu_sample(self._first)
            start = first.key
        number = told = 0
        while number < len(self._odd):
            event = self._odd[number]
            if start is not None and event.key > start and self._fusion is None:
                self._start(first)
                start = None
            taken = self._take_fixes(number)
            if not taken:
                # A sample whose stamp was there before comes after the first of them.
                rank = int(event.key[1]) + isinstance(event, ImuSample)
                self._advance(event.stamp_ns, rank)
                self._collector.take(self._engine.process(event))
                taken = 1
            number += taken
            if self._progress is not None and number >= told:
                self._progress(number / len(self._odd))
                told = number + len(self._odd) // 100
        if start is not None:
            self._start(first)
        self._advance(NEVER_NS - 1, int(Rank.IMU))
        self._flush(NEVER_NS - 1)
        self._engine.count_locals(self._local_statistics(), self._gaps)
        if self._progress is not None:
            self._progress(1.0)

    def _start(self, first: ImuSample) -> None:
        """The engine makes its filter at the first sample; hand it the arrays."""
        self._collector.take(self._engine.process(first))
        fusion = self._engine.hand_over()
        if fusion is None:
            return
        self._fusion = fusion
        f, x = fusion.filter, self._kept
        controls = len(x.control_stamps_ns) if f.settings.aiding.on else 0
        f.streams = fs.Streams(
            counts=np.array(
                [len(x.imu_stamps_ns), len(x.depth_stamps_ns), len(x.dvl_stamps_ns), 0, controls],
                dtype=np.int64,
            ),
            imu_stamps=_at_least_one(x.imu_stamps_ns),
            omega_ib_b=_at_least_one(x.omega_ib_b),
            f_b=_at_least_one(x.f_b),
            depth_stamps=_at_least_one(x.depth_stamps_ns),
            depth=_at_least_one(x.depth),
            depth_variance=_at_least_one(x.depth_variance),
            dvl_stamps=_at_least_one(x.dvl_stamps_ns),
            dvl_v_m=_at_least_one(x.dvl_v_m),
            dvl_covariance_m=_at_least_one(x.dvl_covariance_m),
            **room_for_fixes(),
            control_stamps=_at_least_one(x.control_stamps_ns),
            control_force_b=_at_least_one(x.control_force_b),
        )
        counters = f.state.counters
        counters[fs.IMU] = 1
        counters[fs.DEPTH] = int(np.searchsorted(x.depth_stamps_ns, first.stamp_ns))
        counters[fs.DVL] = int(np.searchsorted(x.dvl_stamps_ns, first.stamp_ns))
        # The thrust of before the start still holds.
        before = int(np.searchsorted(x.control_stamps_ns, first.stamp_ns))
        counters[fs.CONTROL] = max(0, before - 1)
        f.rows = self._rows
        self._rows.io[0] = first.stamp_ns
        output_ns = f.settings.output_ns
        self._rows.io[2] = (first.stamp_ns // output_ns + 1) * output_ns
        f.log.counts[1] = 0
        fe.take_snapshot(f.state, f.log)

    # -- fixes that need nothing but the filter ---------------------------------------------------

    def _take_fixes(self, number: int) -> int:
        """Let the compiled loop take fixes from a number on, with all that stands before them.

        Returns
        -------
        int
            How many it took: up to the first that is refused or that Python has to look at.
        """
        if self._fusion is None or not self._engine.navigating:
            return 0
        f = self._fusion.filter
        fixes = self._plain_fixes(number) if f.settings.back_propagates else []
        if not fixes:
            return 0
        first = int(f.state.counters[fs.FIX])
        for fix in fixes:
            put_late_fix(f.streams, fix)
        settled = 0
        try:
            code = fs.FULL
            while code == fs.FULL:
                code = f.advance(fixes[-1].receive_ns, fs.FIX_RANK + 1)
                settled = self._settle(f, fixes, first, settled)
                self._collector.note(self._engine)
                if code == fs.FULL:
                    self._collector.drain()
        except FilterDivergence as error:
            settled = self._settle(f, fixes, first, settled)
            self._collector.note(self._engine)
            on_fix = first + settled < f.state.counters[fs.FIX]
            at_ns = fixes[settled].receive_ns if on_fix else f.stamp_ns
            self._engine.diverge(str(error), at_ns)
            if on_fix:
                fix = fixes[settled]
                self._collector.receipts.append(self._engine.take_decided(fix, None, at_ns))
                settled += 1
        else:
            f.streams.counts[fs.FIX - fs.IMU] = f.state.counters[fs.FIX]
            self._engine.note_imu(f.stamp_ns)
        return settled

    def _plain_fixes(self, number: int) -> list[Fix]:
        """Fixes from a number on that nothing but the filter can refuse."""
        found: list[Fix] = []
        names: set[tuple[str, int]] = set()
        for event in self._odd[number : number + _STRETCH]:
            if not isinstance(event, Fix) or not self._engine.leaves_to_filter(event):
                break
            name = (event.source, event.sequence)
            if name in names:
                break
            names.add(name)
            found.append(event)
        return found

    def _settle(self, f: NavigationFilter, fixes: list[Fix], first: int, settled: int) -> int:
        """Give receipts for what the filter decided; the number of fixes that have one.

        ``first`` is the number of the first fix in the streams.
        """
        engine, collector = self._engine, self._collector
        decided = int(f.state.counters[fs.FIX]) - first
        places = np.arange(first + settled, first + decided) % len(f.streams.fix_stamps)
        outcomes, notes = f.streams.fix_outcomes[places], f.streams.fix_notes[places]
        # All were fused, but for the last one perhaps: the compiled loop stops there.
        others = np.flatnonzero(outcomes[:, 0] != fs.FUSED)
        fused = int(others[0]) if len(others) else len(places)
        if fused:
            taken = fixes[settled : settled + fused]
            collector.note_fused(engine, [fix.validity_ns for fix in taken], notes[:fused, 2])
            gate = float(f.settings.gates[fs.VECTOR])
            collector.receipts += engine.take_fused(taken, outcomes[:fused], notes[:fused], gate)
            settled += fused
        if settled < decided and outcomes[fused, 0] >= 0.0:  # else the filter was lost here
            steps, stamp_ns, rows = notes[fused].tolist()
            collector.note(engine, rows)
            result = FixResult(f.outcome_of(outcomes[fused]), steps)
            collector.receipts.append(engine.take_decided(fixes[settled], result, stamp_ns))
            settled += 1
        return settled

    def _advance(self, stamp_ns: int, rank: int) -> None:
        """Take everything before a place in the order of events."""
        if self._fusion is None or not self._engine.navigating:
            return
        f = self._fusion.filter
        try:
            while f.advance(stamp_ns, rank) == fs.FULL:
                self._collector.note(self._engine)
                self._collector.drain()
        except FilterDivergence as error:
            self._collector.note(self._engine)
            self._engine.diverge(str(error), f.stamp_ns)
            return
        self._flush(stamp_ns)
        self._engine.note_imu(f.stamp_ns)

    def _flush(self, stamp_ns: int) -> None:
        """Give what is due before a stamp."""
        if self._fusion is None or not self._engine.navigating:
            return
        if 0 <= self._rows.io[0] < stamp_ns:
            if self._rows.io[1] >= len(self._rows.stamps):
                self._collector.note(self._engine)
                self._collector.drain()
            f = self._fusion.filter
            filter_run.put_row(f.state, f.settings, self._rows)
        self._collector.note(self._engine)

    def _local_statistics(self) -> Array:
        """Sum over the run."""
        self._collector.drain()
        total = self._collector.local_statistics
        if self._fusion is not None:
            total = total + self._fusion.filter.state.tally[: fs.FIX_ROW]
        return total


def _finite(values: Array) -> NDArray[np.bool_]:
    with np.errstate(over='ignore', invalid='ignore'):
        total = np.sum(values)
    if np.isfinite(total):  # nearly always, and many times as fast as row by row
        return np.ones(len(values), dtype=bool)
    return np.asarray(np.isfinite(values).all(axis=1))


def _steps(stamps_ns: Stamps, longest_ns: float) -> tuple[int, bool]:
    """How many steps are longer than that, and whether one is zero; no large array is made."""
    gaps, repeated = 0, False
    for start in range(0, len(stamps_ns), _PIECE):
        steps_ns = np.diff(stamps_ns[start : start + _PIECE + 1])
        gaps += int(np.count_nonzero(steps_ns > longest_ns))
        repeated |= not steps_ns.all()
    return gaps, repeated


def _rows_of(values: NDArray[Any], keep: NDArray[np.bool_]) -> NDArray[Any]:
    return np.ascontiguousarray(values if keep.all() else values[keep])


def _at_least_one(values: NDArray[Any]) -> NDArray[Any]:
    """Return the array, or one row of zeros for an empty one: a ring has a length."""
    return values if len(values) else np.zeros((1, *values.shape[1:]), dtype=values.dtype)
