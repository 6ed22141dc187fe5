"""One thing that was found in a bag, and how bad it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum


class Severity(IntEnum):
    """How bad a finding is."""

    OK = 0
    """As it should be."""
    NOTE = 1
    """Worth knowing."""
    WARNING = 2
    """The result is worse than it could be."""
    SEVERE = 3
    """The result would be wrong."""


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    Attributes
    ----------
    severity : Severity
    name : str
        Kind of finding, for programs, e.g. ``backwards``.
    topic : str
        Where; empty for the whole bag.
    stamp_ns : int or None
        When it was first so [ns].
    value : float or None
        How much, in the unit of `text`, or how many.
    text : str
        A sentence for people.
    count : int or None
        Messages that have it, where `value` is something else.
    at_s : float or None
        `stamp_ns` since the start of the bag [s].
    """

    severity: Severity
    name: str
    topic: str
    stamp_ns: int | None
    value: float | None
    text: str
    count: int | None = None
    at_s: float | None = None

    def relative_to(self, start_ns: int) -> Finding:
        """Return the finding with its time since the start of the bag."""
        if self.stamp_ns is None:
            return self
        return replace(self, at_s=(self.stamp_ns - start_ns) * 1e-9)
