"""What arrival by a steady clock tells of stamps: nothing can arrive before it was stamped.

The least delay from stamp to arrival of the last minutes bounds what a stamp can be: a gap leaves
that bound, a clock that leaps ahead breaks it, and so a gap and a step are told apart.
"""

from __future__ import annotations

from collections import deque

_EVERY_NS = 1_000_000_000
_KEPT = 600
"""Seconds that the bound is of: longer than messages are late, too short for clocks to drift."""
_LEAST_SPAN_NS = 2_000_000_000
_REAL_TIME = (0.6, 1.6)
"""Seconds of stamps a second of arrival: outside of it, stamps are no real time (a simulation)."""


class Arrivals:
    """Bound of the stamps of one stream by the time of arrival; both in ns."""

    def __init__(self) -> None:
        # One second each: its first arrival and stamp, and its largest stamp less arrival.
        self._seconds: deque[tuple[int, int, int]] = deque(maxlen=_KEPT)
        self._newest: tuple[int, int] | None = None
        self._most_ns = 0

    def note(self, arrival_ns: int | None, stamp_ns: int) -> None:
        """Note a message; None for one whose arrival means nothing."""
        if arrival_ns is None:
            return
        self._newest = arrival_ns, stamp_ns
        ahead_ns = stamp_ns - arrival_ns
        if self._seconds and 0 <= arrival_ns - self._seconds[-1][0] < _EVERY_NS:
            first_ns, first_stamp_ns, most_ns = self._seconds[-1]
            self._seconds[-1] = first_ns, first_stamp_ns, max(most_ns, ahead_ns)
            self._most_ns = max(self._most_ns, ahead_ns)
        else:
            self._seconds.append((arrival_ns, stamp_ns, ahead_ns))
            self._most_ns = max(most_ns for _, _, most_ns in self._seconds)

    def newest_possible_ns(self, arrival_ns: int | None) -> int | None:
        """Newest stamp that a message arriving now can have; None where that is not known."""
        if arrival_ns is None or self._newest is None:
            return None
        first_ns, first_stamp_ns, _ = self._seconds[0]
        span_ns = self._newest[0] - first_ns
        if span_ns < _LEAST_SPAN_NS:
            return None
        pace = (self._newest[1] - first_stamp_ns) / span_ns
        if not _REAL_TIME[0] < pace < _REAL_TIME[1]:
            return None
        return arrival_ns + self._most_ns
