"""Fixes that come and are not used, and the time without any, from the start to the first fused.

The gate's refusals are counted in engine.integrity, and after the first fused fix so is the time
since the newest. Before it a navigation that uses no fix, for whatever reason, is dead reckoning
from a start that nothing has confirmed.
"""

from __future__ import annotations

from .health.conditions import Level

ALARMING = 3
"""Fixes in a row before anything is said: one or two are chance or outliers."""
PATIENCE = 3.0
"""Fixes count as still coming for this many of their mean intervals after the last."""

Verdict = tuple[Level, str]


def lasted_s(first_ns: int, last_ns: int, count: int, stamp_ns: int) -> float:
    """Time from the first of some fixes to now, or to when no more came [s].

    Parameters
    ----------
    first_ns, last_ns, count : int
        When the first and the last were received [ns]; their number.
    stamp_ns : int
        Now [ns].
    """
    if count < 2:
        return 0.0
    interval_ns = (last_ns - first_ns) / (count - 1)
    until_ns = min(stamp_ns, last_ns + round(PATIENCE * interval_ns))
    return max(0.0, (until_ns - first_ns) * 1e-9)


class Unused:
    """What came since the start, while no fix is fused.

    Parameters
    ----------
    longest_s : float
        Without a fused fix for longer is a warning, fixes that come for longer and are not used
        are an error [s].
    oldest_s : float
        For how long after the start fixes may come that are of a time before it [s].
    """

    def __init__(self, longest_s: float, oldest_s: float) -> None:
        self._longest_s = longest_s
        self._oldest_s = oldest_s
        self._began_ns: int | None = None
        self._count = 0
        self._first_ns = 0
        self._last_ns = 0

    def began(self, stamp_ns: int) -> None:
        """Count from a stamp [ns] on: a navigation has started, or believes fixes anew."""
        self._began_ns = stamp_ns
        self._count = 0

    def came(self, receive_ns: int) -> None:
        """Count a fix that nobody has switched off; before a navigation has started it is none."""
        if self._began_ns is None:
            return
        if not self._count:
            self._first_ns = receive_ns
        self._last_ns = receive_ns
        self._count += 1

    def verdict(self, stamp_ns: int) -> Verdict:
        """Level and sentence at a stamp, as long as no fix was fused."""
        if self._began_ns is None:
            return Level.OK, 'no fix was fused yet'
        since_s = (stamp_ns - self._began_ns) * 1e-9
        coming_s = lasted_s(self._first_ns, self._last_ns, self._count, stamp_ns)
        if self._count >= ALARMING and coming_s > self._oldest_s:
            what = f'{self._count} fixes came over {coming_s:.0f} s and none was ever fused'
            if coming_s > self._longest_s:
                return Level.ERROR, (
                    f'{what}; longer than max_gated_s {self._longest_s:.0f} s: their receipts '
                    'say why'
                )
            return Level.WARN, f'{what}: their receipts say why'
        if since_s > self._longest_s:
            return Level.WARN, (
                f'no fix was fused in {since_s:.0f} s since the start: dead reckoning'
            )
        return Level.OK, 'no fix was fused yet'
