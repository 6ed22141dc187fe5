"""When a slow sensor is due, told by the truth's own sample numbers and never by a clock."""

from __future__ import annotations

from .trajectory import NS


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
        """Return the number of the sample that is due at a time since the start [ns], or None."""
        k = since_start_ns // self._period_ns
        if k <= self._last:
            return None
        self._last = k
        return k
