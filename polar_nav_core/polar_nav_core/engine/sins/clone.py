"""`clone`: late fixes exactly, on the linearization that was stored when the inputs came.

A single late fix is carried as a clone of the past position through the stored steps and
measurements (a fixed-point smoother), at a fraction of the cost of going back. When another late
fix was fused inside those steps, a pass that forgets their correlation would be wrong by
kilometres within minutes; then all of them are put where they belong and the stored linear steps
are filtered again. Both give what a filter with explicitly augmented states gives. Gates and
linearization stay as they were decided.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...kernels.sins import smooth as sm
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.update import Ints
from ..events import Fix, InitialState, Rank
from ..params import EngineParams
from ..results import FixResult, Outcome
from .filter import NavigationFilter
from .fusion import Fusion
from .history import Epoch


@dataclass(frozen=True)
class _Late:
    """A late fix that was fused as a clone: where it belongs, and the correction it is in."""

    receive_ns: int
    validity_ns: int
    epochs: int
    number: int


class Clone(Fusion):
    """Late fixes by smoothing over stored linear steps.

    Parameters
    ----------
    params, initial, stamp_ns
        As for :class:`Fusion`.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        # Fixes that stand in the log where they were fused, not where they belong, by correction.
        self._late: dict[int, _Late] = {}
        self._C, self._P_cc = np.zeros((kf.N, 3)), np.zeros((3, 3))
        self._P = np.zeros((kf.N, kf.N))
        self._work9, self._work6 = np.zeros((kf.NAV, 3)), np.zeros((6, 3))
        self._change, self._work24 = np.zeros(kf.N), np.zeros(kf.N)

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Return a filter that logs its linear steps."""
        return NavigationFilter(params, initial, stamp_ns, steps=True)

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix; as a clone when no other late fix lies between, else by filtering again."""
        f = self.filter
        epoch = f.history.before(fix.validity_ns)
        oldest = self._oldest()
        place = self._place(fix.validity_ns, oldest)
        base = self._step_before(place, oldest)
        if epoch is None or base is None:
            return None
        steps = f.history.step - epoch.step
        self._fuse_at(fix, epoch, fix.validity_ns)
        sm.refer_to_place(f.z, f.H, f.log, epoch.number, place, oldest)
        inside = self._late_inside(place)
        if not inside:
            return FixResult(self._smooth(fix, epoch, base, place), steps)
        outcome = self._filter_again(fix, epoch, place, oldest)
        return None if outcome is None else FixResult(outcome, steps)

    # -- a single late fix ------------------------------------------------------------------------

    def _smooth(self, fix: Fix, epoch: Epoch, base: int, place: int) -> Outcome:
        f = self.filter
        w, log = f.work, f.log
        z = w.z.copy()
        sm.smooth(
            f.past,
            log,
            base,
            place,
            w.H,
            z,
            self._C,
            self._P_cc,
            self._P,
            self._work9,
            self._work6,
        )
        number, late_z = f.history.correction, w.z.copy()
        w.z[:] = z
        code = sm.fuse_clone(
            f.state, f.frames, f.settings, f.past, w, log, self._C, self._P_cc, z, late_z
        )
        f.check(code)
        w.z[:] = z
        outcome = f.outcome(3, fused=code == fs.FUSED)
        if outcome.fused:
            i = int(log.counts[0]) % len(log.kinds)
            log.kinds[i], log.numbers[i], log.rows[i] = fs.UPDATE, number, 3
            log.stamps[i], log.ranks[i] = fix.receive_ns, Rank.FIX
            log.epochs[i] = f.history.count
            log.counts[0] += 1
            self._late[number] = _Late(fix.receive_ns, fix.validity_ns, epoch.number + 1, number)
            self._forget_late()
        return outcome

    # -- several late fixes -----------------------------------------------------------------------

    def _filter_again(self, fix: Fix, epoch: Epoch, place: int, oldest: int) -> Outcome | None:
        f = self.filter
        w, log = f.work, f.log
        start = self._first_affected(place, oldest)
        base = self._step_before(start, oldest)
        if base is None:
            return None
        number = f.history.correction
        u = number % len(log.H)
        log.H[u], log.R[u], log.z[u] = w.H, w.R, w.z
        new = _Late(fix.receive_ns, fix.validity_ns, epoch.number + 1, number)
        moved = self._late_inside(start)
        entries = self._entries(start)
        order, removed = _reordered(entries, moved, new)
        removed_x = np.array([log.x[n % len(log.x)] for n in removed])
        sm.covariance_at(self._P, log, base, start)
        outcome = np.zeros(9)
        code = sm.filter_again(
            f.state,
            f.frames,
            f.settings,
            f.past,
            w,
            log,
            order.kinds,
            order.numbers,
            order.epochs,
            order.rows,
            removed_x,
            int(log.epochs[(start - 1) % len(log.kinds)]),
            self._P,
            self._change,
            self._work24,
            outcome,
        )
        f.check(code)
        self._write(start, order, fused=code == fs.FUSED)
        for late in moved:
            del self._late[late.number]
        gate = float(f.settings.gates[3])
        return Outcome(
            code == fs.FUSED,
            outcome[2:5].copy(),
            outcome[5:8].copy(),
            float(outcome[1]),
            3,
            gate,
            float(outcome[8]),
        )

    def _first_affected(self, place: int, oldest: int) -> int:
        """Where filtering again must begin: before every fix fused inside what is repeated."""
        while True:
            inside = [self._place(late.validity_ns, oldest) for late in self._late_inside(place)]
            first = min([place, *inside])
            if first == place:
                return place
            place = first

    # -- the order of entries ---------------------------------------------------------------------

    def _oldest(self) -> int:
        """Oldest entry of the log whose matrices are all still stored."""
        f, log = self.filter, self.filter.log
        count = int(log.counts[0])
        oldest = max(0, count - len(log.kinds))
        first_step = f.history.step - len(log.step_P) + 1
        first_update = f.history.correction - len(log.H) + 1
        if first_step <= 0 and first_update <= 0:
            return oldest
        i = np.arange(oldest, count) % len(log.kinds)
        step = log.kinds[i] == fs.STEP
        stored = np.where(step, log.numbers[i] >= first_step, log.numbers[i] >= first_update)
        gone = np.flatnonzero(~stored)
        return oldest + (int(gone[-1]) + 1 if len(gone) else 0)

    def _place(self, validity_ns: int, oldest: int) -> int:
        """First entry that a fix valid then stands before."""
        log = self.filter.log
        low, high = oldest, int(log.counts[0])
        while low < high:
            middle = (low + high) // 2
            i = middle % len(log.kinds)
            if (int(log.stamps[i]), int(log.ranks[i])) <= (validity_ns, int(Rank.FIX)):
                low = middle + 1
            else:
                high = middle
        return low

    def _step_before(self, place: int, oldest: int) -> int | None:
        """Last covariance step among the entries before ``place``."""
        log = self.filter.log
        for entry in range(place - 1, oldest - 1, -1):
            if log.kinds[entry % len(log.kinds)] == fs.STEP:
                return entry
        return None

    def _late_inside(self, place: int) -> list[_Late]:
        """Late fixes that stand at or after ``place``, where they were fused."""
        log = self.filter.log
        if not self._late or place == log.counts[0]:
            return []
        i = place % len(log.kinds)
        key = (int(log.stamps[i]), int(log.ranks[i]))  # entries stand in the order of these
        return [late for late in self._late.values() if (late.receive_ns, Rank.FIX) >= key]

    def _entries(self, start: int) -> _Order:
        log = self.filter.log
        i = np.arange(start, int(log.counts[0])) % len(log.kinds)
        return _Order(
            log.kinds[i], log.numbers[i], log.stamps[i], log.ranks[i], log.epochs[i], log.rows[i]
        )

    def _write(self, start: int, order: _Order, *, fused: bool) -> None:
        """Put the entries back, without what was removed or refused."""
        log = self.filter.log
        dropped = {fs.REMOVED} if fused else {fs.REMOVED, sm.NEW}
        keep = np.array([k not in dropped for k in order.kinds.tolist()])
        kinds = np.where(order.kinds == fs.STEP, fs.STEP, fs.UPDATE)
        i = np.arange(start, start + int(np.sum(keep))) % len(log.kinds)
        log.kinds[i] = kinds[keep]
        log.numbers[i], log.stamps[i] = order.numbers[keep], order.stamps[keep]
        log.ranks[i], log.epochs[i] = order.ranks[keep], order.epochs[keep]
        log.rows[i] = order.rows[keep]
        log.counts[0] = start + int(np.sum(keep))

    def _forget_late(self) -> None:
        """Drop what is no longer stored."""
        oldest = self.filter.history.correction - len(self.filter.log.H)
        for number in [n for n in self._late if n <= oldest]:
            del self._late[number]


@dataclass(frozen=True)
class _Order:
    """Entries of the log, one array per column."""

    kinds: Ints
    numbers: Ints
    stamps: Ints
    ranks: Ints
    epochs: Ints
    rows: Ints


def _reordered(entries: _Order, moved: list[_Late], new: _Late) -> tuple[_Order, list[int]]:
    """Entries with late fixes in their places; also the numbers of those that were moved there.

    Where a late fix stood, an entry stays that takes out what it had done to the estimate.
    """
    removed = [late.number for late in moved]
    kinds, numbers = entries.kinds.copy(), entries.numbers.copy()
    for row, number in enumerate(removed):
        i = np.flatnonzero((entries.kinds == fs.UPDATE) & (entries.numbers == number))[0]
        kinds[i], numbers[i] = fs.REMOVED, row
    # Stable: a fix goes after all that has the same stamp, and after fixes that came before it.
    late = sorted([*moved, new], key=lambda one: (one.validity_ns, one.number))
    zero_ns = min(int(entries.stamps[0]), late[0].validity_ns)
    key = (entries.stamps - zero_ns) * 8 + entries.ranks
    wanted = [(one.validity_ns - zero_ns) * 8 + int(Rank.FIX) for one in late]
    places = np.searchsorted(key, wanted, side='right')
    late_kinds = [sm.NEW if one is new else sm.PLACED for one in late]
    return _Order(
        np.insert(kinds, places, late_kinds),
        np.insert(numbers, places, [one.number for one in late]),
        np.insert(entries.stamps, places, [one.validity_ns for one in late]),
        np.insert(entries.ranks, places, int(Rank.FIX)),
        np.insert(entries.epochs, places, [one.epochs for one in late]),
        np.insert(entries.rows, places, 3),
    ), removed
