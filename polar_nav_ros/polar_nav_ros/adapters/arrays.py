"""Small questions on arrays that several modules ask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FEWEST_STAMPS = 3
_LONGEST_STEP_NS, _STEPS = 1_000_000_000, 10.0
"""A stamp that is further from zero than this, and than so many usual steps, is of another row."""


def finite_rows(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which rows have finite numbers only. (n, ...) -> (n,)."""
    finite = np.isfinite(values.reshape(len(values), -1))
    if finite.all():  # nearly always, and ten times as fast as row by row
        return np.ones(len(values), dtype=bool)
    return np.asarray(finite.all(axis=1))


def turned(C: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors of a matrix times rows. (3, 3), (n, 3) -> (n, 3).

    Sums are written out here and below: a row does not depend on how many there are, so that one
    message has the bits of a whole recording, and zeros and ones give the very numbers.
    """
    x, y, z = values[:, 0:1], values[:, 1:2], values[:, 2:3]
    return np.ascontiguousarray(x * C[:, 0] + y * C[:, 1] + z * C[:, 2])


def congruent(C: NDArray[np.float64], P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariances C P C^T. (3, 3) or (n, 3, 3), (n, 3, 3) -> (n, 3, 3)."""
    x, y, z = (C[..., :, j, None] * P[:, j, None, :] for j in range(3))
    half = x + y + z
    x, y, z = (half[:, :, k, None] * C[..., None, :, k] for k in range(3))
    return np.asarray(x + y + z)


def chosen(values: NDArray[Any], mask: NDArray[np.bool_]) -> NDArray[Any]:
    """Rows of a mask; the array itself, not a copy, where that is all of them."""
    return values if mask.all() else values[mask]


def unfilled(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the mask of stamps that are zero because nobody filled them in.

    A recording may begin at zero: one zero is a stamp like any other where the next one follows
    it as stamps follow one another.

    Parameters
    ----------
    stamps_ns : (n,) array
        In any order [ns].
    """
    zero = np.asarray(stamps_ns == 0)
    if np.count_nonzero(zero) != 1 or len(stamps_ns) < _FEWEST_STAMPS:
        return zero
    later = np.sort(stamps_ns)
    usual_ns = float(np.median(np.diff(later)))
    if later[0] == 0 and later[1] <= max(_LONGEST_STEP_NS, _STEPS * usual_ns):
        return np.zeros(len(zero), dtype=bool)
    return zero
