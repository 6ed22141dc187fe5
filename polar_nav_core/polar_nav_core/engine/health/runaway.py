"""A navigation that has run away from its sensors, and an IMU that is noisier than stated."""

from __future__ import annotations

from collections.abc import Iterable

from .conditions import RUNAWAY, Condition, Culprit, Health, Level

AFTER_S = 30.0
"""A state that cannot be is a divergence if it lasts for longer."""
_SHARE = 0.9
"""Of the DVL's pings, refused."""
_SIGMAS = 3.0
"""Mean of their innovations, each of which counts for four at most: the same side, far beyond."""
_WARN, _ERROR = 1.5, 3.0
"""Times the stated noise."""


def imu_noise(factor: float) -> list[Condition]:
    """List of one condition if the IMU's noise is a multiple of the stated one, else empty."""
    if factor < _WARN:
        return []
    level = Level.WARN if factor < _ERROR else Level.ERROR
    sentence = (
        f'IMU noise at least {factor:.3g} times the stated one, or DVL or depth is off '
        '(no position fix shows which)'
    )
    return [Condition('IMU noise', level, Culprit.IMU | Culprit.DVL, sentence)]


class Runaway:
    """Stamp since which a navigation contradicts its vehicle or its DVL."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def look(
        self, stamp_ns: int, too_fast: bool, refused: float, innovation: float
    ) -> list[Condition]:
        """List of one condition if the navigation has contradicted them for AFTER_S, else empty.

        Parameters
        ----------
        stamp_ns : int
        too_fast : bool
            Faster than the vehicle can be.
        refused : float
            Share of the last DVL pings.
        innovation : float
            Mean of their innovations on the worst axis [sigma], each limited to four.
        """
        contradicted = refused > _SHARE and innovation > _SIGMAS
        if not (too_fast or contradicted):
            self._since_ns = None
            return []
        if self._since_ns is None:
            self._since_ns = stamp_ns
        since_s = (stamp_ns - self._since_ns) * 1e-9
        if since_s < AFTER_S:
            return []
        what = (
            'is faster than max_speed' if too_fast else 'contradicts a DVL that agrees with itself'
        )
        sentence = f'the navigation has run away: for {since_s:.0f} s its velocity {what}'
        return [Condition(RUNAWAY, Level.ERROR, Culprit.UNEXPLAINED, sentence)]


def divergence_of(looks: Iterable[Health]) -> str:
    """Sentence on the last divergence that a run's watchdog has found; empty without one."""
    found = ''
    for look in looks:
        for p in look.present:
            if p.condition.key == RUNAWAY:
                found = f'{p.condition.sentence} (at {look.stamp_ns * 1e-9:.3f} s)'
    return found
