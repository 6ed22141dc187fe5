"""One instrument of an IMU that hangs while the other goes on: its gyros, or its accelerometers.

An instrument with noise seldom says the same twice, and one that hangs says nothing else. But a
coarse one at rest repeats its values, too, as does a driver that is faster than its sensor. They
do so all the time, and a coarse axis of a vehicle in motion wherever its rate turns round. So an
instrument of which no axis did for 300 samples hangs where all three repeat their values.

The rule stands here twice, for one sample after another and for the columns of a whole run; a test
compares the two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array

LIVELY = 300
"""Samples without an axis that repeats its value: of an instrument that never does."""


class Instrument:
    """Judges the values of an instrument by those before them.

    Parameters
    ----------
    most_repeats : int
        Equal values in a row that an axis may have; 0 judges nothing.
    """

    def __init__(self, most_repeats: int) -> None:
        self._most = most_repeats
        self._values: list[float] | None = None
        self._runs = [0, 0, 0]
        self._lively = 0
        self._hung = False

    def hangs(self, values: list[float]) -> int:
        """Return how often it has repeated itself, if that shows that it hangs; else 0.

        The three values are those of the next sample.
        """
        before, self._values = self._values, values
        if before is None or not self._most:
            return 0
        (x, y, z), (u, v, w) = values, before
        same = [x == u, y == v, z == w]
        if not any(same):  # nearly always
            self._runs, self._hung = [0, 0, 0], False
            self._lively += 1
            return 0
        return self._repeats(same)

    def _repeats(self, same: list[bool]) -> int:
        """`hangs` of a sample with axes that are as before."""
        hung = self._hung and not all(same)
        # An axis that says by chance what it had hung at has not done so since long.
        runs = [
            (1 if hung else run + 1) if one else 0
            for run, one in zip(self._runs, same, strict=True)
        ]
        self._runs, repeats = runs, min(runs)
        self._hung = repeats > self._most and self._lively >= LIVELY
        if self._hung:
            return repeats
        if repeats > self._most or (not repeats and max(runs) > self._most):
            self._lively = 0
        else:
            self._lively += 1
        return 0


def beginnings(values: Array, most_repeats: int) -> NDArray[np.bool_]:
    """Mask (n,) of the samples with which an instrument is found to hang for the first time.

    So it is where it has not hung in the `LIVELY` samples before.

    Parameters
    ----------
    values : (n, 3) array
        Of samples in a row.
    most_repeats : int
        At least 1.
    """
    found = np.zeros(len(values), dtype=bool)
    same = values[1:] == values[:-1]
    together = same.all(axis=1)
    hanging = _longer(together, most_repeats)
    if not hanging.any():  # nearly always
        return found
    alone = np.column_stack([_longer(axis, most_repeats) for axis in same.T]).any(axis=1)
    ended = np.flatnonzero(hanging | (alone & ~together))
    first = np.flatnonzero(hanging & ~np.r_[False, hanging[:-1]])
    last = np.r_[-1, ended][np.searchsorted(ended, first)]
    found[1 + first[first - last > LIVELY]] = True
    return found


def _longer(repeats: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Mask of the ends of more than so many repeats in a row."""
    if len(repeats) <= most:
        return np.zeros(len(repeats), dtype=bool)
    counts = np.convolve(repeats, np.ones(most + 1, dtype=np.int64))[: len(repeats)]
    return np.asarray(counts > most)
