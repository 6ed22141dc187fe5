"""Places in the order of events at which a whole run is looked at by the watchdog."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .events import OrderKey, Rank

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Look:
    """A look at the navigation before the events of a stamp; it changes no estimate."""

    stamp_ns: int

    @property
    def key(self) -> OrderKey:
        """Sort key in the total order of events: before the first of its stamp."""
        return (self.stamp_ns, Rank.IMU, -1, 0)


def looks_of(seconds_ns: Sequence[int], every_s: float) -> list[Look]:
    """Looks every so many whole seconds, before the IMU samples at which a node looks.

    Parameters
    ----------
    seconds_ns : sequence of int
        Stamps of the samples with which a new second begins [ns].
    every_s : float
        Whole seconds [s]; 0 for no looks.
    """
    every = max(1, round(every_s))
    if not every_s:
        return []
    return [Look(stamp_ns) for stamp_ns in seconds_ns if stamp_ns // _SECOND_NS % every == 0]
