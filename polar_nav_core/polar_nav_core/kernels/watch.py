"""Running statistics of innovations per sensor, which the watchdog judges (engine.health).

Every attempt to use a measurement counts, whether the gate let it pass or not. Two memories, of
30 and of 300 attempts, with exponentially falling weights: a short one for faults that come at
once, a long one for small errors that last. An innovation is divided, axis by axis, by the root of
its variance, and limited, so that outliers do not stand in for a bias.

Beside each memory run cumulative sums (Page 1954) of the logarithm of the likelihood ratio of a
shift, or of a larger scatter, against none; each is held between 0 and `MOST_RISE`. They find a
step or a drift after as few attempts as its size allows, wherever it begins. Of a filter that
knows its sensors, such a sum exceeds h once in exp(h) attempts at most (Lorden 1971), since the
ratio has the mean 1 then; that of limited innovations is smaller. Two more such sums look for a
smaller scatter and for neighbours that are alike, which filtered measurements show. One more adds
up attempts, ten and thirty at a time: what lasts for a block makes its sum scatter more, however
little of each innovation it is (a velocity that wanders, beneath the noise of pings).

All of this takes innovations for independent. Those that share common errors are not; of them the
residuals come here that `kernels.sins.shared` leaves, and their covariance.
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
ACROSS = 13  # ... innovation across track per its horizontal length, from -1 to 1
GATE = 14  # ... innovation as the gate judges it, per sigma, grid axes (3)
GATE_SQUARE = 17  # ... the square of that along, across, up (3)
SUMS = 20  # columns of such sums; from here on cumulative log likelihood ratios
GRID_RISE = 20  # ... of a shift along the grid axes, to either side (3 x 2)
TRACK_RISE = 26  # ... along track, across, up (3 x 2)
NOISE_RISE = 32  # ... of a larger scatter
CALM_RISE = 33  # ... of a smaller scatter
ALIKE_RISE = 34  # ... of neighbours that are alike
LAST = 35  # the innovation before, whitened and limited (3)
BLOCK = 38  # sum of those since a block began (3)
BLOCK_NUMBER = 41  # attempts in it
BLOCK_SQUARE = 42  # sum of their squares
BLOCK_RISE = 43  # cumulative log likelihood ratio of blocks whose sums scatter more
WIDTH = 44

LIMIT = 4.0
"""Sigmas beyond which an innovation counts as that many."""
SHIFTS = (0.8, 0.25)
"""Shift [sigma] that the sums beside each memory look for."""
NOISES = (2.0, 1.3)
"""Ratio of variances that they look for."""
CALMS = (0.35, 0.5)
"""Ratio of variances of a smaller scatter."""
ALIKE = (0.5, 0.2)
"""Correlation of neighbours that they look for."""
RISE_LIMIT = 2.0
"""Sigmas, and NIS per degree of freedom over 2, beyond which they count an innovation as that."""
BLOCKS = (10.0, 30.0)
"""Attempts that are added up."""
BLOCK_NOISE = 2.0
"""Ratio of variances of such a sum that they look for."""
MOST_RISE = 40.0
"""Largest sum: one that has ended is forgotten."""


@kernel
def limited(x: float, limit: float) -> float:
    """The number, brought into [-limit, limit]."""
    return min(max(x, -limit), limit)


@kernel
def limited_rise(x: float) -> float:
    """The sum, held between 0 and `MOST_RISE`."""
    return min(max(x, 0.0), MOST_RISE)


@kernel
def rise(row: Array, at: int, x: float, shift: float) -> None:
    """Add an innovation per sigma to the sums for a shift up (at) and down (at + 1)."""
    gain = shift * limited(x, RISE_LIMIT)
    half = 0.5 * shift * shift
    row[at] = limited_rise(row[at] + gain - half)
    row[at + 1] = limited_rise(row[at + 1] - gain - half)


@kernel
def per_sigma(
    z: Array, S: Array, m: int, c: float, s: float
) -> tuple[float, float, float, float, float]:
    """Innovation per sigma, limited: grid east, north, up, along track, across.

    The track has the direction (c, s); a depth (m = 1) has its value up only.
    """
    if m == 1:
        return 0.0, 0.0, limited(z[0] / math.sqrt(S[0, 0]), LIMIT), 0.0, 0.0
    east = limited(z[0] / math.sqrt(S[0, 0]), LIMIT)
    north = limited(z[1] / math.sqrt(S[1, 1]), LIMIT)
    up = limited(z[2] / math.sqrt(S[2, 2]), LIMIT)
    variance = c * c * S[0, 0] + 2.0 * c * s * S[0, 1] + s * s * S[1, 1]
    along = limited((c * z[0] + s * z[1]) / math.sqrt(max(variance, 1e-300)), LIMIT)
    variance = s * s * S[0, 0] - 2.0 * c * s * S[0, 1] + c * c * S[1, 1]
    across = limited((c * z[1] - s * z[0]) / math.sqrt(max(variance, 1e-300)), LIMIT)
    return east, north, up, along, across


@kernel
def likeness(row: Array, z: Array, S: Array, m: int, rho: float) -> float:
    """Log likelihood ratio of a correlation rho with the innovation before; keeps this one.

    Of innovations whitened by the factor of S, m rows, so that their axes are independent.
    """
    rest = 1.0 - rho * rho
    l00 = math.sqrt(S[0, 0])
    l10 = l11 = l20 = l21 = l22 = 0.0
    if m > 1:
        l10 = S[1, 0] / l00
        l11 = math.sqrt(max(S[1, 1] - l10 * l10, 1e-300))
    if m > 2:
        l20 = S[2, 0] / l00
        l21 = (S[2, 1] - l20 * l10) / l11
        l22 = math.sqrt(max(S[2, 2] - l20 * l20 - l21 * l21, 1e-300))
    x = y = w = 0.0
    total = 0.0
    for a in range(m):
        if a == 0:
            x = z[0] / l00
            value = x
        elif a == 1:
            y = (z[1] - l10 * x) / l11
            value = y
        else:
            w = (z[2] - l20 * x - l21 * y) / l22
            value = w
        value = limited(value, RISE_LIMIT)
        off = value - rho * row[LAST + a]
        total += 0.5 * (value * value - off * off / rest - math.log(rest))
        row[LAST + a] = value
    return total


@kernel
def add_to_block(row: Array, m: int, length: float) -> None:
    """Add the innovation that `likeness` kept to its block; a full one is judged.

    By the scatter of its own innovations, where that is more than stated: it is another fault.
    """
    for a in range(m):
        row[BLOCK + a] += row[LAST + a]
        row[BLOCK_SQUARE] += row[LAST + a] * row[LAST + a]
    row[BLOCK_NUMBER] += 1.0
    if row[BLOCK_NUMBER] < length:
        return
    square = 0.0
    for a in range(m):
        square += row[BLOCK + a] * row[BLOCK + a] / row[BLOCK_NUMBER]
        row[BLOCK + a] = 0.0
    scatter = max(1.0, row[BLOCK_SQUARE] / (m * row[BLOCK_NUMBER]))
    row[BLOCK_NUMBER] = row[BLOCK_SQUARE] = 0.0
    square = min(square / scatter, m * LIMIT * LIMIT)
    more = 0.5 * (square * (1.0 - 1.0 / BLOCK_NOISE) - m * math.log(BLOCK_NOISE))
    row[BLOCK_RISE] = limited_rise(row[BLOCK_RISE] + more)


@kernel
def observe(
    memories: Array,
    z: Array,
    S: Array,
    nis: float,
    m: int,
    fused: bool,
    v_x: float,
    v_y: float,
    z_gate: Array,
    S_gate: Array,
) -> None:
    """Add an attempt to both memories of a stream.

    Parameters
    ----------
    memories : (MEMORIES, WIDTH) array, in place
    z, S : (3,), (3, 3)
        Innovation (estimate minus measurement, grid axes; a depth: up in z[0]) and covariance:
        of independent attempts.
    nis : float
        z^T S^-1 z of the first m rows.
    m : int
        Rows: 3, or 1 for a depth.
    fused : bool
        Whether the gate let it pass.
    v_x, v_y : float
        Velocity along grid east and north [m/s]: the track; below 0.05 m/s grid axes stand in.
    z_gate, S_gate : (3,), (3, 3)
        Innovation and covariance by which the gate judged it, common errors in both.
    """
    speed = math.sqrt(v_x * v_x + v_y * v_y)
    c, s = 1.0, 0.0
    if speed > 0.05:
        c = v_x / speed
        s = v_y / speed
    east, north, up, along, across = per_sigma(z, S, m, c, s)
    g_east, g_north, g_up, g_along, g_across = per_sigma(z_gate, S_gate, m, c, s)
    side = 0.0
    if m > 1:
        length = math.sqrt(max(z_gate[0] * z_gate[0] + z_gate[1] * z_gate[1], 1e-300))
        side = (c * z_gate[1] - s * z_gate[0]) / length
    ratio = min(nis / m, LIMIT * LIMIT)
    calm = min(ratio, 2.0 * RISE_LIMIT)
    for k in range(MEMORIES):
        keep = math.exp(-1.0 / LENGTHS[k])
        row = memories[k]
        for j in range(SUMS):
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
        row[ACROSS] += side
        row[GATE] += g_east
        row[GATE + 1] += g_north
        row[GATE + 2] += g_up
        row[GATE_SQUARE] += g_along * g_along
        row[GATE_SQUARE + 1] += g_across * g_across
        row[GATE_SQUARE + 2] += g_up * g_up
        if m > 1:
            rise(row, GRID_RISE, east, SHIFTS[k])
            rise(row, GRID_RISE + 2, north, SHIFTS[k])
            rise(row, TRACK_RISE, along, SHIFTS[k])
            rise(row, TRACK_RISE + 2, across, SHIFTS[k])
        rise(row, GRID_RISE + 4, up, SHIFTS[k])
        rise(row, TRACK_RISE + 4, up, SHIFTS[k])
        more = 0.5 * m * (calm * (1.0 - 1.0 / NOISES[k]) - math.log(NOISES[k]))
        row[NOISE_RISE] = limited_rise(row[NOISE_RISE] + more)
        less = 0.5 * m * (ratio * (1.0 - 1.0 / CALMS[k]) - math.log(CALMS[k]))
        row[CALM_RISE] = limited_rise(row[CALM_RISE] + less)
        alike = likeness(row, z, S, m, ALIKE[k])
        row[ALIKE_RISE] = limited_rise(row[ALIKE_RISE] + alike)
        add_to_block(row, m, BLOCKS[k])
