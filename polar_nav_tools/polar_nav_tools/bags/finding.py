"""Finding of an examination of a bag, with its severity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum


class Severity(IntEnum):
    """Severity of a finding."""

    OK = 0
    """As it should be."""
    NOTE = 1
    """Worth knowing."""
    WARNING = 2
    """Results are less accurate than possible."""
    SEVERE = 3
    """Results would be wrong."""


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    severity : Severity
    name : str
        Kind of finding, for programs, e.g. ``backwards``.
    topic : str
        Topic; empty for the whole bag.
    stamp_ns : int or None
        Stamp of its first occurrence [ns].
    value : float or None
        Amount in the unit of `text`, or a number of messages.
    text : str
        Sentence for the terminal.
    count : int or None
        Number of messages with it, if `value` is something else.
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
