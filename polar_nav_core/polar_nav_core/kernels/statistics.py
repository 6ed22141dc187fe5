"""Test statistics of innovation memories (`watch`), a row each."""

from __future__ import annotations

import math

from ..arrays import Array
from . import watch
from .cache import entry, routine

# Columns of a row; their meaning stands with `engine.health.statistics.Statistics`.
NUMBER, NIS, NIS_SIGMAS, REFUSED, ACROSS = range(5)
GRID_MEAN, TRACK_MEAN, GRID, TRACK, GRID_RISE, TRACK_RISE = range(5, 23, 3)
WIDTH = 23


@entry
@routine
def fill_statistics(memories: Array, out: Array) -> None:
    """Fill the statistics, shape (n, WIDTH), of memories, shape (n, watch.WIDTH).

    Those of an empty memory are zero.
    """
    for k in range(memories.shape[0]):
        m, s = memories[k], out[k]
        weight = m[watch.WEIGHT]
        empty = not weight > 0.0
        safe = 1.0 if empty else weight
        number = weight * weight / (1.0 if empty else m[watch.WEIGHT_2])
        nis = m[watch.NIS] / safe
        s[NUMBER] = number
        s[NIS] = nis
        s[NIS_SIGMAS] = 0.0 if empty else (nis - 1.0) * math.sqrt(0.5 * number)
        s[REFUSED] = m[watch.REFUSED] / safe
        s[ACROSS] = m[watch.ACROSS] / safe
        along, across = m[watch.SQUARE] / safe, m[watch.SQUARE + 1] / safe
        level = max(1.0, 0.5 * (along + across))
        for axis in range(3):
            scatter = max(1.0, m[watch.SQUARE + axis] / safe)
            grid, track = m[watch.GRID + axis] / safe, m[watch.TRACK + axis] / safe
            s[GRID_MEAN + axis] = grid
            s[TRACK_MEAN + axis] = track
            s[GRID + axis] = number * (grid * grid) / (scatter if axis == 2 else level)
            s[TRACK + axis] = number * (track * track) / scatter
            at = watch.GRID_RISE + 2 * axis
            s[GRID_RISE + axis] = max(m[at], m[at + 1])
            at = watch.TRACK_RISE + 2 * axis
            s[TRACK_RISE + axis] = max(m[at], m[at + 1])


@entry
@routine
def largest_share(
    numbers: Array, squares: Array, sums: Array, fewest: float, most: Array, highest: float
) -> tuple[float, int, int]:
    """Largest share of a limit that a mean or a shift reaches: share, memory, axis.

    Parameters
    ----------
    numbers : (MEMORIES,) array
        Effective attempts.
    squares, sums : (MEMORIES, 3) arrays
        Chi-square of the means; cumulative sums of shifts.
    fewest : float
        Attempts from which on a mean is judged.
    most : (MEMORIES,) array
        Limits of the means.
    highest : float
        Limit of the sums.
    """
    worst, memory, axis = -math.inf, 0, 0
    for m in range(squares.shape[0]):
        for a in range(3):
            share = sums[m, a] / highest
            if numbers[m] >= fewest and squares[m, a] / most[m] > share:
                share = squares[m, a] / most[m]
            if share > worst:
                worst, memory, axis = share, m, a
    return worst, memory, axis
