"""Rows of output of the compiled filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array
from .columns import WIDTH
from .consider import COLUMNS
from .state import MODEL, NAVIGATION, NEVER_NS
from .update import Ints, N


class Rows(NamedTuple):
    """Rows of output: stamps, leading values of the state, covariance, tally since the last."""

    io: Ints  # (3,): stamp that is due (-1: none), number of rows, when the next one is due
    stamps: Ints
    flat: Array  # (n, 30), then State.model where there is one
    P: Array  # (n, 24, 24), or of the leading states, or without rows
    derived: Array  # (n, nav_columns.WIDTH), or without rows
    tally: Array
    scratch: Array
    total: Array  # (24, 24): covariance with the common errors
    columns: Array  # (COLUMNS, 24) scratch


def make_rows(
    capacity: int, *, model: bool = False, derived: bool = False, states: int = N
) -> Rows:
    """Return empty rows for ``capacity`` outputs; with none, no output is written.

    With ``derived`` they hold the columns of `describe` in place of the covariance; that of the
    leading ``states``, 9 at least, where no more is asked for.
    """
    return Rows(
        np.array([-1, 0, 0 if capacity else NEVER_NS], dtype=np.int64),
        np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, NAVIGATION + (MODEL if model else 0))),
        np.zeros((0 if derived else capacity, states, states)),
        np.zeros((capacity if derived else 0, WIDTH)),
        np.zeros((capacity, 3, 3)),
        np.zeros((2, 3, 3)),
        np.zeros((N, N)),
        np.zeros((COLUMNS, N)),
    )


NO_ROWS = make_rows(0)
"""For a filter whose outputs nobody reads."""
