"""Conditions of a navigation: level, culprit and sentence of each fault that is present."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag


class Level(IntEnum):
    """Severity of a condition; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


class Culprit(IntFlag):
    """Possible causes of a condition, as bits; several where the evidence cannot separate them."""

    NONE = 0
    FIXES = 1
    DVL = 2
    DEPTH = 4
    IMU = 8
    MODEL = 16
    HEADING = 32
    UNEXPLAINED = 64


_AFTER_S = 60.0


def lately_s(stamp_ns: int, event_ns: int) -> float | None:
    """Return the time since an event [s], for a minute; None after that, or where there was none.

    What made an estimate doubtful at a moment, as a gate that was opened again, stays a condition
    for so long. ``event_ns`` is 0 for never.
    """
    since_s = (int(stamp_ns) - int(event_ns)) * 1e-9
    return since_s if event_ns and since_s < _AFTER_S else None


@dataclass(frozen=True)
class Condition:
    """One fault of a navigation at a stamp.

    Attributes
    ----------
    key : str
        Names the kind of condition; the same while it lasts.
    level : Level
    culprit : Culprit
    sentence : str
        With the numbers of now.
    """

    key: str
    level: Level
    culprit: Culprit
    sentence: str


def fixes_followed(metres: float, culprit: Culprit, *, jumped: bool = False) -> Condition:
    """The condition that the estimate has followed fixes so far off [m] that it had refused.

    An ERROR where they ``jumped`` by more than the vehicle can have moved: then no model is to
    blame, but those before or those since.
    """
    if jumped:
        sentence = (
            f'fixes jumped {metres:.0f} m, farther than the vehicle can have moved, and are '
            'followed: those before or those since are wrong'
        )
        return Condition('fixes followed', Level.ERROR, Culprit.FIXES, sentence)
    sentence = (
        f'fixes that were refused in a row, {metres:.0f} m off, passed the gate later and moved '
        'the estimate: they are wrong, or it was before'
    )
    return Condition('fixes followed', Level.WARN, culprit, sentence)


RUNAWAY = 'runaway'
"""Key of a navigation that has diverged (engine.health.runaway)."""
LOST = ('lost', 'speed', 'depth', RUNAWAY)
"""Keys of conditions under which the covariance is no guide to where the vehicle is."""


@dataclass(frozen=True)
class Present:
    """A condition that is present, since when, and how often it has come.

    Attributes
    ----------
    condition : Condition
    since_ns : int
        Stamp from which on it has been present without a break [ns].
    count : int
        Times that it has begun.
    """

    condition: Condition
    since_ns: int
    count: int


@dataclass(frozen=True)
class Health:
    """State of a navigation at a stamp: every present condition, the worst first.

    Attributes
    ----------
    stamp_ns : int
    present : tuple of Present
        Worst level first, then the oldest.
    radius_95 : float
        Radius of a circle that holds the horizontal position with 95 % [m].
    resets : int
        How often the state was inflated, restored or started anew.
    used_ns : tuple of int
        Newest measurement that was used of DVL, depth and fixes; 0 for none.
    """

    stamp_ns: int
    present: tuple[Present, ...]
    radius_95: float
    resets: int
    used_ns: tuple[int, int, int] = (0, 0, 0)

    @property
    def level(self) -> Level:
        """Worst present level."""
        return max((p.condition.level for p in self.present), default=Level.OK)

    @property
    def lost(self) -> bool:
        """Whether the position is lost: the 95 % circle is too large, or the state impossible."""
        return any(p.condition.key in LOST for p in self.present)

    @property
    def culprit(self) -> Culprit:
        """Culprits of all present conditions of the worst level."""
        found = Culprit.NONE
        for p in self.present:
            if p.condition.level is self.level:
                found |= p.condition.culprit
        return found

    @property
    def sentence(self) -> str:
        """The leading condition's sentence; empty when all is well."""
        return self.present[0].condition.sentence if self.present else ''


class Chronicle:
    """Record of when each kind of condition began and how often it came."""

    def __init__(self) -> None:
        self._since: dict[str, int] = {}
        self._count: dict[str, int] = {}

    def note(self, stamp_ns: int, conditions: list[Condition]) -> tuple[Present, ...]:
        """Present conditions at a stamp, worst first; those not named have ended."""
        keys = {c.key for c in conditions}
        self._since = {key: at for key, at in self._since.items() if key in keys}
        for c in conditions:
            if c.key not in self._since:
                self._since[c.key] = stamp_ns
                self._count[c.key] = self._count.get(c.key, 0) + 1
        found = (Present(c, self._since[c.key], self._count[c.key]) for c in conditions)
        return tuple(sorted(found, key=lambda p: (-p.condition.level, p.since_ns)))
