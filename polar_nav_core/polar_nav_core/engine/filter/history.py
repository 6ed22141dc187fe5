"""The filter's past: where it was at each IMU epoch, how errors moved, and what was fed back.

All three are rings that hold a stated time. Late fixes are compared with the position stored
before their time of validity plus velocity times the rest; no step is ever split at a time of
validity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...kernels.filter import N
from ..events import Array


@dataclass(frozen=True)
class Epoch:
    """A stored IMU epoch.

    Attributes
    ----------
    number : int
        Counts epochs from the start of the filter.
    stamp_ns : int
    point_e, velocity_e : (3,) arrays
        Transponder position and velocity as estimated then, ECEF.
    lever_G : (3,) array
        Transponder from base_link, grid axes.
    step : int
        Number of the last covariance step at that time.
    correction : int
        Number of the first correction that came after it.
    """

    number: int
    stamp_ns: int
    point_e: Array
    velocity_e: Array
    lever_G: Array
    step: int
    correction: int


class History:
    """Rings of epochs, transitions and corrections.

    Parameters
    ----------
    length_s : float
        Time that is kept.
    imu_period_s, step_s : float
        Shortest expected time between IMU samples and between covariance steps.
    corrections_per_s : float
        Most corrections a second; with more of them the history just reaches less far back.
    """

    def __init__(
        self, length_s: float, imu_period_s: float, step_s: float, corrections_per_s: float
    ) -> None:
        epochs = int(length_s / imu_period_s) + 2
        self._stamps = np.zeros(epochs, dtype=np.int64)
        self._points = np.zeros((epochs, 3))
        self._velocities = np.zeros((epochs, 3))
        self._levers = np.zeros((epochs, 3))
        self._steps = np.zeros(epochs, dtype=np.int64)
        self._firsts = np.zeros(epochs, dtype=np.int64)
        self.transitions = np.zeros((int(length_s / step_s) + 2, N, N))
        self.corrections = np.zeros((int(length_s * corrections_per_s) + 16, N))
        self.correction_steps: NDArray[np.int64] = np.zeros(len(self.corrections), dtype=np.int64)
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.count = 0
        self.step = 0
        self.correction = 0

    def add_epoch(self, stamp_ns: int, point_e: Array, velocity_e: Array, lever_G: Array) -> None:
        """Store an IMU epoch.

        Call after a covariance step that ends at it, before measurements of that stamp.
        """
        i = self.count % len(self._stamps)
        self._stamps[i] = stamp_ns
        self._points[i] = point_e
        self._velocities[i] = velocity_e
        self._levers[i] = lever_G
        self._steps[i] = self.step
        self._firsts[i] = self.correction
        self.count += 1

    def next_transition(self) -> Array:
        """Slot for the transition of the next covariance step, which becomes the newest."""
        self.step += 1
        slot: Array = self.transitions[self.step % len(self.transitions)]
        return slot

    def add_correction(self, x: Array) -> None:
        """Store what was just taken out of the state."""
        i = self.correction % len(self.corrections)
        self.corrections[i] = x
        self.correction_steps[i] = self.step
        self.correction += 1

    def newest(self) -> Epoch:
        """Return the last stored epoch."""
        return self._epoch(self.count - 1)

    def before(self, stamp_ns: int) -> Epoch | None:
        """Last epoch at or before a stamp; None when the history does not reach back that far."""
        low = max(0, self.count - len(self._stamps))
        high = self.count - 1
        if high < low or self._stamp(low) > stamp_ns:
            return None
        while low < high:
            middle = (low + high + 1) // 2
            if self._stamp(middle) <= stamp_ns:
                low = middle
            else:
                high = middle - 1
        epoch = self._epoch(low)
        if self.step - epoch.step >= len(
            self.transitions
        ) or self.correction - epoch.correction > len(self.corrections):
            return None
        return epoch

    def shift(self, first: int, until: int, change: Array, C_e_G: Array) -> None:
        """Move what is stored of epochs first..until-1 by a change of the estimate.

        Parameters
        ----------
        first, until : int
            Numbers of epochs; what is no longer stored is passed over.
        change : (24,) array
            New estimate minus old, as an error state.
        C_e_G : (3, 3) array
            Grid axes now; over the length of the history they hardly turn.
        """
        first = max(first, self.count - len(self._stamps))
        if until <= first:
            return
        i = np.arange(first, until) % len(self._stamps)
        turned_G = np.cross(self._levers[i], change[0:3])
        self._points[i] += change[6:9] + np.einsum('ji,nj->ni', C_e_G, turned_G)
        self._velocities[i] += np.einsum('ji,j->i', C_e_G, change[3:6])

    def oldest_ns(self) -> int:
        """Stamp of the oldest stored epoch; 0 when there is none."""
        return self._stamp(max(0, self.count - len(self._stamps))) if self.count else 0

    def _stamp(self, number: int) -> int:
        return int(self._stamps[number % len(self._stamps)])

    def _epoch(self, number: int) -> Epoch:
        i = number % len(self._stamps)
        return Epoch(
            number=number,
            stamp_ns=int(self._stamps[i]),
            point_e=self._points[i],
            velocity_e=self._velocities[i],
            lever_G=self._levers[i],
            step=int(self._steps[i]),
            correction=int(self._firsts[i]),
        )
