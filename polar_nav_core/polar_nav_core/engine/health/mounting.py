"""A DVL, or the IMU beside it, that has turned in its mount: its yaw is not what it was before.

A turned sensor is refused at first, until its gate opens again. From then on the filter knows no
better than that the yaw of the DVL is what it shows now: often within the stated sigma, so that
nothing seems wrong, and a heading that follows the IMU is off by what that has turned. What tells
the turn is the yaw that innovations showed before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...arrays import Array
from ...kernels.sins.consider import DVL_YAW
from .conditions import Condition, Culprit, Level
from .shared import KNOWN
from .slow import SEVERE

BEFORE_NS = 60_000_000_000
"""What was known so long before a gate opened has nothing of what it was refused for."""
_BEYOND = 28.0
"""Chi-square (1) that is a WARN."""
_LEAST_VARIANCE = 1e-4
"""Of a yaw, per stated one: J is that of a linear filter."""


class _Yaw(NamedTuple):
    """Yaw of the DVL that innovations alone show, and its variance, per stated sigma."""

    stamp_ns: int
    value: float
    variance: float


class Mounting:
    """Memory of the yaw between DVL and IMU; `look` compares it with that of now."""

    def __init__(self) -> None:
        self._opened_ns = 0
        self._samples: list[_Yaw] = []
        self._before: _Yaw | None = None

    def look(self, stamp_ns: int, opened_ns: int, shared: Array | None) -> list[Condition]:
        """The condition that the yaw has changed since before the DVL's gate opened, if it has.

        Parameters
        ----------
        stamp_ns, opened_ns : int
            Of the look; when the gate of the DVL was last opened again, 0 for never.
        shared : (COLUMNS + 1, COLUMNS) array or None
            State.shared.
        """
        if opened_ns != self._opened_ns:
            self._opened_ns = opened_ns
            self._before = self._before or self._known_until(stamp_ns - BEFORE_NS)
        now = None if shared is None else _shown(stamp_ns, shared)
        if now is None:
            return []
        self._keep(now)
        if self._before is None:
            return []
        change = now.value - self._before.value
        chi_square = change * change / (now.variance + self._before.variance)
        if not chi_square > _BEYOND:
            return []
        sentence = (
            f'the yaw of the DVL against the IMU has changed by {abs(change):.1f} of its stated '
            f'sigma since its gate opened ({math.sqrt(chi_square):.1f} sigma): either has turned '
            'in its mount, and the heading may be off by as much'
        )
        level = Level.ERROR if chi_square > SEVERE * _BEYOND else Level.WARN
        culprit = Culprit.DVL | Culprit.IMU | Culprit.HEADING
        return [Condition('mounting', level, culprit, sentence)]

    def _keep(self, now: _Yaw) -> None:
        """Keep the newest two samples that are BEFORE_NS apart."""
        if not self._samples or now.stamp_ns - self._samples[-1].stamp_ns >= BEFORE_NS:
            self._samples = [*self._samples[-1:], now]

    def _known_until(self, stamp_ns: int) -> _Yaw | None:
        """The newest sample until a stamp."""
        found = [sample for sample in self._samples if sample.stamp_ns <= stamp_ns]
        return found[-1] if found else None


def _shown(stamp_ns: int, shared: Array) -> _Yaw | None:
    """What innovations alone, without the prior, show of the yaw; None where they hardly do."""
    known = float(shared[1 + DVL_YAW, DVL_YAW])
    if not known > KNOWN:
        return None
    variance = max(1.0 - known, 0.0) / known + _LEAST_VARIANCE
    return _Yaw(stamp_ns, float(shared[0, DVL_YAW]) / known, variance)
