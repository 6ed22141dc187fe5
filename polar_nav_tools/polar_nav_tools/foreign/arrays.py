"""Small questions on arrays that several modules ask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def finite_rows(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which rows have finite numbers only. (n, ...) -> (n,)."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1))
