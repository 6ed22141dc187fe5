"""`rewind`: go back to the stored state before a late fix, take it, process the rest again.

Exact on the full nonlinear filter: the result is, bit for bit, that of the same events processed
in the order of their validity. Gates and linearization are decided anew. It costs as much as the
time that it goes back.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import TypeAlias

from ...kernels.sins import run as filter_run
from ...kernels.sins import state as fs
from ..events import Array, Fix, InitialState, Rank
from ..params import EngineParams
from ..results import FixResult
from .filter import NavigationFilter
from .fusion import Fusion
from .streams import insert_fix

_Key: TypeAlias = tuple[int, int, int]
"""Validity, number of the packet, number of arrival."""


class Rewind(Fusion):
    """Late fixes by going back.

    Parameters
    ----------
    params, initial, stamp_ns
        As for :class:`Fusion`.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        self._length_ns = round(params.history_s * 1e9)
        # Fixes of the stored past, in the order of their validity; the first has this number.
        self._fixes: list[Fix] = []
        self._keys: list[_Key] = []
        self._first = 0

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Return a filter that takes snapshots."""
        return NavigationFilter(params, initial, stamp_ns, snapshots=True)

    def oldest_ns(self) -> int:
        """Oldest validity that a fix may have to be fused."""
        f = self.filter
        return int(self._snapshot_stamp(self._oldest_usable())) if f.log.counts[1] else 0

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix where it belongs."""
        f = self.filter
        number = self._snapshot_before(fix.validity_ns)
        if number is None:
            return None
        key = (fix.validity_ns, fix.order, fix.arrival)
        place = bisect_left(self._keys, key)
        late = self._comes_late(key)
        insert_fix(f.streams, fix, self._first + place)
        self._fixes.insert(place, fix)
        self._keys.insert(place, key)
        before = self._outcomes(place + 1)
        steps = f.history.step - self._snapshot_counter(number, fs.STEPS) if late else 0
        self._process_again(fix, number if late else -1)
        own, *after = self._outcomes(place)
        # Of the fixes before it nothing changes.
        revised = tuple(
            (self._fixes[i], f.outcome_of(new))
            for i, (old, new) in enumerate(zip(before, after, strict=True), start=place + 1)
            if old[0] != new[0]
        )
        self._forget(fix.receive_ns - self._length_ns)
        return FixResult(f.outcome_of(own), steps, revised)

    def _process_again(self, fix: Fix, snapshot: int) -> None:
        """Process everything that was received before the fix, and the fix; no output.

        From a snapshot on; -1: from the state as it is.
        """
        f = self.filter
        code = filter_run.process_again(
            f.state,
            f.frames,
            f.settings,
            f.past,
            f.work,
            f.log,
            f.streams,
            fix.receive_ns,
            fs.FIX_RANK + 1,
            fs.NO_ROWS,
            snapshot,
        )
        f.check(code)

    def _comes_late(self, key: _Key) -> bool:
        """Whether anything that was processed stands after this place."""
        s, streams = self.filter.state, self.filter.streams
        mine = (key[0], int(Rank.FIX))
        cursors = (
            (fs.DEPTH, streams.depth_stamps, Rank.DEPTH),
            (fs.DVL, streams.dvl_stamps, Rank.DVL),
        )
        if (int(s.counters[fs.STAMP]), int(Rank.IMU)) > mine:
            return True
        for counter, stamps, rank in cursors:
            n = int(s.counters[counter])
            if n and (int(stamps[(n - 1) % len(stamps)]), int(rank)) > mine:
                return True
        return bool(self._keys) and self._keys[-1] > key

    def _outcomes(self, place: int) -> list[Array]:
        """Rows of fix_outcomes of the fixes that are kept, from a place on; copies."""
        outcomes = self.filter.streams.fix_outcomes
        numbers = range(self._first + place, self._first + len(self._fixes))
        return [outcomes[n % len(outcomes)].copy() for n in numbers]

    # -- snapshots --------------------------------------------------------------------------------

    def _snapshot_stamp(self, number: int) -> int:
        return self._snapshot_counter(number, fs.STAMP)

    def _snapshot_counter(self, number: int, counter: int) -> int:
        counters = self.filter.log.snapshot_counters
        return int(counters[number % len(counters), counter])

    def _oldest_usable(self) -> int:
        """Oldest snapshot from which all inputs since are still stored."""
        log, streams = self.filter.log, self.filter.streams
        high = int(log.counts[1]) - 1
        low = max(0, high + 1 - len(log.snapshot_flat))
        processed = self.filter.state.counters.tolist()
        oldest = {
            fs.IMU: processed[fs.IMU] - len(streams.imu_stamps),
            fs.DEPTH: processed[fs.DEPTH] - len(streams.depth_stamps),
            fs.DVL: processed[fs.DVL] - len(streams.dvl_stamps),
            fs.CONTROL: processed[fs.CONTROL] - len(streams.control_stamps),
            fs.FIX: max(processed[fs.FIX] - len(streams.fix_stamps) + 1, self._first),
        }
        middle = low  # mostly there is room for all
        while low < high:
            counters = log.snapshot_counters[middle % len(log.snapshot_counters)].tolist()
            if all(counters[c] >= number for c, number in oldest.items()):
                high = middle
            else:
                low = middle + 1
            middle = (low + high) // 2
        return low

    def _snapshot_before(self, stamp_ns: int) -> int | None:
        """Newest snapshot at or before a stamp; None when the stored past does not reach it."""
        low, high = self._oldest_usable(), int(self.filter.log.counts[1]) - 1
        if self._snapshot_stamp(low) > stamp_ns:
            return None
        while low < high:
            middle = (low + high + 1) // 2
            if self._snapshot_stamp(middle) <= stamp_ns:
                low = middle
            else:
                high = middle - 1
        return low

    def _forget(self, before_ns: int) -> None:
        """Drop fixes from before the stored past, in bulk: rewinding never goes back to them."""
        if self._keys[0][0] < before_ns - self._length_ns:
            gone = bisect_left(self._keys, (before_ns, 0, 0))
            del self._keys[:gone], self._fixes[:gone]
            self._first += gone
