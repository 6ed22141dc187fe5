"""`rewind`: go back to the stored state before a late fix, take it, process the rest again.

Exact on the full nonlinear filter: the result is, bit for bit, that of the same events processed
in the order of their validity. Gates and linearization are decided anew. It costs as much as the
time that it goes back.
"""

from __future__ import annotations

import copy
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import Any

from ..events import DepthSample, DvlPing, Fix, ImuSample, InitialState, OrderKey, Rank
from ..params import EngineParams
from .fusion import FixResult, Fusion
from .navigation import Outcome


@dataclass
class _Entry:
    """One processed input; for a fix also whether it was fused."""

    key: OrderKey
    event: ImuSample | DvlPing | DepthSample | Fix
    fused: bool | None = None


@dataclass(frozen=True)
class _Snapshot:
    """State right after the IMU sample with this key."""

    key: OrderKey
    state: dict[str, Any]
    noise: tuple[Any, Any]


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
        self._log: list[_Entry] = []
        self._snapshots: list[_Snapshot] = []
        self._store((stamp_ns, Rank.IMU, 0, 0))

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample."""
        step = self.filter.history.step
        self.filter.imu(sample)
        self._log.append(_Entry(sample.key, sample))
        if self.filter.history.step != step:
            self._store(sample.key)

    def local(self, event: DvlPing | DepthSample) -> Outcome:
        """Fuse DVL or depth."""
        outcome = super().local(event)
        self._log.append(_Entry(event.key, event))
        return outcome

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix where it belongs."""
        key: OrderKey = (fix.validity_ns, Rank.FIX, fix.order, fix.arrival)
        number = bisect_left(self._snapshots, key, key=lambda s: s.key) - 1
        if number < 0:
            return None
        entry = _Entry(key, fix)
        if not self._log or self._log[-1].key < key:
            return FixResult(self._take_fix(entry), 0)
        step = self.filter.history.step
        snapshot = self._snapshots[number]
        del self._snapshots[number + 1 :]
        start = bisect_right(self._log, snapshot.key, key=lambda e: e.key)
        tail = self._log[start:]
        del self._log[start:]
        tail.insert(bisect_left(tail, key, key=lambda e: e.key), entry)
        self._restore(snapshot)
        return self._again(tail, entry, step - self.filter.history.step)

    def _again(self, tail: list[_Entry], entry: _Entry, steps: int) -> FixResult:
        revised: list[tuple[Fix, Outcome]] = []
        own: Outcome | None = None
        for e in tail:
            if isinstance(e.event, ImuSample):
                self.imu(e.event)
            elif isinstance(e.event, Fix):
                before = e.fused
                outcome = self._take_fix(e)
                if e is entry:
                    own = outcome
                elif outcome.fused != before:
                    revised.append((e.event, outcome))
            else:
                self.local(e.event)
        if own is None:
            raise RuntimeError('the fix is not among the inputs that were processed again')
        return FixResult(own, steps, tuple(revised))

    def _take_fix(self, entry: _Entry) -> Outcome:
        if not isinstance(entry.event, Fix):
            raise TypeError('not a fix')
        self._fuse_at(entry.event, self._present(), entry.event.validity_ns)
        outcome = self.filter.fuse(3, self._noise_fix)
        entry.fused = outcome.fused
        self._log.append(entry)
        return outcome

    def _store(self, key: OrderKey) -> None:
        noise = copy.copy(self._noise_fix), copy.copy(self._noise_dvl)
        self._snapshots.append(_Snapshot(key, self.filter.snapshot(), noise))
        # In bulk: taking one from the front of a list moves all others.
        oldest = key[0] - self._length_ns
        if self._snapshots[0].key[0] < oldest - self._length_ns // 4:
            keep = bisect_left(self._snapshots, oldest, key=lambda s: s.key[0])
            del self._snapshots[:keep]
            del self._log[: bisect_right(self._log, self._snapshots[0].key, key=lambda e: e.key)]

    def _restore(self, snapshot: _Snapshot) -> None:
        self.filter.restore(snapshot.state)
        self._noise_fix, self._noise_dvl = (copy.copy(n) for n in snapshot.noise)
