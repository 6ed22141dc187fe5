"""Conversion of scores to plain values for JSON: no NaN, no arrays, no enums."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum

import numpy as np


def record(values: Mapping[str, object]) -> dict[str, object]:
    """Mapping in plain values, see `jsonable`."""
    return {str(k): jsonable(v) for k, v in values.items()}


def jsonable(value: object) -> object:
    """Content in plain values for JSON: NaN becomes None, arrays lists, enums names."""
    if isinstance(value, Mapping):
        return record(value)
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, (list, tuple)):
        return [jsonable(v) for v in value]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
