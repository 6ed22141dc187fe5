"""An offset between a published track and the best one, taken away with bounded acceleration.

The acceleration is constant over the first half of the way and constant over the second: of all
profiles of that duration the one with the least peak from rest. For an offset b and its rate v,
gone after T (b(T) = b'(T) = 0):

    a_1 = -4 b / T^2 - 3 v / T        a_2 = 4 b / T^2 + v / T
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..kernels.sins.offset import make_profile, offset_at

_SHARE = 0.8
"""Of the limit, for a first profile: corrections that come meanwhile need the rest."""
_FINER = 1.02
_LONGEST_S = 60.0
_WORSE = 1.5
"""A profile with less than the limit may take so much longer than one with all of it."""


class Bleed:
    """Offset (3,) that vanishes by itself.

    Parameters
    ----------
    limit : float
        Most acceleration, Euclidean norm [unit/s^2].
    shortest_s : float
        Duration of a profile that stays under the limit anyway [s].
    largest : float
        Most offset [unit]; more is not taken away slowly.

    Attributes
    ----------
    profile : Profile
        Its course, as kernels read it.
    """

    def __init__(self, limit: float, shortest_s: float, largest: float) -> None:
        self._limit, self._shortest_s, self._largest = limit, shortest_s, largest
        self.profile = make_profile()

    def clear(self) -> None:
        """Drop the offset."""
        self.profile.duration_s[0] = 0.0

    @property
    def active(self) -> bool:
        """Whether a profile was begun and has not been dropped."""
        return bool(self.profile.duration_s[0] > 0.0)

    def at(self, stamp_ns: int) -> tuple[Array, Array]:
        """Offset (3,) and its rate (3,) at a stamp [ns], not before the last `add`."""
        out = np.empty((2, 3))
        offset_at(self.profile, stamp_ns, out)
        return out[0], out[1]

    def add(self, stamp_ns: int, offset: Array, rate: Array) -> bool:
        """Add a step of the offset and of its rate; False, and nothing is added, if it must jump.

        Parameters
        ----------
        stamp_ns : int
        offset, rate : (3,) arrays
            [unit], [unit/s].
        """
        before, before_rate = self.at(stamp_ns)
        b, v = before + offset, before_rate + rate
        if not np.isfinite(b + v).all() or math.hypot(*b) > self._largest:
            return False
        duration_s = self._duration(b, v)
        if duration_s is None:
            return False
        self.profile.since_ns[0], self.profile.duration_s[0] = stamp_ns, duration_s
        self.profile.parts[:] = b, v, *_accelerations(b, v, duration_s)
        return True

    def _duration(self, b: Array, v: Array) -> float | None:
        """Duration [s] of the profile for an offset and rate; None where none is short enough."""
        squares = float(b @ b), float(b @ v), float(v @ v)
        hard = _shortest(squares, self._limit, self._shortest_s)
        soft = _shortest(squares, _SHARE * self._limit, self._shortest_s)
        if hard is None or soft is None:
            return hard
        return soft if soft <= _WORSE * hard else hard


def _accelerations(b: Array, v: Array, duration_s: float) -> tuple[Array, Array]:
    """Accelerations of the two halves of a profile, (3,) each."""
    T = duration_s
    return -4.0 / T**2 * b - 3.0 / T * v, 4.0 / T**2 * b + v / T


def _shortest(
    squares: tuple[float, float, float], limit: float, shortest_s: float
) -> float | None:
    """Duration [s], to 2 %, of the shortest profile with at most so much acceleration.

    ``squares`` are b.b, b.v and v.v of the offset b and its rate v; None above `_LONGEST_S`.
    """
    bb, bv, vv = squares
    T = shortest_s
    while T < _LONGEST_S:
        first = 16.0 * bb + 24.0 * bv * T + 9.0 * vv * T * T
        second = 16.0 * bb + 8.0 * bv * T + vv * T * T
        if max(first, second) <= limit * limit * T**4:
            return T
        T *= _FINER
    return None
