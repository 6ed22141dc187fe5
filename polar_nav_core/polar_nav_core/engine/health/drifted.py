"""How far fixes of a station would have led the position, had they drifted and not the water.

Without a DVL a current that changes and fixes that drift look the same once the estimated current
has followed: what showed that one of both has happened fades within minutes. If it was the
current, the position is right; if it was the fixes, the position is off by all of the way that
the change of the current has made since, and goes on from there. So that stays said.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from .conditions import Condition, Culprit, Level
from .led import ENDS
from .slow import MOVED, shift_in_sigmas

KEPT_NS = 1_500_000_000_000
"""Currents of so long are known: no hypothesis is older."""
EVERY_NS = 10_000_000_000
USUAL_NS = 120_000_000_000
"""The current before a change is the mean of so long."""


class _Moment(NamedTuple):
    """A moment of the past.

    Attributes
    ----------
    stamp_ns : int
    way : (2,) array
        Of the current since the first look [m].
    variance : float
        Of the current per axis [m^2/s^2].
    """

    stamp_ns: int
    way: Array
    variance: float


class Drifted:
    """Way that a change of the current has made since it was shown; `look` says if it is far."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._way = np.zeros(2)  # of the current, since the first look
        self._past: deque[_Moment] = deque()
        self._since: tuple[_Moment, Array] | None = None  # and the current before
        self._is_said = False

    def look(
        self,
        stamp_ns: int,
        current: Array,
        P_current: Array,
        began_ns: int | None,
        P_horizontal: Array,
    ) -> list[Condition]:
        """The condition that nothing has shown which of both it was, if it makes a difference.

        Parameters
        ----------
        stamp_ns : int
        current : (2,) array
            As it is estimated, station axes [m/s].
        P_current : (2, 2) array
            Its published covariance [m^2/s^2]. That of before the change makes the way that it
            has made since as uncertain.
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
            now = _Moment(stamp_ns, self._way, float(np.linalg.eigvalsh(P_current)[-1]))
            if began_ns is None:
                self._note(now)
                return []
            self._since = self._before(began_ns, now, current)
        since, usual = self._since
        since_s = (stamp_ns - since.stamp_ns) * 1e-9
        led = self._way - since.way - since_s * usual
        moved = shift_in_sigmas(led, P_horizontal + since_s**2 * since.variance * np.eye(2))
        self._is_said = moved > (ENDS if self._is_said else MOVED)
        if not self._is_said:
            return []
        speed = math.hypot(*(current - usual))
        sentence = (
            f'the current, or what fixes do, has changed since {since_s / 60.0:.0f} '
            f'min ago ({speed:.2f} m/s now), and nothing shows which: if fixes drift, they have '
            f'led the position {math.hypot(*led):.0f} m, {moved:.1f} sigmas'
        )
        culprit = Culprit.FIXES | Culprit.MODEL
        return [Condition('current or fixes', Level.WARN, culprit, sentence)]

    def _note(self, now: _Moment) -> None:
        past = self._past
        if not past or now.stamp_ns - past[-1].stamp_ns >= EVERY_NS:
            past.append(now)
        while now.stamp_ns - past[0].stamp_ns > KEPT_NS + USUAL_NS:
            past.popleft()

    def _before(self, began_ns: int, now: _Moment, current: Array) -> tuple[_Moment, Array]:
        """The moment when it began, as far as is known, and the current before.

        Where it began with the run, the first current that is known.
        """
        past = [*self._past, now]
        began_ns = min(began_ns, now.stamp_ns)
        at = next(k for k, moment in enumerate(past) if moment.stamp_ns >= began_ns)
        since = past[at]
        usual_ns = since.stamp_ns - USUAL_NS
        first = next(moment for moment in past if moment.stamp_ns >= usual_ns)
        last = past[max(at, min(1, len(past) - 1))]
        span_s = (last.stamp_ns - first.stamp_ns) * 1e-9
        usual = (last.way - first.way) / span_s if span_s > 0.0 else current.copy()
        return since, usual
