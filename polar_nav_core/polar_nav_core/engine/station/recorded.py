"""Filter of station mode that records its run, and may be run once more at a smoothed track."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...kernels.station import run
from ...kernels.station import state as ss
from ...order import NEVER_NS
from ..events import Fix, ImuSample, InitialState, OrderKey, Rank
from ..params import EngineParams
from ..results import FixResult
from . import arrays
from .filter import StationFilter
from .fixes import fix_row, polar_of
from .fusion import StationFusion, outcome_of
from .nodes import Nodes


class FixPlan(NamedTuple):
    """What is decided about a fix: its row of outcomes, and the inflation of S of all members."""

    outcome: Array
    inflation: float


@dataclass(frozen=True)
class Plan:
    """What is known before a filter runs once more.

    Attributes
    ----------
    states : mapping of int to (B, 12) array
        Smoothed states of the members by the stamps of their nodes [ns]: where steps and rows are
        linearized.
    fixes : mapping of OrderKey to FixPlan
    """

    states: Mapping[int, Array]
    fixes: Mapping[OrderKey, FixPlan]


class _Track:
    """Runs ahead of a filter along a smoothed track, whose states its steps are linearized at.

    From node to node the track moves by the model; what moves it is the bank's own code, without
    measurements.
    """

    def __init__(self, f: StationFilter, states: Mapping[int, Array]) -> None:
        self._states = states
        self._log = arrays.make_log(0.0, len(f.bank.x), snapshots=False, jumps=False)
        self._rows = arrays.make_rows(0, len(f.bank.x))
        self._work = arrays.make_work(len(f.bank.x))
        self.bank = arrays.make_bank(len(f.bank.x))
        self.at_node(f)

    def at_node(self, f: StationFilter) -> None:
        """Go to the smoothed state of the node at which the filter is, if there is one."""
        for own, of in zip(self.bank, f.bank, strict=True):
            own[...] = of
        self.bank.x[:] = self._states.get(f.stamp_ns, f.bank.x)

    def advance(self, f: StationFilter, until_ns: int, until_rank: int) -> None:
        """Fill the filter's log with the points of the steps that come."""
        counts = f.streams.counts.copy()
        counts[2:] = 0  # neither depth nor fixes
        self.bank.counters[[ss.DEPTH, ss.FIX]] = 0
        streams = f.streams._replace(counts=counts)
        log = self._log._replace(points=f.log.points)
        run.advance(
            self.bank,
            f.settings,
            self._work,
            streams,
            log,
            until_ns,
            until_rank,
            False,
            self._rows,
        )


class RecordedFilter(StationFilter):
    """Filter whose states become nodes at fixes and every so often.

    Parameters
    ----------
    params, initial, stamp_ns : as of `StationFilter`
    tape : Tape
        Gets the nodes and the fixes.
    """

    def __init__(
        self,
        params: EngineParams,
        initial: InitialState,
        stamp_ns: int,
        tape: Tape,
    ) -> None:
        super().__init__(params, initial, stamp_ns)
        self._tape, self._plan = tape, tape.plan
        self._track: _Track | None = None
        self.log = self.log._replace(tape=arrays.make_tape(len(self.bank.x)))

    def begin(self, sample: ImuSample) -> None:
        """Start at the sample; the start is a node."""
        super().begin(sample)
        self._begin()

    def restore(self, lost: StationFilter) -> None:
        """Begin with the newest sound state of a lost filter; nothing before bears on it."""
        super().restore(lost)
        self._begin()

    def _begin(self) -> None:
        record = self._node()
        record['begins'] = True
        self._tape.nodes.append(record)
        if self._plan is not None:
            self._track = _Track(self, self._plan.states)

    def advance(
        self, until_ns: int = NEVER_NS, until_rank: int = 0, *, frozen: bool = False
    ) -> int:
        """Process the samples before a stamp [ns] and rank, with nodes on the way."""
        del frozen
        streams, every_ns = self.streams, self._tape.every_ns
        while True:
            next_imu = int(self.bank.counters[ss.IMU])
            if next_imu >= int(streams.counts[0]):
                return self._advance(until_ns, until_rank)
            next_ns = int(streams.imu_stamps[next_imu % len(streams.imu_stamps)])
            due_ns = -(-next_ns // every_ns) * every_ns
            if (due_ns, int(Rank.IMU)) >= (until_ns, until_rank):
                return self._advance(until_ns, until_rank)
            code = self._advance(due_ns, int(Rank.IMU) + 1)
            if code != ss.DONE:
                return code
            record = self._node()
            record['shown'] = due_ns % self._tape.shown_ns == 0
            self._note(record)

    def _advance(self, until_ns: int, until_rank: int) -> int:
        if self._track is not None:
            self._track.advance(self, until_ns, until_rank)
        return super().advance(until_ns, until_rank, frozen=self._plan is not None)

    def fix(self, fix: Fix) -> Array:
        """Fuse a fix at its validity; returns its row of outcomes."""
        self.advance(fix.validity_ns, int(Rank.FIX))
        record = self._node()
        k = int(self.streams.counts[3]) % len(self.streams.fix_stamps)
        self._put(fix, k)
        super().advance(fix.validity_ns, int(Rank.FIX) + 1, frozen=self._plan is not None)
        self._note(self._with_fix(record, k))
        self._tape.fixes.append(fix)
        row: Array = self.streams.outcomes[k]
        return row

    def end(self) -> None:
        """Make a node of the state now, if it is a sound one."""
        if run.healthy(self.bank, self.settings):
            self._note(self._node())

    def _put(self, fix: Fix, k: int) -> None:
        """Append a fix to the streams, with what is planned."""
        s = self.streams
        s.fix_stamps[k] = fix.validity_ns
        s.fixes[k] = fix_row(self._p, polar_of(fix))
        s.outcomes[k] = 0.0
        s.outcomes[k, ss.DECIDED] = ss.UNDECIDED
        planned = None if self._plan is None else self._plan.fixes.get(fix.key)
        if planned is not None and self._track is not None:
            s.outcomes[k] = planned.outcome
            s.fix_inflations[k] = planned.inflation
            s.fix_points[k] = self._track.bank.x
        s.counts[3] += 1

    def _node(self) -> np.ndarray:
        """Record of the state now, and of the way to it."""
        b, tape = self.bank, self.log.tape
        record = self._tape.nodes.new()
        record['stamp'] = self.stamp_ns
        for name in ('x', 'P', 'S', 'log_weight', 'flat', 'loose', 'counters'):
            record[name] = getattr(b, name)
        for name in ('Psi', 'vector', 'information'):
            record[name] = getattr(tape, name)
        return record

    def _with_fix(self, record: np.ndarray, k: int) -> np.ndarray:
        """The record with the fix that was just decided, at place k of the streams."""
        w, s = self.work, self.streams
        record['fix'], record['outcome'] = len(self._tape.fixes), s.outcomes[k]
        record['fused'] = s.outcomes[k, ss.DECIDED] == ss.FUSED
        record['inflation'] = s.fix_inflations[k]
        record['H'], record['z'] = self.log.tape.H, w.z
        record['J'] = w.J if self.settings.shares else 0.0
        S = w.S[:, [0, 1, 1, 2]].reshape(-1, 2, 2) * s.fix_inflations[k][:, None, None]
        record['S_z'] = S
        with np.errstate(all='ignore'):
            record['K'] = np.swapaxes(np.linalg.solve(S, w.PHt), 1, 2)
        return record

    def _note(self, record: np.ndarray) -> None:
        """Append a node and begin the way to the next."""
        self._tape.nodes.append(record)
        tape = self.log.tape
        tape.Psi[:] = np.eye(ss.N)
        tape.vector[:], tape.information[:] = 0.0, 0.0
        if self._track is not None:
            self._track.at_node(self)


class Recorded(StationFusion):
    """Filter that is recorded; its fixes come when they are valid.

    Parameters
    ----------
    params, initial, stamp_ns : as of `StationFusion`
    tape : Tape
        Gets the nodes and the fixes.
    """

    def __init__(
        self, params: EngineParams, initial: InitialState, stamp_ns: int, tape: Tape
    ) -> None:
        self._tape = tape
        super().__init__(params, initial, stamp_ns)

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> StationFilter:
        """Filter that makes nodes."""
        return RecordedFilter(params, initial, stamp_ns, self._tape)

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix at its validity."""
        f = self.filter
        if not isinstance(f, RecordedFilter):
            raise TypeError('the filter is not recorded')
        return FixResult(outcome_of(f.fix(fix), float(f.settings.gates[2])), 0)

    def offset(self, fix: Fix) -> tuple[Array, float] | None:
        """As `StationFusion.offset`; None where fixes are decided on already."""
        return None if self._tape.plan is not None else super().offset(fix)


class Tape:
    """Record of a run in station mode, for a backward pass.

    Parameters
    ----------
    members : int
        Of the bank.
    every_ns, shown_ns : int
        From one node to the next, and of those that are put out [ns].
    plan : Plan, optional

    Attributes
    ----------
    nodes : Nodes
    fixes : list of Fix
        By their numbers in the nodes.
    filter : StationFilter or None
        The newest: its settings and streams.
    """

    def __init__(
        self, members: int, every_ns: int, shown_ns: int, plan: Plan | None = None
    ) -> None:
        self.nodes = Nodes(members)
        self.every_ns, self.shown_ns, self.plan = every_ns, shown_ns, plan
        self.fixes: list[Fix] = []
        self.filter: StationFilter | None = None

    def make(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> Recorded:
        """Fusion of an engine whose filter is recorded."""
        fusion = Recorded(params, initial, stamp_ns, self)
        self.filter = fusion.filter
        return fusion

    def take(self) -> None:
        """Make a node of the state now, at the end: what was measured since the last one."""
        if isinstance(self.filter, RecordedFilter) and len(self.nodes):
            self.filter.end()
