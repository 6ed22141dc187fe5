"""`rewind`: go back to the stored state before a late fix, fuse it, process the rest again.

Exact on the full nonlinear filter: the result is, bit for bit, that of the same events processed
in the order of their validity. Gates and linearization are decided anew. It costs as much as the
time that it goes back.
"""

from __future__ import annotations

from ...arrays import Array
from ...kernels.sins import output
from ...kernels.sins import run as filter_run
from ...kernels.sins import state as fs
from ...kernels.sins.aiding import model_is_definite
from ...kernels.sins.update import is_positive_definite
from ..events import Fix, InitialState, Rank
from ..params import EngineParams
from ..results import FixResult, Outcome
from ..rewind import Cursor, GoingBack, Stored
from .filter import NavigationFilter
from .fusion import Fusion
from .streams import insert_fix


class Rewind(Fusion):
    """Strategy for late fixes: go back to a snapshot, fuse, and process all later data again.

    Parameters
    ----------
    params, initial, stamp_ns
        As for :class:`Fusion`.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        self._back = GoingBack(self, params.history_s)

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Filter that stores snapshots of itself."""
        return NavigationFilter(params, initial, stamp_ns, snapshots=True)

    def oldest_ns(self) -> int:
        """Oldest validity stamp [ns] at which a fix can still be fused."""
        return self._back.oldest_ns()

    def fix(self, fix: Fix) -> FixResult | None:
        """Result of a fix fused at its validity; None if the stored past does not reach it."""
        return self._back.fix(fix)

    def forget_past(self) -> None:
        """End going back at the present: what was enlarged now would be undone."""
        self.filter.snapshot_here()
        self._back.end_here()

    # -- what going back asks for -----------------------------------------------------------------

    def stored(self) -> Stored:
        """Stored past of the filter; the arrays are views of the filter's own."""
        log, s = self.filter.log, self.filter.streams
        return Stored(
            self.filter.state.counters,
            int(log.counts[1]),
            log.snapshot_counters,
            s.fix_outcomes,
            (
                Cursor(fs.IMU, len(s.imu_stamps), None, Rank.IMU),
                Cursor(fs.DEPTH, len(s.depth_stamps), s.depth_stamps, Rank.DEPTH),
                Cursor(fs.DVL, len(s.dvl_stamps), s.dvl_stamps, Rank.DVL),
                Cursor(fs.HEADING, len(s.heading_stamps), s.heading_stamps, Rank.HEADING),
                # A thrust only sets what the next step integrates: it commutes with a fix.
                Cursor(fs.CONTROL, len(s.control_stamps), None, Rank.CONTROL),
                Cursor(fs.FIX, len(s.fix_stamps) - 1, None, Rank.FIX),
            ),
            stamp=fs.STAMP,
            step=fs.STEPS,
            fix=fs.FIX,
        )

    def insert(self, fix: Fix, number: int) -> None:
        """Insert a fix at an index of the stored ones; those at and after it move up by one."""
        f = self.filter
        insert_fix(f.streams, fix, f.leader.split(fix), number)

    def process_again(self, fix: Fix, snapshot: int | None) -> None:
        """Process all inputs received before the fix again, then the fix; without output rows."""
        f = self.filter
        if snapshot is not None:
            filter_run.restore(f.state, f.log, snapshot)
        f.state.counting[0] = 0
        until = fix.receive_ns, fs.FIX_RANK + 1
        try:
            code = filter_run.advance(*f.parts, f.streams, *until, output.NO_ROWS)
        finally:
            f.state.counting[0] = 1
        if code == fs.DONE and not self._is_definite():
            code = fs.P_NOT_DEFINITE
        f.check(code)

    def _is_definite(self) -> bool:
        """Whether the covariance that results is positive definite, that of the model too."""
        s, c, w = self.filter.state, self.filter.settings, self.filter.work
        if not is_positive_definite(s.P, c.active, w.LP):
            return False
        return not c.aiding.on or bool(model_is_definite(s, c, w, True))

    def outcome_of(self, row: Array) -> Outcome:
        """Outcome of a fix from its row of outcomes."""
        return self.filter.outcome_of(row)
