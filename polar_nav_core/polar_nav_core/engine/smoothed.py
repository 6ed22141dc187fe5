"""Result of smoothing, of either mode."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

from ..arrays import Array
from .events import Fix
from .hindsight import Revision
from .outputs import Receipt
from .track import T

MOST_PASSES = 3
MOVED = 0.1
"""Movement of the track that a further pass is made for, of its sigma."""


@dataclass(frozen=True)
class Smoothed(Generic[T]):
    """Smoothed track of a run.

    Attributes
    ----------
    track : Track or StationTrack
        With covariances that contain the common errors, as published ones do.
    receipts : sequence of Receipt
        Of fixes, as the filter decided that had each at its validity; behind them those of fixes
        of which hindsight decided otherwise, as revisions.
    divergence : str
        Why the filter stopped; empty where it did not.
    information : (COLUMNS, COLUMNS) array
        Fisher information of the common errors, with navigation and sensor states as nuisance;
        empty in station mode.
    vector : (COLUMNS,) array
        ``information`` times their least-squares estimate.
    largest_turn : float
        Largest smoothed correction of the attitude [rad]: what the linear model has to bear.
    passes : int
    moved : float
        Largest movement of the track in the last pass, of its sigma; infinite after one.
    revisions : tuple of Revision
        In the order of their stamps.
    unsettled : str
        Why there should be another pass; empty where there need not.
    """

    track: T
    receipts: Sequence[Receipt]
    divergence: str
    information: Array
    vector: Array
    largest_turn: float
    passes: int = 1
    moved: float = math.inf
    revisions: tuple[Revision, ...] = ()
    unsettled: str = ''


def at_validity(fix: Fix) -> Fix:
    """Fix that is received when it is valid."""
    return replace(fix, transmit_ns=fix.validity_ns, receive_ns=fix.validity_ns)


def still_to_come(moved: float, before: float) -> float:
    """Movement of a further pass: it shrinks from pass to pass at least as it did.

    ``moved`` and ``before`` are those of the last pass and of the one before it.
    """
    return moved if math.isinf(before) else moved * min(1.0, moved / before)
