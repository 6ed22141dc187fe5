"""Clock of a vehicle: stamps with an unknown offset and drift."""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_core.params import param

from ..section import Spec
from ..trajectory import NS


@dataclass(frozen=True)
class ClockErrors(Spec):
    """Errors of a clock; none by default."""

    clock_offset_s: float = param(
        0.0, 's', -60.0, 60.0, 'Stamps are later than the truth by this at the start'
    )
    clock_drift_ppm: float = param(
        0.0, '1e-6', -1000.0, 1000.0, 'And by so many microseconds more every second'
    )

    def reads_ns(self, stamp_ns: int, since_start_ns: int) -> int:
        """Return the clock's reading [ns] at a true stamp [ns], a time after the start [ns]."""
        late_ns = self.clock_offset_s * NS + self.clock_drift_ppm * 1e-6 * since_start_ns
        return stamp_ns + round(late_ns)
