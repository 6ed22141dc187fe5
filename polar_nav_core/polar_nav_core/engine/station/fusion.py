"""Fusion of measurements in station mode, with the same strategies for late fixes as SINS mode.

`ignore`, `tagged` and `back_propagate` bring a fix to the present. `rewind` and `clone` go back to
where it belongs and filter the stored inputs again: `rewind` anew, `clone` with the slopes and
decisions of the first time, which is what a filter with explicitly cloned states gives.
"""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from ...arrays import Array
from ...identification.result import Identification
from ...kernels.station import forward as station_forward
from ...kernels.station import run
from ...kernels.station import state as ss
from ..driver import Driver
from ..events import ControlSample, DepthSample, Fix, ImuSample, InitialState, Local, Rank
from ..outputs import Estimate
from ..params import EngineParams
from ..results import FixResult, Outcome
from ..rewind import Cursor, GoingBack, Stored
from ..saved import SavedState
from .filter import StationFilter
from .fixes import fix_row, polar_of

_NOT_USED = Outcome(False, np.full(3, np.nan), np.full(3, np.nan), math.nan, 0, math.inf)


def outcome_of(row: Array, gate: float) -> Outcome:
    """Outcome of a fix: estimate minus measurement along x and y of the station frame [m]."""
    c, s = math.cos(row[ss.AZIMUTH]), math.sin(row[ss.AZIMUTH])
    distance = row[ss.DISTANCE]
    J = np.array([[c, -distance * s], [s, distance * c]])
    z = np.zeros(3)
    z[:2] = -np.einsum('ij,j->i', J, row[ss.Z0 : ss.Z1 + 1])
    S = np.array([[row[ss.S00], row[ss.S01]], [row[ss.S01], row[ss.S11]]])
    variance = np.full(3, np.nan)
    variance[:2] = np.einsum('ij,jk,ik->i', J, S, J)
    fused = bool(row[ss.DECIDED] == ss.FUSED)
    return Outcome(fused, z, variance, float(row[ss.NIS]), 2, gate, float(row[ss.INFLATION]))


class StationFusion:
    """The filter of station mode with its measurements; each subclass treats late fixes.

    Parameters
    ----------
    params : EngineParams
    initial : InitialState
    stamp_ns : int
        When the initial state holds.
    """

    snapshots = False
    jumps = False
    limit = ''
    """Why the fix before could not be fused, where it is not the length of the stored past."""

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        self.params = params
        self.filter = self.make_filter(params, initial, stamp_ns)
        self._start_ns = stamp_ns

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> StationFilter:
        """Filter with what this strategy stores."""
        return StationFilter(params, initial, stamp_ns, snapshots=self.snapshots, jumps=self.jumps)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample."""
        return self.filter.stamp_ns

    def begin(self, sample: ImuSample) -> None:
        """Start at the sample at the stamp of the initial state."""
        self.filter.begin(sample)

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample."""
        self.filter.imu(sample)

    def control(self, sample: ControlSample) -> None:
        """Store the thrust that holds from its stamp on."""
        self.filter.control(sample)

    def local(self, event: Local) -> Outcome:
        """Fuse a depth and return the outcome; this mode has no DVL."""
        return self.filter.depth(event) if isinstance(event, DepthSample) else _NOT_USED

    def estimate(self, fixes: tuple[int, int, int]) -> Estimate:
        """Estimate at the newest IMU sample."""
        return self.filter.estimate(fixes)

    def saved(self, fixes: tuple[int, int, int], records: tuple[bytes, bytes]) -> SavedState:
        """State as it is now, with its fixes, to go on from after a restart."""
        return self.filter.saved(fixes, records)

    def height(self) -> float:
        """Height of the vehicle above the station's first position [m]."""
        return float(self.filter.bank.x[0, ss.POSITION + 2])

    def adapt(self, identified: Identification) -> None:
        """Replace drag and current by those of an accepted identification."""
        self.filter.adapt(identified)

    def restore(self, lost: Driver) -> bool:
        """Begin with the newest sound state of one that was lost, enlarged; True if it is one."""
        if not isinstance(lost, StationFusion):
            return False
        self.filter.restore(lost.filter)
        return True

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix; None when the stored history does not reach back to its validity."""
        raise TypeError(f'{type(self).__name__} has no way to treat fix {fix.sequence}')

    def oldest_ns(self) -> int:
        """Oldest validity stamp [ns] at which a fix can still be fused."""
        f = self.filter
        kept = min(len(f.log.points), len(f.streams.imu_stamps) - 1)
        first = max(f.begun, int(f.streams.counts[0]) - kept)
        return int(f.streams.imu_stamps[first % len(f.streams.imu_stamps)])

    def offset(self, fix: Fix) -> tuple[Array, float] | None:
        """Fix minus present estimate, grid axes [m], and its NIS by the covariance now."""
        polar = polar_of(fix)
        x, P = self.filter.mixture()
        d = x[ss.POSITION : ss.CURRENT] - polar.station
        distance = math.hypot(d[0], d[1])
        row = fix_row(self.params, polar)
        azimuth = polar.station_heading + polar.bearing - x[ss.STATION]
        across = math.sqrt(max(polar.range**2 - d[2] ** 2, 0.0))
        offset = across * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        offset[:2] -= d[:2]
        e = d[:2] / distance
        J = np.array([[e[0], -distance * e[1]], [e[1], distance * e[0]]])
        noise = np.diag([row[ss.RANGE_VARIANCE], row[ss.BEARING_VARIANCE]])
        noise[1, 1] += P[ss.STATION, ss.STATION]
        S = P[ss.HORIZONTAL, ss.HORIZONTAL] + np.einsum('ij,jk,lk->il', J, noise, J)
        return offset, float(offset[:2] @ np.linalg.solve(S, offset[:2]))


class Forward(StationFusion):
    """Strategies that refer a late fix to the present."""

    jumps = True
    kind = ss.IGNORE

    def fix(self, fix: Fix) -> FixResult | None:
        """Result of a fix fused at the present; None if its validity is not stored any more."""
        f = self.filter
        streams, newest = f.streams, int(f.bank.counters[ss.IMU])
        when_ns = fix.receive_ns if self.kind == ss.IGNORE else fix.validity_ns
        first = self._sample_after(when_ns)
        if first is None:
            return None
        before_ns = int(streams.imu_stamps[(first - 1) % len(streams.imu_stamps)])
        if self.kind == ss.BACK_PROPAGATE and not self._invertible(first):
            return None
        row, outcome = fix_row(self.params, polar_of(fix)), np.zeros(ss.OUTCOME)
        station_forward.forward_fix(
            f.bank,
            f.settings,
            f.work,
            streams,
            f.log,
            row,
            outcome,
            first,
            (when_ns - before_ns) * 1e-9,
            self.kind,
        )
        f.check()
        result = outcome_of(outcome, float(f.settings.gates[2]))
        return FixResult(result, newest - first)

    def _invertible(self, first: int) -> bool:
        """Whether the transition since IMU sample number ``first`` may be inverted."""
        f = self.filter
        tame = int(station_forward.tame_since(f.bank, f.settings, f.work, f.streams, f.log, first))
        stamps = f.streams.imu_stamps
        reach_s = (f.stamp_ns - int(stamps[(tame - 1) % len(stamps)])) * 1e-9
        self.limit = (
            ''
            if tame == first
            else f'back_propagate reaches back {reach_s:.2f} s here: drag has damped the velocity '
            'since, and the inverse of that enlarges every error (rewind and clone have no such '
            'limit)'
        )
        return not self.limit

    def _sample_after(self, stamp_ns: int) -> int | None:
        """Number of the first IMU sample after a stamp [ns]; None if it is not stored."""
        streams = self.filter.streams
        count = int(streams.counts[0])
        length = len(streams.imu_stamps)
        low = max(self.filter.begun, count - (length - 1))
        if int(streams.imu_stamps[low % length]) > stamp_ns:
            return None

        def stamp(i: int) -> int:
            return int(streams.imu_stamps[i % length])

        return bisect_right(range(count), stamp_ns, lo=low, key=stamp)


class Ignore(Forward):
    """Fix treated as valid at reception."""


class Tagged(Forward):
    """Innovation at the time of validity, applied to the present as it is."""

    kind = ss.TAGGED


class BackPropagate(Forward):
    """Innovation at validity with H* = H Phi^-1."""

    kind = ss.BACK_PROPAGATE


class Rewind(StationFusion):
    """Strategy for late fixes: go back to a snapshot, fuse, and filter all later data again."""

    snapshots = True
    frozen = False

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        self._back = GoingBack(self, params.history_s)

    def oldest_ns(self) -> int:
        """Oldest validity stamp [ns] at which a fix can still be fused."""
        return self._back.oldest_ns()

    def fix(self, fix: Fix) -> FixResult | None:
        """Result of a fix fused at its validity; None if the stored past does not reach it."""
        return self._back.fix(fix)

    def adapt(self, identified: Identification) -> None:
        """Replace drag and current; rewinding ends at this stamp from now on."""
        super().adapt(identified)
        self._back.end_here()

    # -- what going back asks for -----------------------------------------------------------------

    def stored(self) -> Stored:
        """Stored past of the filter; the arrays are views of the filter's own."""
        log, s = self.filter.log, self.filter.streams
        # The attitude before the first step is needed too.
        imu = min(len(s.imu_stamps) - 1, len(log.points))
        return Stored(
            self.filter.bank.counters,
            int(log.counts[0]),
            log.counters,
            s.outcomes,
            (
                Cursor(ss.IMU, imu, None, Rank.IMU),
                Cursor(ss.CONTROL, len(s.control_stamps), s.control_stamps, Rank.CONTROL),
                Cursor(ss.DEPTH, len(s.depth_stamps), s.depth_stamps, Rank.DEPTH),
                Cursor(ss.FIX, len(s.fix_stamps) - 1, None, Rank.FIX),
            ),
            stamp=ss.STAMP,
            step=ss.IMU,
            fix=ss.FIX,
        )

    def insert(self, fix: Fix, number: int) -> None:
        """Insert a fix at an index of the stored ones; those at and after it move up by one."""
        s = self.filter.streams
        length = len(s.fix_stamps)
        columns = (s.fix_stamps, s.fixes, s.outcomes, s.fix_points, s.fix_inflations)
        for k in range(int(s.counts[3]), number, -1):
            for column in columns:
                column[k % length] = column[(k - 1) % length]
        i = number % length
        s.fix_stamps[i] = fix.validity_ns
        s.fixes[i] = fix_row(self.params, polar_of(fix))
        s.outcomes[i] = 0.0
        s.outcomes[i, ss.DECIDED] = ss.UNDECIDED
        s.counts[3] += 1

    def process_again(self, fix: Fix, snapshot: int | None) -> None:
        """Process all inputs received before the fix again, then the fix; without output rows."""
        f = self.filter
        if snapshot is not None:
            run.restore(f.bank, f.log, snapshot)
        rows, f.rows = f.rows, f.no_rows
        f.bank.counting[0] = 0
        try:
            f.advance(fix.receive_ns, int(Rank.FIX) + 1, frozen=self.frozen)
        finally:
            f.bank.counting[0] = 1
            f.rows = rows

    def outcome_of(self, row: Array) -> Outcome:
        """Outcome of a fix from its row of outcomes."""
        return outcome_of(row, float(self.filter.settings.gates[2]))


class Clone(Rewind):
    """Rewind on the linearization that was stored when the inputs came."""

    frozen = True
