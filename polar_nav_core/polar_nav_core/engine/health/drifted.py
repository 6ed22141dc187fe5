"""How far fixes of a station would have led the position, had they drifted and not the water.

Without a DVL a current that changes and fixes that drift look the same once the estimated current
has followed: what showed that one of both has happened fades within minutes. If it was the
current, the position is right; if it was the fixes, the position is off by all of the way that
the change of the current has made since, and goes on from there. So that stays said.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ...arrays import Array
from .conditions import Condition, Culprit, Level
from .slow import MOVED, shift_in_sigmas

KEPT_NS = 1_500_000_000_000
"""Currents of so long are known: no hypothesis is older."""
EVERY_NS = 10_000_000_000
USUAL_NS = 120_000_000_000
"""The current before a change is the mean of so long."""
ENDS = 2.5
"""Sigmas below which what was said (from MOVED on) ends: between fixes the sigma swings."""


class Drifted:
    """Way that a change of the current has made since it was shown; `look` says if it is far."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._way = np.zeros(2)  # of the current, since the first look
        self._past: deque[tuple[int, Array]] = deque()
        self._since: tuple[int, Array, Array] | None = None  # when, the way until then, current
        self._is_said = False

    def look(
        self, stamp_ns: int, current: Array, began_ns: int | None, P_horizontal: Array
    ) -> list[Condition]:
        """The condition that nothing has shown which of both it was, if it makes a difference.

        Parameters
        ----------
        stamp_ns : int
        current : (2,) array
            As it is estimated, station axes [m/s].
        began_ns : int or None
            When that began of which there is evidence now: fixes that drift, or a current that
            changes; None without. The first one counts.
        P_horizontal : (2, 2) array
            Published covariance of the horizontal position, station axes [m^2].
        """
        if self._stamp_ns:
            self._way = self._way + (stamp_ns - self._stamp_ns) * 1e-9 * current
        self._stamp_ns = stamp_ns
        if self._since is None:
            if began_ns is None:
                self._note(stamp_ns)
                return []
            self._since = self._before(began_ns, current)
        since_ns, way, usual = self._since
        led = self._way - way - (stamp_ns - since_ns) * 1e-9 * usual
        moved = shift_in_sigmas(led, P_horizontal)
        self._is_said = moved > (ENDS if self._is_said else MOVED)
        if not self._is_said:
            return []
        speed = math.hypot(*(current - usual))
        sentence = (
            f'the current, or what fixes do, has changed since {(stamp_ns - since_ns) / 60e9:.0f} '
            f'min ago ({speed:.2f} m/s now), and nothing shows which: if fixes drift, they have '
            f'led the position {math.hypot(*led):.0f} m, {moved:.1f} of its stated sigmas'
        )
        culprit = Culprit.FIXES | Culprit.MODEL
        return [Condition('current or fixes', Level.WARN, culprit, sentence)]

    def _note(self, stamp_ns: int) -> None:
        past = self._past
        if not past or stamp_ns - past[-1][0] >= EVERY_NS:
            past.append((stamp_ns, self._way))
        while stamp_ns - past[0][0] > KEPT_NS + USUAL_NS:
            past.popleft()

    def _before(self, began_ns: int, current: Array) -> tuple[int, Array, Array]:
        """When it began, as far as is known, the way until then, and the current before.

        Where it began with the run, the first current that is known.
        """
        past = [*self._past, (self._stamp_ns, self._way)]
        began_ns = min(began_ns, self._stamp_ns)
        at = next(k for k, (ns, _) in enumerate(past) if ns >= began_ns)
        since_ns, way = past[at]
        first = next(k for k, (ns, _) in enumerate(past) if ns >= since_ns - USUAL_NS)
        at = max(at, min(1, len(past) - 1))
        span_s = (past[at][0] - past[first][0]) * 1e-9
        usual = (past[at][1] - past[first][1]) / span_s if span_s > 0.0 else current.copy()
        return since_ns, way, usual
