"""A local sensor that was refused for long, and is used again without its gate having been opened.

The covariance has grown until it passed. The estimate goes over to it then, by what its position
has learnt to be correlated with meanwhile, and nothing else says that one of the two was wrong.
"""

from __future__ import annotations

from collections.abc import Sequence

from .conditions import Condition, Culprit, Level, lately_s

REFUSED_S = 10.0
"""A sensor that was refused for less had no time to leave the estimate."""


class UsedAgain:
    """Since when a sensor is refused, and until when it was, for REFUSED_S.

    Parameters
    ----------
    name : str
        Of the sensor.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._since_ns: int | None = None
        self._until_ns = 0
        self._culprit = Culprit.NONE

    def look(self, stamp_ns: int, refusals: Sequence[Condition]) -> list[Condition]:
        """The condition that it is used again, if so; ``refusals`` are conditions of its gate."""
        if refusals:
            self._note(stamp_ns, refusals)
            return []
        self._since_ns = None
        again_s = lately_s(stamp_ns, self._until_ns)
        if again_s is None:
            return []
        sentence = (
            f'{self._name} was refused until {again_s:.0f} s ago and is used again: the estimate '
            'has gone over to it, or come back'
        )
        return [Condition(f'{self._name} reopened', Level.ERROR, self._culprit, sentence)]

    def _note(self, stamp_ns: int, refusals: Sequence[Condition]) -> None:
        self._culprit = refusals[0].culprit
        refused = any(c.key == f'{self._name} refused' for c in refusals)
        if not refused:  # its gate was opened, which is a condition of its own
            self._since_ns, self._until_ns = None, 0
        elif self._since_ns is None:
            self._since_ns = stamp_ns
        elif (stamp_ns - self._since_ns) * 1e-9 >= REFUSED_S:
            self._until_ns = stamp_ns
