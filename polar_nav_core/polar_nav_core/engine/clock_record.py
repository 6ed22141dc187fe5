"""Record of the clocks that stepped: conditions of health, and the way back to the IMU's clock."""

from __future__ import annotations

from .events import ClockStep
from .health.conditions import Condition, Culprit, Level

_AFTER_NS = 60_000_000_000
"""A step stays a condition for so long."""
_MOST = 1024


class ClockRecord:
    """Steps of the clocks of a vehicle's topics.

    Parameters
    ----------
    imu : str
        Topic of the IMU, whose clock is that of the vehicle.
    """

    def __init__(self, imu: str) -> None:
        self._imu = imu
        self._steps: list[ClockStep] = []
        self.count = 0

    def note(self, step: ClockStep) -> None:
        """Note a step."""
        self.count += 1
        self._steps.append(step)
        if len(self._steps) > _MOST:
            del self._steps[0]

    @property
    def offsets_s(self) -> dict[str, float]:
        """Stamp less engine time by topic [s], of topics whose clock ever stepped."""
        return {step.topic: -step.offset_ns * 1e-9 for step in self._steps}

    def offset_ns(self, topic: str, number: int) -> int:
        """Engine time less stamp of a message, by its number on its topic [ns]."""
        for step in reversed(self._steps):
            if step.topic == topic and step.number <= number:
                return step.offset_ns
        return 0

    def own_ns(self, stamp_ns: int) -> int:
        """Stamp by the IMU's clock of an engine time; both in ns."""
        for step in reversed(self._steps):
            if step.topic == self._imu and step.stamp_ns <= stamp_ns:
                return stamp_ns - step.offset_ns
        return stamp_ns

    def nearest_offset_ns(self, own_ns: int, now_ns: int | None) -> int:
        """Engine time less stamp [ns] of a message by the IMU's clock, before or after its steps.

        ``now_ns`` is the engine's time at which it came; None where there is none yet.
        """
        if now_ns is None:
            return 0
        offsets_ns = [0, *(step.offset_ns for step in self._steps if step.topic == self._imu)]
        return min(reversed(offsets_ns), key=lambda offset_ns: abs(own_ns + offset_ns - now_ns))

    def conditions(self, stamp_ns: int) -> list[Condition]:
        """One condition for each topic whose clock stepped in the last minute before a stamp."""
        found: dict[str, Condition] = {}
        for step in self._steps:
            since_ns = stamp_ns - step.stamp_ns
            if 0 <= since_ns < _AFTER_NS:
                culprit = Culprit.IMU if step.topic == self._imu else Culprit.NONE
                sentence = (
                    f'the clock of {step.topic} stepped by {step.step_ns * 1e-9:+.3f} s '
                    f'{since_ns * 1e-9:.0f} s ago: its stamps go on with an offset'
                )
                key = f'clock {step.topic}'
                found[key] = Condition(key, Level.WARN, culprit, sentence)
        return list(found.values())
