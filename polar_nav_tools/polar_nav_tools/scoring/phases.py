"""Phases of a mission, found in the truth: legs and turns, as windows that tile it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.spilled import by_rows

from ..series.vehicle import TruthSeries
from .windows import Window

TURN_RATE = np.deg2rad(0.5)  # [rad/s]
SHORTEST_S = 10.0
"""A turn or a straight part that is shorter belongs to what is before it."""
_SPAN_S = 2.0
"""Over this long the course rate is taken: waves do not turn a vehicle."""
_MOST = 40
_STEP_NS = 500_000_000
_LONGEST_S = 100_000.0
"""Truth that lasts longer and has less than one sample in ten steps of the grid is no course: one
damaged stamp makes years of a minute."""


def mission_phases(truth: TruthSeries) -> tuple[Window, ...]:
    """Legs and turns by the rate of the true course over ground.

    Empty when there is only one phase, and when there are so many that no table shows them.
    """
    truth = truth.in_order()
    stamp_ns, v_G = truth.stamp_ns, truth.v_G
    if len(stamp_ns) < 3 or stamp_ns[-1] - stamp_ns[0] < 2.0 * SHORTEST_S * 1e9:
        return ()
    span_ns = int(stamp_ns[-1]) - int(stamp_ns[0])
    if span_ns > _LONGEST_S * 1e9 and span_ns > 10 * _STEP_NS * len(stamp_ns):
        return ()
    grid_ns = np.arange(stamp_ns[0], stamp_ns[-1] + 1, _STEP_NS)
    nearest = np.minimum(np.searchsorted(stamp_ns, grid_ns), len(stamp_ns) - 1)
    course = np.unwrap(by_rows(lambda k: np.arctan2(v_G[k, 1], v_G[k, 0]), nearest))
    half = max(1, round(_SPAN_S / 2 / 0.5))
    rate = np.zeros(len(course))
    rate[half:-half] = (course[2 * half :] - course[: -2 * half]) / (2 * half * 0.5)
    rate[:half], rate[-half:] = rate[half], rate[-half - 1]
    parts = _merged(_runs(np.abs(rate) > TURN_RATE))
    if not 1 < len(parts) <= _MOST:
        return ()
    out, count = [], {True: 0, False: 0}
    for first, last, turning in parts:
        count[turning] += 1
        name = f'{"turn" if turning else "leg"} {count[turning]}'
        # Windows are closed: they end just before the next one begins.
        end_ns = int(stamp_ns[-1]) if last == len(grid_ns) else int(grid_ns[last]) - 1
        out.append(Window(name, int(grid_ns[first]), end_ns))
    return tuple(out)


def _runs(turning: NDArray[np.bool_]) -> list[tuple[int, int, bool]]:
    """Runs of equal values as (first index, index after the last, value)."""
    edges = [0, *(np.flatnonzero(turning[1:] != turning[:-1]) + 1).tolist(), len(turning)]
    return [(a, b, bool(turning[a])) for a, b in pairwise(edges)]


def _merged(parts: list[tuple[int, int, bool]]) -> list[tuple[int, int, bool]]:
    """Parts with short ones, and neighbours of one kind, joined to the part before."""
    out: list[tuple[int, int, bool]] = []
    for first, last, turning in parts:
        short = (last - first) * 0.5 < SHORTEST_S
        if out and (short or out[-1][2] == turning):
            out[-1] = (out[-1][0], last, out[-1][2])
        else:
            out.append((first, last, turning))
    if len(out) > 1 and (out[0][1] - out[0][0]) * 0.5 < SHORTEST_S:
        out[:2] = [(out[0][0], out[1][1], out[1][2])]
    return out
