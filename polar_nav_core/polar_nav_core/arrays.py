"""The array types of the core, and the checks of shape that vectorised functions begin with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def vectors(value: ArrayLike, name: str) -> Array:
    """Return *value* as a float64 array of shape (..., 3), or raise ValueError."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f'{name} must have shape (..., 3), not {array.shape}')
    return array


def matrices(value: ArrayLike, name: str) -> Array:
    """Return *value* as a float64 array of shape (..., 3, 3), or raise ValueError."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.ndim < 2 or array.shape[-2:] != (3, 3):
        raise ValueError(f'{name} must have shape (..., 3, 3), not {array.shape}')
    return array


def scalar_or_array(value: Array) -> Array:
    """Return a NumPy scalar for a 0-d result, as NumPy's own functions do."""
    result: Array = value[()]
    return result
