"""One thing that was looked at in a bag, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

OK, WARNING, ERROR = 'ok', 'warning', 'error'


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    level : str
        ``ok``, ``warning`` (it can be worked with) or ``error`` (figures from it would be wrong).
    what : str
        One word for programs, e.g. ``backwards``.
    topic : str
        Where; empty for the whole bag.
    stamp_ns : int or None
        When it was first so [ns].
    number : float or None
        How much or how many.
    text : str
        For people.
    at_s : float or None
        `stamp_ns` since the start of the bag [s].
    """

    level: str
    what: str
    topic: str
    stamp_ns: int | None
    number: float | None
    text: str
    at_s: float | None = None

    def relative_to(self, start_ns: int) -> Finding:
        """Give the time since the start of the bag, too."""
        if self.stamp_ns is None:
            return self
        return replace(self, at_s=(self.stamp_ns - start_ns) * 1e-9)

    def line(self) -> str:
        """One line for people."""
        where = f'{self.topic}: ' if self.topic else ''
        when = '' if self.at_s is None else f', at {self.at_s:.3f} s'
        return f'{self.level:>7}  {where}{self.text}{when}'
