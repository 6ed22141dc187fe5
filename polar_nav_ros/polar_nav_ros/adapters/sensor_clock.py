"""Time of a sensor's own clock on the clock of the host, by when its messages arrive.

A message arrives after it was stamped, later by a transport that is quick now and then. So the
lower envelope of arrival less stamp is offset plus drift of the clock, but for the least delay,
which nobody can tell from it (`time_offset_s` states that). The envelope is the straight line
below all points of the last minutes that is highest at the present. A step of the clock leaves
it: after a few messages that agree the fit begins anew. Nothing else is known of the host than
arrivals, and nothing of other sensors, so one clock's step never moves another's stamps.
"""

from __future__ import annotations

from dataclasses import dataclass

_BIN_NS = 1_000_000_000
_BINS = 300
"""Seconds of arrival that the envelope is of, one lowest point each."""
_LEAST_SPAN_NS = 30_000_000_000
"""Below it drift is not told from a delay that changes: the line is level."""
_MOST_DRIFT = 500e-6
"""Of any quartz."""
_STEP_NS = 500_000_000
"""An offset that changes by more was not the transport's."""
_AGREE = 5
"""Messages in a row that show a step."""


@dataclass
class SensorClock:
    """Map from stamps of one sensor to the host's time.

    Attributes
    ----------
    steps : int
        Times that the clock stepped.
    drift : float
        Rate of the host's clock less the sensor's [s/s], of the present fit.
    """

    steps: int = 0
    drift: float = 0.0

    def __post_init__(self) -> None:
        self._points: list[tuple[int, int]] = []
        self._off = 0
        self._hull: list[tuple[int, int]] = []
        self._last_ns = 0

    def host_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """Host's time [ns] of a stamp, after a message with it arrived.

        Parameters
        ----------
        stamp_ns : int
            By the sensor's clock [ns].
        arrival_ns : int
            By the host's clock [ns].
        """
        delay_ns = arrival_ns - stamp_ns
        if self._points:
            behind_ns = delay_ns - self._envelope_ns(stamp_ns)
            if abs(behind_ns) > _STEP_NS:
                self._off += 1
                if self._off < _AGREE:
                    return self._place(stamp_ns + self._envelope_ns(stamp_ns), arrival_ns)
                self.steps += 1
                self._points.clear()
        self._off = 0
        self._note(stamp_ns, delay_ns)
        return self._place(stamp_ns + self._envelope_ns(stamp_ns), arrival_ns)

    def _place(self, host_ns: int, arrival_ns: int) -> int:
        """No message is of a time after its arrival."""
        return min(host_ns, arrival_ns)

    def _note(self, stamp_ns: int, delay_ns: int) -> None:
        last = self._points[-1] if self._points else None
        if last is not None and stamp_ns // _BIN_NS == last[0] // _BIN_NS:
            if delay_ns >= last[1]:
                return
            self._points[-1] = (stamp_ns, delay_ns)
        else:
            self._points.append((stamp_ns, delay_ns))
            del self._points[:-_BINS]
        self._fit()

    def _fit(self) -> None:
        """Lower hull of the points; the drift is that of its edge under the middle of them."""
        hull: list[tuple[int, int]] = []
        for point in self._points:
            while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        self._hull = hull
        self.drift = 0.0
        if hull[-1][0] - hull[0][0] < _LEAST_SPAN_NS:
            return
        middle_ns = (hull[0][0] + hull[-1][0]) // 2
        k = next(i for i in range(1, len(hull)) if hull[i][0] >= middle_ns)
        (t0, d0), (t1, d1) = hull[k - 1], hull[k]
        self.drift = max(-_MOST_DRIFT, min(_MOST_DRIFT, (d1 - d0) / (t1 - t0)))

    def _envelope_ns(self, stamp_ns: int) -> int:
        """Offset at a stamp: the line of the drift under all points."""
        return min(d + round(self.drift * (stamp_ns - t)) for t, d in self._hull)


def _turns_down(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Whether b lies on or above the line from a to c; in whole numbers."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
