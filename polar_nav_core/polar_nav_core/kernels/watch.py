"""Running statistics of innovations, per sensor: what the watchdog judges (engine.health).

Every attempt to use a measurement counts, whether the gate let it pass or not. Two memories, of
30 and of 300 attempts, with exponentially falling weights: a short one for faults that come at
once, a long one for small errors that last. An innovation is divided, axis by axis, by the root of
its variance, and limited, so that outliers do not stand in for a bias.
"""

from __future__ import annotations

import math

from ..arrays import Array
from .cache import kernel

STREAMS = 3
"""DVL, depth, position fixes: rows as in State.tally."""
MEMORIES = 2
SHORT, LONG = 0, 1
LENGTHS = (30.0, 300.0)
"""Attempts after which a weight has fallen to 1/e."""

# Columns of a memory: sums of weights times ...
WEIGHT = 0  # ... one
WEIGHT_2 = 1  # sum of squared weights
NIS = 2  # ... NIS per degree of freedom, limited
REFUSED = 3  # ... one if the gate refused it
GRID = 4  # ... innovation per sigma, grid axes (3)
TRACK = 7  # ... the same along track, across (to port) and up (3)
SQUARE = 10  # ... its square, along, across, up (3)
WIDTH = 13

LIMIT = 4.0
"""Sigmas beyond which an innovation counts as that many."""


@kernel
def limited(x: float, limit: float) -> float:
    """The number, brought into [-limit, limit]."""
    return min(max(x, -limit), limit)


@kernel
def observe(
    memories: Array, z: Array, S: Array, nis: float, m: int, fused: bool, v_x: float, v_y: float
) -> None:
    """Add an attempt to both memories of a stream.

    Parameters
    ----------
    memories : (MEMORIES, WIDTH) array, in place
    z, S : (3,), (3, 3)
        Innovation (estimate minus measurement, grid axes; a depth: up in z[0]) and covariance.
    nis : float
        z^T S^-1 z of the first m rows.
    m : int
        Rows: 3, or 1 for a depth.
    fused : bool
        Whether the gate let it pass.
    v_x, v_y : float
        Velocity along grid east and north [m/s]: the track; below 0.05 m/s grid axes stand in.
    """
    speed = math.sqrt(v_x * v_x + v_y * v_y)
    c, s = 1.0, 0.0
    if speed > 0.05:
        c = v_x / speed
        s = v_y / speed
    east = north = along = across = 0.0
    if m == 1:
        up = limited(z[0] / math.sqrt(S[0, 0]), LIMIT)
    else:
        east = limited(z[0] / math.sqrt(S[0, 0]), LIMIT)
        north = limited(z[1] / math.sqrt(S[1, 1]), LIMIT)
        up = limited(z[2] / math.sqrt(S[2, 2]), LIMIT)
        variance = c * c * S[0, 0] + 2.0 * c * s * S[0, 1] + s * s * S[1, 1]
        along = limited((c * z[0] + s * z[1]) / math.sqrt(max(variance, 1e-300)), LIMIT)
        variance = s * s * S[0, 0] - 2.0 * c * s * S[0, 1] + c * c * S[1, 1]
        across = limited((c * z[1] - s * z[0]) / math.sqrt(max(variance, 1e-300)), LIMIT)
    ratio = min(nis / m, LIMIT * LIMIT)
    for k in range(MEMORIES):
        keep = math.exp(-1.0 / LENGTHS[k])
        row = memories[k]
        for j in range(WIDTH):
            row[j] *= keep
        row[WEIGHT_2] *= keep
        row[WEIGHT] += 1.0
        row[WEIGHT_2] += 1.0
        row[NIS] += ratio
        if not fused:
            row[REFUSED] += 1.0
        row[GRID] += east
        row[GRID + 1] += north
        row[GRID + 2] += up
        row[TRACK] += along
        row[TRACK + 1] += across
        row[TRACK + 2] += up
        row[SQUARE] += along * along
        row[SQUARE + 1] += across * across
        row[SQUARE + 2] += up * up
