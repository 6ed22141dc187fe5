"""Windows of a mission that are scored separately: closed intervals of stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WHOLE = 'whole'
SECOND_HALF = 'second_half'


@dataclass(frozen=True)
class Window:
    """Stamps from `start_ns` to `end_ns`, both included [ns]."""

    name: str
    start_ns: int
    end_ns: int

    def __post_init__(self) -> None:
        if self.end_ns < self.start_ns:
            raise ValueError(
                f'window {self.name!r}: end_ns={self.end_ns} < start_ns={self.start_ns}'
            )

    @property
    def duration(self) -> float:
        """Length [s]."""
        return (self.end_ns - self.start_ns) * 1e-9

    def mask(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Mask of the stamps inside."""
        return (stamp_ns >= self.start_ns) & (stamp_ns <= self.end_ns)

    def rows(self, stamp_ns: NDArray[np.int64]) -> slice:
        """Slice of the ascending stamps inside."""
        first = np.searchsorted(stamp_ns, self.start_ns, side='left')
        stop = np.searchsorted(stamp_ns, self.end_ns, side='right')
        return slice(int(first), int(stop))


def standard_windows(start_ns: int, end_ns: int) -> tuple[Window, ...]:
    """Windows of the whole run and of its second half by time.

    Halves are taken of the truth's span, not of the estimates, so that a filter that falls silent
    is judged on the same interval as one that does not.
    """
    middle_ns = start_ns + (end_ns - start_ns) // 2
    return (
        Window(WHOLE, start_ns, end_ns),
        Window(SECOND_HALF, middle_ns, end_ns),
    )
