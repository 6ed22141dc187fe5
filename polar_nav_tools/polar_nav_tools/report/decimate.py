"""Rows of lines and markers to draw: fewer points with the same pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def envelope(x: Floats, y: Floats, columns: int) -> NDArray[np.intp]:
    """Rows to keep of a line over time: first, lowest, highest and last of every pixel column.

    Lines through these rows cover the same pixels as lines through all of them (Jugel et al. 2014,
    "M4").

    Parameters
    ----------
    x : ndarray, shape (n,)
        Not decreasing.
    y : ndarray, shape (n,)
        NaN breaks the line; the first NaN of a column is kept.
    columns : int
        Pixel columns that the span of x is drawn across, >= 1.

    Returns
    -------
    ndarray of int
        Sorted rows, at most five per column.
    """
    if columns < 1:
        raise ValueError(f'columns={columns} must be >= 1')
    n = len(x)
    if n <= 5 * columns:
        return np.arange(n)
    span = float(x[-1] - x[0])
    if span <= 0.0:
        return np.arange(n)
    column = np.minimum(((x - x[0]) * (columns / span)).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.r_[True, np.diff(column) > 0])
    ends = np.r_[starts[1:], n] - 1
    hidden = np.isnan(y)
    lowest = _first_where(y, np.minimum.reduceat(np.where(hidden, np.inf, y), starts), starts, n)
    highest = _first_where(y, np.maximum.reduceat(np.where(hidden, -np.inf, y), starts), starts, n)
    breaks = np.flatnonzero(hidden & ~np.r_[False, hidden[:-1]])
    keep = np.unique(np.concatenate([starts, ends, lowest, highest, breaks]))
    return keep.astype(np.intp)


def _first_where(y: Floats, target: Floats, starts: NDArray[np.intp], n: int) -> NDArray[np.intp]:
    """Row of the first sample of each column that equals the column's target."""
    lengths = np.diff(np.r_[starts, n])
    hit = np.flatnonzero(y == np.repeat(target, lengths))
    column_of_hit = np.searchsorted(starts, hit, side='right') - 1
    _, first = np.unique(column_of_hit, return_index=True)
    return hit[first]


def distinct(x: Floats, y: Floats, columns: int, rows: int) -> NDArray[np.intp]:
    """Rows to keep of markers: one in every cell of a raster laid over all of them.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Finite; take the logarithm first for a logarithmic axis.
    columns, rows : int
        Cells of the raster; with cells well under the size of a marker nothing is seen to be
        missing.
    """
    if len(x) == 0:
        return np.empty(0, dtype=np.intp)
    cell_x = _cells(x, columns)
    cell_y = _cells(y, rows)
    _, keep = np.unique(cell_x * rows + cell_y, return_index=True)
    return np.sort(keep)


def _cells(values: Floats, count: int) -> NDArray[np.int64]:
    low, span = float(values.min()), float(np.ptp(values))
    if span == 0.0:
        return np.zeros(len(values), dtype=np.int64)
    return np.minimum(((values - low) * (count / span)).astype(np.int64), count - 1)


def simplified(points: Floats, tolerance: float) -> NDArray[np.intp]:
    """Rows to keep of a path in the plane, with every point within `tolerance` of the line.

    Points that stay in one cell of size `tolerance` / 2 are merged first, then Douglas and
    Peucker's rule is applied to what remains; together at most `tolerance`.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Finite, in order.
    tolerance : float
        In the unit of `points`, > 0.
    """
    if not tolerance > 0.0:
        raise ValueError(f'tolerance={tolerance} must be > 0')
    n = len(points)
    if n <= 2:
        return np.arange(n)
    # Diagonal of a cell: tolerance / 2.
    cell = np.floor((points - points[0]) * (2.0 * np.sqrt(2.0) / tolerance))
    moved = np.r_[True, (np.diff(cell, axis=0) != 0).any(1)]
    moved[-1] = True
    rows = np.flatnonzero(moved)
    p = points[rows]
    keep = np.zeros(len(p), dtype=bool)
    keep[[0, -1]] = True
    stack = [(0, len(p) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        distance = _to_segment(p[a + 1 : b], p[a], p[b])
        worst = int(np.argmax(distance))
        if distance[worst] > 0.5 * tolerance:
            middle = a + 1 + worst
            keep[middle] = True
            stack += [(a, middle), (middle, b)]
    return rows[keep]


def _to_segment(p: Floats, a: Floats, b: Floats) -> Floats:
    """Distance of each point from the segment between a and b."""
    d = b - a
    length2 = float(d @ d)
    if length2 == 0.0:
        return _length(p - a)
    t = np.clip((p - a) @ d / length2, 0.0, 1.0)
    return _length(p - a - t[:, None] * d)


def _length(vectors: Floats) -> Floats:
    return np.hypot(vectors[:, 0], vectors[:, 1])
