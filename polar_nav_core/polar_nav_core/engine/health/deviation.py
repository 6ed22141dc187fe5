"""A compass with a deviation, found by the rates of its own AHRS.

Iron in the vehicle turns a compass by A sin(psi) + B cos(psi) of the heading psi. Gyros do not
feel it: a turn of the heading that the rates do not explain follows the heading. Within the memory
of that turn (kernels.station.attitude) a bias of the gyro is a constant and its scale a share of
the turn; both are fitted beside A and B, once a second.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...kernels.station.attitude import MEMORY_S
from ...kernels.station.gap import LEAST_TURN
from .conditions import Condition, Culprit, Level

_BEYOND = 30.0
"""Twice the logarithm of how rarely chance alone makes such A and B, as of a chi-square (2)."""
_MATTERS = 3.0
"""Published sigmas of the heading beyond which they matter: what is covered lies inside."""
_ALIKE_S = 2.0 * MEMORY_S
"""Turns so far apart are independent: twice the correlation time."""
_LONGEST_S = 5.0
"""After a longer pause the memory begins anew."""
_FORGET_S = 1200.0
"""A deviation may change, when something is taken on board [s]."""


class Deviation:
    """Fit of a deviation to unexplained turns, a second apart or so."""

    def __init__(self) -> None:
        self._normal = np.zeros((4, 4))
        self._mixed = np.zeros(4)
        self._square = 0.0
        self._weight = 0.0
        self._remembered = np.zeros(3)  # of sin psi, cos psi and psi, as the turn is
        self._psi = 0.0
        self._stamp_ns = 0
        self._began_ns = 0

    def look(self, stamp_ns: int, psi: float, turn: float, sigma: float) -> list[Condition]:
        """Take a heading with its unexplained turn; the condition of a deviation, if there is one.

        Parameters
        ----------
        stamp_ns : int
        psi, turn : float
            Of the AHRS [rad].
        sigma : float
            Published 1-sigma of the heading [rad].
        """
        dt = (stamp_ns - self._stamp_ns) * 1e-9
        known = 0.0 < dt <= _LONGEST_S
        if dt <= 0.0 and self._stamp_ns:
            return self._condition(sigma)
        turned = math.remainder(psi - self._psi, 2.0 * math.pi)
        change = np.array(
            [math.sin(psi) - math.sin(self._psi), math.cos(psi) - math.cos(self._psi), turned]
        )
        # What came within the interval has faded by half of it.
        fade = math.exp(-0.5 * dt / MEMORY_S) if known else 0.0
        self._remembered = fade * (fade * self._remembered + change) if known else np.zeros(3)
        self._psi, self._stamp_ns = psi, stamp_ns
        if not known or abs(turn) > LEAST_TURN:  # a jump is another condition
            self._began_ns = stamp_ns
        if stamp_ns - self._began_ns >= 3e9 * MEMORY_S:
            self._take(np.array([*self._remembered, 1.0]), turn, dt)
        return self._condition(sigma)

    def _take(self, row: Array, turn: float, dt: float) -> None:
        keep = math.exp(-dt / _FORGET_S)
        self._normal = keep * self._normal + dt * np.outer(row, row)
        self._mixed = keep * self._mixed + dt * turn * row
        self._square = keep * self._square + dt * turn * turn
        self._weight = keep * self._weight + dt

    def _condition(self, sigma: float) -> list[Condition]:
        free = self._weight / _ALIKE_S - len(self._mixed)
        if free <= 0.0 or np.linalg.cond(self._normal) > 1e8:
            return []
        fit = np.linalg.solve(self._normal, self._mixed)
        rest = max(self._square - float(fit @ self._mixed), 0.0)  # of `free` independent turns
        alone = float(fit[:2] @ np.linalg.solve(np.linalg.inv(self._normal)[:2, :2], fit[:2]))
        # Their ratio is one of Fisher's with 2 and `free` degrees of freedom, whose tail is
        # (1 + alone / rest)^(-free / 2): with few turns the noise is hardly known.
        size = float(np.hypot(*fit[:2]))
        if not (
            rest > 0.0 and size > _MATTERS * sigma and free * math.log1p(alone / rest) > _BEYOND
        ):
            return []
        sentence = (
            f'the heading of the AHRS has a deviation of {math.degrees(size):.1f} deg, which its '
            'own rates do not have: iron in the vehicle'
        )
        return [Condition('AHRS deviation', Level.WARN, Culprit.HEADING, sentence)]
