"""Stored past of the filter: position at each IMU epoch, transitions, corrections fed back.

All three are rings that hold a stated time. Late fixes are compared with the position stored
before their time of validity plus velocity times the rest; no step is ever split at a time of
validity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...arrays import Array, Ints
from ...kernels.sins import state as fs
from ...kernels.sins.late import newest_until
from ...kernels.sins.measured import epoch_place
from ...kernels.sins.rings import Past
from ...kernels.sins.transition import INVERSE
from ...kernels.sins.update import N
from ..results import CORRECTIONS_PER_S, IMU_PERIOD_S

_PRESENT_S = 2.0
"""Epochs that a filter keeps whose fixes come when they are valid."""


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
    usbl_bias_a : (3,) array
        Last three states as estimated then.
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
    usbl_bias_a: Array
    step: int
    correction: int


class Since(NamedTuple):
    """Stored epochs of some time until now, and the corrections since the first of them.

    Attributes
    ----------
    stamps_ns : (n,) array
    velocities_G : (n, 3) array
        As estimated then [m/s].
    firsts : (n,) array
        Number of the first correction after each epoch.
    corrections : (m, 24) array
        The first of them is number ``firsts[0]``.
    """

    stamps_ns: Ints
    velocities_G: Array
    firsts: Ints
    corrections: Array


def make_past(length_s: float, step_s: float, *, model: bool = False, late: bool = True) -> Past:
    """Rings of epochs, transitions and corrections that last ``length_s`` seconds.

    A vehicle's model corrects at each step. Where no fix comes late, few epochs are enough.
    """
    epochs = int((length_s if late else _PRESENT_S) / IMU_PERIOD_S) + 2
    rate = CORRECTIONS_PER_S + (1.0 / step_s if model else 0.0)
    corrections = int(length_s * rate) + 16
    steps = int(length_s / step_s) + 2
    return Past(
        stamps=np.zeros(epochs, dtype=np.int64),
        positions=np.zeros((epochs, 3)),
        velocities=np.zeros((epochs, 3)),
        levers=np.zeros((epochs, 3)),
        usbl_biases=np.zeros((epochs, 3)),
        steps=np.zeros(epochs, dtype=np.int64),
        firsts=np.zeros(epochs, dtype=np.int64),
        transitions=np.zeros((steps, N, N)),
        inverses=np.zeros((steps if late else 1, *INVERSE)),
        corrections=np.zeros((corrections, N)),
        correction_steps=np.zeros(corrections, dtype=np.int64),
    )


class History:
    """Look-up in the rings that the compiled filter fills.

    Parameters
    ----------
    past : Past
        The rings.
    state : State
        Its counters hold how much of them is filled.
    """

    def __init__(self, past: Past, state: fs.State) -> None:
        self._past = past
        self._counters = state.counters
        self._C_e_G = np.zeros((3, 3))
        self.transitions = past.transitions
        self.corrections = past.corrections
        self.correction_steps = past.correction_steps

    @property
    def count(self) -> int:
        """Number of epochs so far."""
        return int(self._counters[fs.EPOCHS])

    @property
    def step(self) -> int:
        """Number of covariance steps so far."""
        return int(self._counters[fs.STEPS])

    @property
    def correction(self) -> int:
        """Number of corrections so far."""
        return int(self._counters[fs.CORRECTIONS])

    def newest(self) -> Epoch:
        """Newest stored epoch."""
        return self._epoch(self.count - 1)

    def before(self, stamp_ns: int) -> Epoch | None:
        """Newest epoch at or before a stamp [ns]; None if none is stored."""
        number = int(newest_until(self._past.stamps, self.count, stamp_ns))
        return self._epoch(number) if number >= 0 and self._usable(number) else None

    def velocities_since(self, stamp_ns: int) -> tuple[Ints, Array]:
        """Stamps (n,) [ns] and velocities (n, 3), grid axes [m/s], from an epoch on.

        It is the newest one at or before `stamp_ns`; empty if none is stored.
        """
        first = int(newest_until(self._past.stamps, self.count, stamp_ns))
        rows = self._rows(self.count if first < 0 else first)
        return self._past.stamps[rows], self._past.velocities[rows]

    def since(self, stamp_ns: int) -> Since | None:
        """Epochs and corrections from the newest epoch at a stamp [ns] on; None if not stored."""
        number = int(newest_until(self._past.stamps, self.count, stamp_ns))
        if number < 0 or not self._usable(number):
            return None
        rows = self._rows(number)
        firsts = self._past.firsts[rows]
        corrected = np.arange(firsts[0], self.correction) % len(self.corrections)
        return Since(
            self._past.stamps[rows],
            self._past.velocities[rows],
            firsts,
            self.corrections[corrected],
        )

    def reaches_ns(self) -> int:
        """Stamp [ns] from which on a fix can be referred to an epoch; 0 without one.

        What is short of room first, epochs, transitions or corrections, decides, or a turn before
        which the track was another one.
        """
        if not self.count:
            return 0
        low, high = max(0, self.count - len(self._past.stamps)), self.count - 1
        while low < high:
            middle = (low + high) // 2
            if self._usable(middle):
                high = middle
            else:
                low = middle + 1
        return max(self._stamp(low), int(self._counters[fs.FROM_NS]))

    def _rows(self, number: int) -> Ints:
        """Places of the epochs from a number on."""
        return np.arange(number, self.count) % len(self._past.stamps)

    def _usable(self, number: int) -> bool:
        """Whether all transitions and corrections since an epoch are still stored."""
        i = number % len(self._past.stamps)
        steps, corrections = self._past.steps[i], self._past.firsts[i]
        return bool(
            self.step - steps < len(self.transitions)
            and self.correction - corrections <= len(self.corrections)
        )

    def _stamp(self, number: int) -> int:
        return int(self._past.stamps[number % len(self._past.stamps)])

    def _epoch(self, number: int) -> Epoch:
        past = self._past
        i = number % len(past.stamps)
        point_e, velocity_e = np.empty(3), np.empty(3)
        epoch_place(past, i, point_e, velocity_e, self._C_e_G)
        return Epoch(
            number=number,
            stamp_ns=int(past.stamps[i]),
            point_e=point_e,
            velocity_e=velocity_e,
            lever_G=past.levers[i],
            usbl_bias_a=past.usbl_biases[i],
            step=int(past.steps[i]),
            correction=int(past.firsts[i]),
        )
