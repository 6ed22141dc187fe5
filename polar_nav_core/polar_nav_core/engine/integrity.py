"""Whether position fixes still agree with the estimate, with a sentence for the crew.

A gate alone hides trouble: it refuses fix after fix, and the estimate goes on by dead reckoning as
if nothing had happened. This watches what the gate decides. Fixes that are refused in a row point
either at the source of the fixes (a leader that has lost its position) or at this vehicle; which
of the two is not observable here, so the vehicle keeps its own estimate, warns, and leaves the
decision to its crew. In two cases the fixes are taken to be right (`contradiction`): before ten
were fused, and where the watchdog doubts DVL or IMU. Nothing here changes the state.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from .followed import Followed
from .health.conditions import Condition, Culprit, Level
from .unused import ALARMING, Unused, lasted_s

_BELIEVED = 10
"""Agreeing refused fixes that are believed at the least."""
SETTLED = 10
"""Fused fixes that settle a filter."""
_TREND_SIGMAS = 4.0
"""A trend of the offsets within so many of its sigmas is none."""
_LEAST_TREND = 0.05
"""Nor is one that changes the offset by a smaller share of it."""
_LINED = 4
"""Refused fixes from which on a line in time is drawn through what they are off by."""
_SOON = 6
"""Those that show an estimate which runs away from them."""
_KEPT = 256
"""Refused fixes that are remembered one by one, for their common offset."""


@dataclass(frozen=True)
class Integrity:
    """Agreement of fixes with the estimate at a stamp.

    Attributes
    ----------
    level : Level
    sentence : str
        With the numbers.
    since_fused_s : float
        Since the last fused fix was received [s]; NaN before the first.
    gated_run : int
        Fixes refused by the gate since then.
    gated_s : float
        For how long they have been [s].
    offset_G : (3,) array
        Mean of refused fixes minus estimate, grid axes [m]; NaN when none was refused.
    scatter : float
        RMS distance of the refused fixes from that mean [m].
    """

    level: Level
    sentence: str
    since_fused_s: float
    gated_run: int
    gated_s: float
    offset_G: Array
    scatter: float

    @property
    def conditions(self) -> list[Condition]:
        """The same as a condition of the watchdog, where all is not well."""
        if self.level is Level.OK:
            return []
        key = 'fixes gated' if self.gated_run else 'no fixes'
        return [Condition(key, self.level, Culprit.FIXES, self.sentence)]


class Contradiction(NamedTuple):
    """Refused fixes that agree with one another and outweigh the estimate.

    Attributes
    ----------
    distance : float
        From the estimate to them at last [m].
    constant : bool
        Whether they keep their offset: the position is off, and nothing else. One that grows or
        turns comes from velocity or attitude.
    """

    distance: float
    constant: bool


@dataclass(frozen=True)
class _Refused:
    validity_ns: int
    receive_ns: int
    offset_G: Array


class IntegrityMonitor:
    """Detects long runs of refused position fixes from the gate's verdicts.

    Parameters
    ----------
    max_gated_s : float
        Fixes that are refused for longer than this are an error.
    max_delay_s : float
        Of the oldest fix that is used: until so long after the start one may be from before it.
    """

    def __init__(self, max_gated_s: float, max_delay_s: float = 0.0) -> None:
        self._max_gated_s = max_gated_s
        self.unused = Unused(max_gated_s, max_delay_s)
        self._refused: deque[_Refused] = deque(maxlen=_KEPT)
        self._count = 0
        self._first_ns = 0
        self._last_fused_ns: int | None = None
        self._newest_fused_validity_ns = 0
        self._doubted = False
        self._moved_m = 0.0
        self.followed = Followed()
        self._held: tuple[Array, Array] | None = None
        self._agreed = 0
        self.longest_gated_s = 0.0

    def known(self, validity_ns: int) -> None:
        """Count the time without a fix from that of a fix that was fused before a restart."""
        self._last_fused_ns = validity_ns

    def fused(self, validity_ns: int, receive_ns: int, offset_G: Array | None = None) -> None:
        """Count a fused fix: it ends a run of refused ones that were valid before it.

        ``offset_G`` is the fix minus the estimate before it was used (3,) [m]; without it, nobody
        asks whether the estimate has followed refused ones.
        """
        follows = offset_G is not None and self.agrees_with_refused(offset_G)
        refused_G = self._cluster()[0]
        if self._last_fused_ns is None or receive_ns > self._last_fused_ns:
            self._last_fused_ns = receive_ns
        self._newest_fused_validity_ns = max(self._newest_fused_validity_ns, validity_ns)
        self._release()
        later = [r for r in self._refused if r.validity_ns > validity_ns]
        if len(later) != len(self._refused):
            conflict = self.conflict()
            if conflict[0].any():
                self._held, self._agreed = conflict, 1
            self.longest_gated_s = max(self.longest_gated_s, self._gated_s(receive_ns))
            self._refused = deque(later, maxlen=_KEPT)
            self._count = len(later)
            self._first_ns = min((r.receive_ns for r in later), default=0)
        if not later:
            self.followed.used(refused_G if follows else None)

    def _release(self) -> None:
        """Count a fix that was fused since refused ones contradicted the estimate."""
        self._agreed += 1
        if self._agreed >= ALARMING:
            self._held = None

    @property
    def quiet(self) -> bool:
        """Whether no fix has been refused since the newest that was fused, nor contradicts."""
        return not self._count and self._held is None

    def gated(
        self, validity_ns: int, receive_ns: int, offset_G: Array, *, leaps: bool = False
    ) -> bool:
        """Whether a fix that the gate refused counts; ``offset_G`` is fix minus estimate (3,) [m].

        One that is valid before the newest fused fix does not. One that ``leaps`` lies farther
        from that one than the vehicle can have moved.
        """
        if validity_ns <= self._newest_fused_validity_ns:
            return False
        if not self._count:
            self._first_ns = receive_ns
            if leaps:
                self.followed.leapt(offset_G)
        self._refused.append(_Refused(validity_ns, receive_ns, offset_G))
        self._count += 1
        self._agreed = 0
        return True

    def agrees_with_refused(self, offset_G: Array) -> bool:
        """Whether a fix lies nearer to the refused ones than to the estimate.

        False unless several were refused and they have one offset in common.
        """
        if self._count < ALARMING:
            return False
        mean_G, scatter = self._cluster()
        size = float(np.linalg.norm(mean_G))
        return scatter < 0.5 * size and float(np.linalg.norm(offset_G - mean_G)) < 0.5 * size

    def contradiction(
        self, fused: int, *, doubted: bool, least_s: float, alone: bool = False
    ) -> Contradiction | None:
        """Return what refused fixes contradict the estimate by, if they are to be believed.

        They agree, are at least ten, and lasted for ``least_s`` [s]; and either they are twice as
        many as the few that were ever fused (the start was wrong, or the filter locked on to
        outliers), or DVL or IMU were ``doubted`` since the first of them was refused. A filter
        that has fused ten and whose other sensors agree is not moved by a displaced leader. One
        that is ``alone``, without a DVL, is, unless they keep their offset: one that changes is
        what an IMU makes of a tilt or a rate that is wrong.
        """
        self._doubted = doubted or self._doubted
        settled = fused >= SETTLED
        enough = _BELIEVED if settled else max(_BELIEVED, 2 * fused)
        vouched = settled and not self._doubted
        if self._count < enough or (vouched and not alone):
            return None
        newest = self._newest()
        if (newest[-1].validity_ns - newest[0].validity_ns) * 1e-9 < least_s:
            return None
        line = _line(newest)
        if not line.agree or (vouched and line.steady):
            return None
        distance = float(np.linalg.norm(line.offset_G))
        return Contradiction(distance, line.steady and not settled)

    def runs_away(self, least_s: float) -> bool:
        """Whether refused fixes lie on a line that the estimate leaves, for ``least_s`` [s]."""
        newest = self._newest()
        if len(newest) < _SOON:
            return False
        line = _line(newest, _LINED)
        long = (newest[-1].validity_ns - newest[0].validity_ns) * 1e-9 >= least_s
        return long and line.agree and not line.steady

    def conflict(self) -> tuple[Array, Array]:
        """Offset [m] of refused fixes from the estimate and its change [m/s], grid axes.

        Zero while fewer than three in a row are refused, or they scatter. One that passes the
        gate by chance does not end it: that takes three in a row. Of fewer than ten the offset
        is the mean, unless they show a trend.
        """
        if self._count >= ALARMING:
            newest = self._newest()
            line = _line(newest, _LINED)
            if line.steady:
                line = _line(newest)
            if line.agree:
                return line.offset_G, line.speed_G
        return self._held or (np.zeros(3), np.zeros(3))

    def _newest(self) -> list[_Refused]:
        return sorted(self._refused, key=lambda r: r.validity_ns)[-2 * _BELIEVED :]

    def believed(self, stamp_ns: int, moved_m: float) -> None:
        """Start anew after the covariance was enlarged at a stamp for refused fixes to be fused.

        Fixes that were valid before count no more; ``moved_m`` is how far a start was off [m].
        """
        if self._refused:
            self.followed.believed(self._newest()[-1].offset_G)
        self.longest_gated_s = max(self.longest_gated_s, self._gated_s(stamp_ns))
        self._refused.clear()
        self.unused.began(stamp_ns)
        self._count, self._doubted, self._held = 0, False, None
        self._moved_m = max(self._moved_m, moved_m)
        self._newest_fused_validity_ns = max(self._newest_fused_validity_ns, stamp_ns)

    @property
    def moved(self) -> list[Condition]:
        """A start or an estimate that fixes contradicted and then moved, until a reset.

        One of the two is wrong, and nothing that comes later shows which.
        """
        found = []
        if self._moved_m:
            sentence = (
                f'the first fixes lay {self._moved_m:.0f} m from the stated start, far beyond its '
                'sigma, and were believed: one of the two is wrong'
            )
            found.append(Condition('start', Level.WARN, Culprit.FIXES, sentence))
        return [*found, *self.followed.conditions()]

    def lasting(self, stamp_ns: int) -> bool:
        """Whether fixes have been refused for longer than `max_gated_s` at a stamp."""
        return self._count >= ALARMING and self._gated_s(stamp_ns) > self._max_gated_s

    def state(self, stamp_ns: int) -> Integrity:
        """Agreement of fixes with the estimate at a stamp."""
        since = (
            math.nan if self._last_fused_ns is None else (stamp_ns - self._last_fused_ns) * 1e-9
        )
        mean_G, scatter = self._cluster()
        gated_s = self._gated_s(stamp_ns)
        level, sentence = self._verdict(stamp_ns, since, gated_s, mean_G, scatter)
        return Integrity(level, sentence, since, self._count, gated_s, mean_G, scatter)

    def _verdict(
        self, stamp_ns: int, since: float, gated_s: float, mean_G: Array, scatter: float
    ) -> tuple[Level, str]:
        if self._count >= ALARMING:
            size = float(np.linalg.norm(mean_G))
            where = f'with no offset in common (mean {size:.0f} m, scatter {scatter:.0f} m)'
            if scatter < 0.5 * size:
                where = f'leader or follower displaced by about {size:.0f} m'
            what = f'{self._count} fixes gated in a row over {gated_s:.0f} s: {where}'
            if gated_s > self._max_gated_s:
                return Level.ERROR, (
                    f'{what}; longer than max_gated_s {self._max_gated_s:.0f} s, none is used: '
                    'check the leader, then ~/reset or ~/set_initial_state'
                )
            return Level.WARN, what
        if since > self._max_gated_s:
            return Level.WARN, f'no fix was fused for {since:.0f} s: dead reckoning'
        if math.isnan(since):
            return self.unused.verdict(stamp_ns)
        return Level.OK, f'last fix fused {max(since, 0.0):.0f} s ago'

    def _gated_s(self, stamp_ns: int) -> float:
        """Time from the first refused fix of the run to now, or to when the run went silent."""
        last_ns = max((r.receive_ns for r in self._refused), default=0)
        return lasted_s(self._first_ns, last_ns, self._count, stamp_ns)

    def _cluster(self) -> tuple[Array, float]:
        """Mean of the offsets [m] and RMS distance from it."""
        if not self._refused:
            return np.full(3, math.nan), math.nan
        offsets_G = np.array([r.offset_G for r in self._refused])
        mean_G: Array = np.mean(offsets_G, axis=0)
        scatter = float(np.sqrt(np.mean(np.sum((offsets_G - mean_G) ** 2, axis=1))))
        return mean_G, scatter


class _Line(NamedTuple):
    """Offsets of refused fixes about a line in time.

    Attributes
    ----------
    offset_G, speed_G : (3,) arrays
        At the newest one [m], and its change [m/s].
    scatter : float
        RMS distance from the line [m].
    steady : bool
        Whether the change is none by its sigma.
    """

    offset_G: Array
    speed_G: Array
    scatter: float
    steady: bool

    @property
    def agree(self) -> bool:
        """Whether they lie together, compared with their distance."""
        return self.scatter < 0.5 * float(np.linalg.norm(self.offset_G))


def _line(refused: list[_Refused], fewest: int = _BELIEVED) -> _Line:
    """Line through the offsets of refused fixes, in the order of validity; of few: their mean."""
    first_ns = refused[0].validity_ns
    t = np.array([(r.validity_ns - first_ns) * 1e-9 for r in refused])
    offsets_G = np.array([r.offset_G for r in refused])
    rows = np.ones((len(t), 1))
    if len(t) >= fewest and t[-1] > 0.0:
        rows = np.column_stack([rows, t - t.mean()])
    line, *_ = np.linalg.lstsq(rows, offsets_G, rcond=None)
    rest = offsets_G - rows @ line
    scatter = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    speed_G = line[1] if len(line) > 1 else np.zeros(3)
    offset_G = rows[-1] @ line
    change = float(np.linalg.norm(speed_G)) * float(t[-1])
    none = _TREND_SIGMAS * scatter * math.sqrt(12.0 / len(t))
    steady = change < max(none, _LEAST_TREND * float(np.linalg.norm(offset_G)))
    return _Line(offset_G, speed_G, scatter, steady)
