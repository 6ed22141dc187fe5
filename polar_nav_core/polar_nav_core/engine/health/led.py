"""Where fixes that were off have led the estimate, once nothing shows any more that they are.

A filter that has followed fixes agrees with them: the evidence of a drift, or of a jump within the
gate, fades in minutes, and the position stays as far off as it was led. What was an ERROR for that
while there was evidence of it stays one.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from .conditions import Condition, Culprit, Level
from .slow import MOVED, Way, shift_in_sigmas

ENDED_NS = 60_000_000_000
"""After so long without evidence what comes next is another fault."""
ENDS = 2.5
"""Sigmas below which what was said (from MOVED on) ends: between fixes the sigma swings."""


class Led:
    """Sum of the ways that fixes have led the position; `look` says if it is still far."""

    def __init__(self) -> None:
        self._before_G = np.zeros(2)
        self._now_G = np.zeros(2)
        self._certain = False
        """Whether the sum was far when a way last was certain: an ERROR by its own evidence."""
        self._seen_ns = 0
        self._is_said = False

    def look(self, stamp_ns: int, way: Way | None, P_horizontal: Array) -> list[Condition]:
        """The condition that fixes have led the position away and not back, if they have.

        Parameters
        ----------
        stamp_ns : int
        way : Way or None
            How far they have moved the position by the evidence of now (`slow.led_by_fixes`); then
            the condition of that fault itself says so, unless that has become a WARN. None where
            it shows none. One that leads back has to be certain: else nothing would be said of
            what may still be off.
        P_horizontal : (2, 2) array
            Published covariance of the horizontal position, grid axes [m^2].
        """
        led_G = self._before_G + self._now_G
        if way is not None and (way.certain or float(way.shift_G @ led_G) >= 0.0):
            self._follow(stamp_ns, way.shift_G)
            led_G = self._before_G + self._now_G
            if way.certain:
                self._certain = shift_in_sigmas(led_G, P_horizontal) > MOVED
            if way.certain or not self._certain:
                return []
        moved = shift_in_sigmas(led_G, P_horizontal)
        self._is_said = moved > (ENDS if self._is_said else MOVED)
        if not self._is_said:
            return []
        heading = math.degrees(math.atan2(led_G[0], led_G[1])) % 360.0
        sentence = (
            f'fixes have led the position {math.hypot(*led_G):.1f} m to grid {heading:03.0f} deg, '
            f'{moved:.1f} of its stated sigmas, and nothing has led it back'
        )
        level = Level.ERROR if self._certain else Level.WARN
        return [Condition('fixes led', level, Culprit.FIXES, sentence)]

    def _follow(self, stamp_ns: int, shift_G: Array) -> None:
        """Take the way of now; one that leads back, or comes long after the last, is another."""
        other = stamp_ns - self._seen_ns > ENDED_NS or float(shift_G @ self._now_G) < 0.0
        if other:
            self._before_G = self._before_G + self._now_G
        # A younger hypothesis knows only the last part of the same way.
        if other or math.hypot(*shift_G) > math.hypot(*self._now_G):
            self._now_G = shift_G.copy()
        self._seen_ns = stamp_ns
