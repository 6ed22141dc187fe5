"""Schedules of slow sensors, by the truth's sample numbers and never by a clock."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from .trajectory import NS

T = TypeVar('T')


class Schedule:
    """Every ``period_s`` since the start of the mission, at the first truth sample at or after it.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    """

    def __init__(self, rate_hz: float) -> None:
        self.period_s = 1.0 / rate_hz
        self._period_ns = round(NS / rate_hz)
        self._last = -1

    def due(self, since_start_ns: int) -> int | None:
        """Return the number of the sample due at a time since the start [ns], or None."""
        k = since_start_ns // self._period_ns
        if k <= self._last:
            return None
        self._last = k
        return k


class Late(Generic[T]):
    """Queue of measurements that are sent with a latency.

    Parameters
    ----------
    latency_s : float
        Time from measurement to sending [s].
    """

    def __init__(self, latency_s: float) -> None:
        self.latency_ns = round(latency_s * NS)
        self._waiting: deque[tuple[int, T]] = deque()

    def put(self, now_ns: int, item: T) -> None:
        """Store an item until its latency is over."""
        self._waiting.append((now_ns + self.latency_ns, item))

    def due(self, now_ns: int) -> list[T]:
        """Return the items whose latency is over, in order."""
        out = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            out.append(self._waiting.popleft()[1])
        return out
