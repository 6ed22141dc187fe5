"""Condition of packets whose times say that the clock of their sender stepped.

Packets state times of their sender's clock, and both vehicles' clocks are taken to agree. One
packet that is too old was long under way; several in a row, all off by as much, are a clock's.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from .health.conditions import Condition, Culprit, Level
from .verdicts import Verdict

_ALARMING = 3
"""Packets in a row before anything is said."""
_KEPT = 32
_HEARD_NS = 60_000_000_000
"""The condition ends so long after the last of them."""
_ALIKE_S = 5.0
"""Ages that spread less are of one clock: delays of packets differ by seconds."""


class SenderClock:
    """Ages of packets that were refused for them, since one was usable."""

    def __init__(self) -> None:
        self._refused_s: deque[float] = deque(maxlen=_KEPT)
        self._count = 0
        self._last_ns = 0
        self._usual_s = 0.0

    def usable(self, age_s: float) -> None:
        """Note a packet of a possible age [s]: it ends a row of others."""
        self._refused_s.clear()
        self._count, self._usual_s = 0, age_s

    def refused(self, verdict: Verdict, age_s: float, receive_ns: int) -> None:
        """Note a refused packet, where it was for its age [s]; received at a stamp [ns]."""
        if verdict in (Verdict.TOO_OLD, Verdict.FROM_FUTURE):
            self._refused_s.append(age_s)
            self._count += 1
            self._last_ns = receive_ns

    def conditions(self, stamp_ns: int) -> list[Condition]:
        """Condition at a stamp [ns]; empty without one."""
        if self._count < _ALARMING or stamp_ns > self._last_ns + _HEARD_NS:
            return []
        ages = np.array(self._refused_s)
        age_s = float(np.median(ages))
        by = _said(abs(age_s))
        how = f'{by} s old' if age_s >= 0.0 else f'{by} s ahead of their reception'
        why = 'they are held up on their way'
        if np.ptp(ages) < _ALIKE_S:
            step = _said(self._usual_s - age_s, '+')
            why = f'the clock of their sender, or of this vehicle, is off by some {step} s'
        sentence = f'{self._count} packets in a row are {how}, and none is used: {why}'
        return [Condition('sender clock', Level.WARN, Culprit.FIXES, sentence)]


def _said(seconds: float, sign: str = '') -> str:
    """Text of a time, which is not 0.0 where it is some milliseconds [s]."""
    if abs(seconds) < 1.0:
        return f'{seconds:{sign}.3f}'
    return f'{seconds:{sign}.0f}' if sign else f'{seconds:.1f}'
