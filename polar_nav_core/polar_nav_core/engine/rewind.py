"""Rewind for a late fix, in either mode: stored fixes, choice of the snapshot, revisions.

A fix that comes late goes where it belongs: the filter goes back to a stored state before it and
processes everything that was received since again. The mode does the filtering (`Rewindable`);
the order of fixes, the choice of the snapshot and the revisions are here.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple, Protocol, TypeAlias

from ..arrays import Array
from ..kernels.sins.update import Ints
from .events import Fix, Rank
from .results import FixResult, Outcome

_Key: TypeAlias = tuple[int, int, int]
"""Validity, number of the packet, number of arrival."""
_DECISION = 0
"""Column of outcomes."""


class Cursor(NamedTuple):
    """Progress of the filter in one stream of inputs.

    Attributes
    ----------
    counter : int
        Index of the counter of inputs processed.
    room : int
        How many of the newest inputs are stored.
    stamps : (n,) array or None
        Ring of their stamps [ns]; None for a stream whose inputs commute with a fix, so that a
        newer one does not make a fix late.
    rank : Rank
        Of the stream within a stamp.
    """

    counter: int
    room: int
    stamps: Ints | None
    rank: Rank


class Stored(NamedTuple):
    """The stored past of a filter.

    Attributes
    ----------
    counters : (c,) array
        Of the filter now.
    snapshots : int
        Taken so far.
    snapshot_counters : (s, c) array
        Ring: the counters in each snapshot.
    outcomes : (f, k) array
        Ring of fixes in the order of their validity; its first column is the decision.
    cursors : tuple of Cursor
        Of all streams.
    stamp, step, fix : int
        Indexes of counters: stamp of the newest IMU sample, steps, fixes.
    """

    counters: Ints
    snapshots: int
    snapshot_counters: Ints
    outcomes: Array
    cursors: tuple[Cursor, ...]
    stamp: int
    step: int
    fix: int


class Rewindable(Protocol):
    """Interface of a filter, of either mode, that can go back to a stored state."""

    def stored(self) -> Stored:
        """Stored past of the filter; the arrays are views of the filter's own."""

    def insert(self, fix: Fix, number: int) -> None:
        """Insert a fix at an index of the stored ones; those at and after it move up by one."""

    def process_again(self, fix: Fix, snapshot: int | None) -> None:
        """Process all inputs received before the fix again, then the fix; without output rows.

        From a snapshot on; None: from the state as it is.
        """

    def outcome_of(self, row: Array) -> Outcome:
        """Outcome of a fix from its row of `Stored.outcomes`."""


class GoingBack:
    """Stored fixes of one filter, in the order of validity, and the way back to one of them.

    Parameters
    ----------
    target : Rewindable
        The filter that goes back.
    length_s : float
        How long fixes are kept [s].
    """

    def __init__(self, target: Rewindable, length_s: float) -> None:
        self._target = target
        self._length_ns = round(length_s * 1e9)
        # Fixes of the stored past, in the order of their validity; the first has this number.
        self._fixes: list[Fix] = []
        self._keys: list[_Key] = []
        self._first = 0

    def oldest_ns(self) -> int:
        """Oldest validity stamp [ns] at which a fix can still be fused."""
        stored = self._target.stored()
        return _snapshot_stamp(stored, self._oldest_usable(stored)) if stored.snapshots else 0

    def fix(self, fix: Fix) -> FixResult | None:
        """Result of a fix fused at its validity; None if the stored past does not reach it."""
        target = self._target
        stored = target.stored()
        number = self._snapshot_before(stored, fix.validity_ns)
        if number is None:
            return None
        key = (fix.validity_ns, fix.order, fix.arrival)
        place = bisect_left(self._keys, key)
        late = self._comes_late(stored, key)
        target.insert(fix, self._first + place)
        self._fixes.insert(place, fix)
        self._keys.insert(place, key)
        before = self._outcomes(stored, place + 1)
        steps = 0
        if late:
            then = stored.snapshot_counters[number % len(stored.snapshot_counters)]
            steps = int(stored.counters[stored.step] - then[stored.step])
        target.process_again(fix, number if late else None)
        own, *after = self._outcomes(stored, place)
        # Of the fixes before it nothing changes.
        revised = tuple(
            (self._fixes[i], target.outcome_of(new))
            for i, (old, new) in enumerate(zip(before, after, strict=True), start=place + 1)
            if old[_DECISION] != new[_DECISION]
        )
        self._forget(fix.receive_ns - self._length_ns)
        return FixResult(target.outcome_of(own), steps, revised)

    def end_here(self) -> None:
        """Forget all fixes: from now on going back ends at the present."""
        self._keys.clear()
        self._fixes.clear()
        stored = self._target.stored()
        self._first = int(stored.counters[stored.fix])

    def _comes_late(self, stored: Stored, key: _Key) -> bool:
        """Whether the filter has processed anything that comes after this key."""
        mine = (key[0], int(Rank.FIX))
        if (int(stored.counters[stored.stamp]), int(Rank.IMU)) > mine:
            return True
        for counter, _, stamps, rank in stored.cursors:
            n = int(stored.counters[counter])
            if stamps is not None and n and (int(stamps[(n - 1) % len(stamps)]), rank) > mine:
                return True
        return bool(self._keys) and self._keys[-1] > key

    def _outcomes(self, stored: Stored, place: int) -> list[Array]:
        """Outcomes of the stored fixes from an index on, copied rows."""
        numbers = range(self._first + place, self._first + len(self._fixes))
        return [stored.outcomes[n % len(stored.outcomes)].copy() for n in numbers]

    def _oldest_usable(self, stored: Stored) -> int:
        """Number of the oldest snapshot since which all inputs are still stored."""
        ring = stored.snapshot_counters
        high = stored.snapshots - 1
        low = max(0, high + 1 - len(ring))
        processed = stored.counters.tolist()
        oldest = [(c.counter, processed[c.counter] - c.room) for c in stored.cursors]
        oldest.append((stored.fix, self._first))
        middle = low  # mostly there is room for all
        while low < high:
            counters = ring[middle % len(ring)].tolist()
            if all(counters[c] >= number for c, number in oldest):
                high = middle
            else:
                low = middle + 1
            middle = (low + high) // 2
        return low

    def _snapshot_before(self, stored: Stored, stamp_ns: int) -> int | None:
        """Number of the newest snapshot at or before a stamp [ns]; None if none is stored."""
        low = self._oldest_usable(stored)
        if _snapshot_stamp(stored, low) > stamp_ns:
            return None

        def stamp(number: int) -> int:
            return _snapshot_stamp(stored, number)

        return bisect_right(range(stored.snapshots), stamp_ns, lo=low, key=stamp) - 1

    def _forget(self, before_ns: int) -> None:
        """Drop fixes from before the stored past, in bulk: going back never reaches them."""
        if self._keys[0][0] < before_ns - self._length_ns:
            gone = bisect_left(self._keys, (before_ns, 0, 0))
            del self._keys[:gone], self._fixes[:gone]
            self._first += gone


def _snapshot_stamp(stored: Stored, number: int) -> int:
    ring = stored.snapshot_counters
    return int(ring[number % len(ring), stored.stamp])
