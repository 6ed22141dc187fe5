"""Refused fixes that have moved the estimate at last: one of the two was wrong.

Fixes that were refused in a row may pass the gate later, or be believed. Where the first of them
lay farther from the fix used before than the vehicle can have moved, they have jumped, and no dead
reckoning is to blame. Nothing that comes later shows which place is right, but others that lead
back.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from .events import Fix
from .health.conditions import Condition, Culprit, fixes_followed

_SIGMAS = 4.0
"""Of two fixes, beyond the farthest way between them: they have jumped."""
_SAME = 0.5
"""Share of the first offset that must be left when fixes are followed: a jump stays."""
_BACK = 0.5
"""Share of the farthest way that fixes have led the estimate below which they have led it back."""


def leaps(used: Fix, fix: Fix, max_speed: float) -> bool:
    """Whether a fix lies farther from one that was used than the vehicle can have moved [m/s]."""
    way_e = fix.r_e - used.r_e
    length = math.hypot(*way_e.tolist())
    since_s = abs(fix.validity_ns - used.validity_ns) * 1e-9
    rest = length - max_speed * since_s
    square = float(way_e @ (fix.covariance_e + used.covariance_e) @ way_e)
    return rest * length > _SIGMAS * math.sqrt(square)


class Followed:
    """Sum of the offsets of refused fixes that the estimate has followed."""

    def __init__(self) -> None:
        self._way_G = np.zeros(3)
        self._farthest_m = 0.0
        self._leap_m = 0.0
        self._believed_G: Array | None = None
        self._jumped = False

    def leapt(self, offset_G: Array) -> None:
        """Note that the first fix of a run of refused ones leapt; ``offset_G`` [m] is its own."""
        self._leap_m = self._leap_m or math.hypot(*offset_G.tolist())

    def believed(self, offset_G: Array) -> None:
        """Note that refused fixes so far off [m] are believed, though none was used yet."""
        if self._leap_m:
            self._believed_G = offset_G

    def used(self, offset_G: Array | None) -> None:
        """Count a fix that ends a run of refused ones, or follows none.

        ``offset_G`` [m] is theirs where it passed the gate as one of them. A run that leapt and
        was believed counts in any case.
        """
        way_G = offset_G if self._believed_G is None else self._believed_G
        if way_G is not None:
            stays = math.hypot(*way_G.tolist()) > _SAME * self._leap_m > 0.0
            self._way_G += way_G
            self._farthest_m = max(self._farthest_m, self._size())
            self._jumped = not self._is_back() and (self._jumped or stays)
        self._leap_m, self._believed_G = 0.0, None

    def conditions(self) -> list[Condition]:
        """The condition that fixes have led the estimate away, until others lead it back."""
        if self._is_back():
            return []
        return [fixes_followed(self._size(), Culprit.FIXES, jumped=self._jumped)]

    def to_save(self) -> tuple[float, float, bool] | None:
        """`SavedState.followed`; None where nothing was followed."""
        x, y, _ = self._way_G.tolist()
        return None if self._is_back() else (x, y, self._jumped)

    def restore(self, saved: tuple[float, float, bool]) -> None:
        """Take over what was saved before a restart."""
        *way, self._jumped = saved
        self._way_G = np.array([*way, 0.0])
        self._farthest_m = self._size()

    def _size(self) -> float:
        return math.hypot(*self._way_G.tolist())

    def _is_back(self) -> bool:
        return self._size() <= _BACK * self._farthest_m
