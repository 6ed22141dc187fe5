"""`rewind`: go back to the stored state before a late fix, take it, process the rest again.

Exact on the full nonlinear filter: the result is, bit for bit, that of the same events processed
in the order of their validity. Gates and linearization are decided anew. It costs as much as the
time that it goes back.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import TypeAlias

import numpy as np

from ...kernels import filter_run
from ...kernels import filter_state as fs
from ..events import Array, Fix, InitialState, Rank
from ..params import EngineParams
from .fusion import FixResult, Fusion
from .navigation import NavigationFilter, Outcome
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
        before, steps = self._outcomes(), f.history.step
        if late:
            filter_run.restore(f.state, f.frames, f.settings, f.log, number)
            steps -= f.history.step
        else:
            steps = 0
        self._process_again(fix)
        after = self._outcomes()
        own = self._outcome(after[place])
        revised = tuple(
            (self._fixes[i], self._outcome(after[i]))
            for i in range(len(after))
            if i != place and after[i, 0] != before[i, 0]
        )
        self._forget(fix.receive_ns - self._length_ns)
        return FixResult(own, steps, revised)

    def _process_again(self, fix: Fix) -> None:
        """Process everything that was received before the fix, and the fix; no output."""
        f = self.filter
        rows, f.rows = f.rows, fs.NO_ROWS
        f.state.counting[0] = 0
        try:
            f.advance(fix.receive_ns, int(Rank.FIX) + 1)
        finally:
            f.state.counting[0] = 1
            f.rows = rows

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

    def _outcomes(self) -> Array:
        """Rows of fix_outcomes of the fixes that are kept."""
        outcomes = self.filter.streams.fix_outcomes
        numbers = np.arange(self._first, self._first + len(self._fixes)) % len(outcomes)
        return outcomes[numbers]

    def _outcome(self, row: Array) -> Outcome:
        gate = float(self.filter.settings.gates[3])
        return Outcome(
            bool(row[0] == fs.FUSED),
            row[2:5].copy(),
            row[5:8].copy(),
            float(row[1]),
            3,
            gate,
            float(row[8]),
        )

    # -- snapshots --------------------------------------------------------------------------------

    def _snapshot_stamp(self, number: int) -> int:
        counters = self.filter.log.snapshot_counters
        return int(counters[number % len(counters), fs.STAMP])

    def _oldest_usable(self) -> int:
        """Oldest snapshot from which all inputs since are still stored."""
        log, streams = self.filter.log, self.filter.streams
        high = int(log.counts[1]) - 1
        low = max(0, high + 1 - len(log.snapshot_flat))
        pairs = (
            (fs.IMU, len(streams.imu_stamps), 0),
            (fs.DEPTH, len(streams.depth_stamps), 1),
            (fs.DVL, len(streams.dvl_stamps), 2),
            (fs.FIX, len(streams.fix_stamps) - 1, 3),
            (fs.CONTROL, len(streams.control_stamps), 4),
        )
        while low < high:
            middle = (low + high) // 2
            counters = log.snapshot_counters[middle % len(log.snapshot_counters)]
            processed = self.filter.state.counters
            if all(processed[c] - counters[c] <= room for c, room, _ in pairs) and (
                counters[fs.FIX] >= self._first
            ):
                high = middle
            else:
                low = middle + 1
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
