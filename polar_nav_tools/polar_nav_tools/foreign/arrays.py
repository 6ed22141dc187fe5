"""Small questions on arrays that several modules ask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def finite_rows(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which rows have finite numbers only. (n, ...) -> (n,)."""
    finite = np.isfinite(values.reshape(len(values), -1))
    if finite.all():  # nearly always, and ten times as fast as row by row
        return np.ones(len(values), dtype=bool)
    return np.asarray(finite.all(axis=1))


def chosen(values: NDArray[Any], mask: NDArray[np.bool_]) -> NDArray[Any]:
    """Rows of a mask; the array itself, not a copy, where that is all of them."""
    return values if mask.all() else values[mask]
