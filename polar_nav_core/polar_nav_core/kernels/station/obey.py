"""A vehicle that does not obey its model: found by its fixes, and answered with a looser model.

A dead thruster, a vehicle that is held or a current that turns round gives innovations that lie to
one side and grow. Their vectors, whitened, are summed (multivariate cumulative sum, Crosier 1988):

    s <- (s + u) (1 - k / |s + u|), or 0 within k,     |u| limited,

and beyond the threshold the model is loosened: position and current get the variance of the way
and the velocity that the model has not explained, the current a further random walk that lets the
fixes make the velocity, and drag, which says nothing of such a fault, stays as it was (a Schmidt
state). The further walk dies out while fixes agree. What the model said of the velocity *through*
the water is doubted as long: `add_doubt`. Slow faults are found by the sums of `kernels.watch`.
"""

from __future__ import annotations

import math

from ...arrays import Array
from .. import watch
from ..cache import kernel
from . import state as ss
from .state import Bank, Settings, Work

ALLOWANCE = 0.75
"""k: half the shift that is looked for [sigma]."""
MOST_LENGTH = 2.0
"""Limit of |u| [sigma]: an outlier is one fix among others."""
AGREES = 1.0
"""A fix within so many sigma halves the sum: a model that is wrong has none."""
LONGEST_S, SHORTEST_S = 60.0, 10.0
"""The unexplained way took as long as the sum has grown, within these limits [s]."""
LASTS_S = 60.0
"""A velocity that the model does not explain changes in about this time [s]."""
FORGET_S = 200.0
"""Time constant with which the further walk dies out [s]."""
SLOW = 15.0
"""Log likelihood ratio of a slow fault (kernels.watch), as for fixes in the strapdown mode."""
LEAST, MOST = 1e-4, 0.1
"""Limits of the further density [m^2/s^3]; below the first it ends."""
DRAG_SIGMA = 0.3
"""1-sigma that ln of the drag gets once: the fault may have misled it before it was found."""


@kernel
def _contradicted(b: Bank, c: Settings, w: Work, outcome: Array, stamp_s: float) -> float:
    """Seconds since which fixes lie to one side, if evidence says so; else 0.

    ``w`` holds innovation z3 and covariance S3 as `reopen.metric` left them. A fix that the gate
    refused says nothing here: those are left to `reopen`.
    """
    if outcome[ss.DECIDED] != ss.FUSED or not (w.S3[0, 0] > 0.0 and w.S3[1, 1] > 0.0):
        return 0.0
    loose = b.loose
    l00 = math.sqrt(w.S3[0, 0])
    l10 = w.S3[0, 1] / l00
    u0 = w.z3[0] / l00
    u1 = (w.z3[1] - l10 * u0) / math.sqrt(w.S3[1, 1] - l10 * l10)
    length = math.sqrt(u0 * u0 + u1 * u1)
    if not length < math.inf:
        return 0.0
    if length > MOST_LENGTH:
        u0 *= MOST_LENGTH / length
        u1 *= MOST_LENGTH / length
    if loose[ss.SUM_X] == 0.0 and loose[ss.SUM_Y] == 0.0:
        loose[ss.SINCE_S] = stamp_s
    s0 = loose[ss.SUM_X] + u0
    s1 = loose[ss.SUM_Y] + u1
    size = math.sqrt(s0 * s0 + s1 * s1)
    keep = max(0.0, 1.0 - ALLOWANCE / size) if size > 0.0 else 0.0
    if length < AGREES:
        keep *= 0.5
    loose[ss.SUM_X] = s0 * keep
    loose[ss.SUM_Y] = s1 * keep
    if 2.0 * ALLOWANCE * size * keep > c.doubt:
        loose[ss.SUM_X] = 0.0
        loose[ss.SUM_Y] = 0.0
        lasted_s: float = min(max(stamp_s - loose[ss.SINCE_S], SHORTEST_S), LONGEST_S)
        return lasted_s
    row = b.memories[ss.FIX_ROW, watch.SHORT]
    largest = 0.0
    for k in range(4):
        largest = max(largest, row[watch.GRID_RISE + k], row[watch.TRACK_RISE + k])
    if largest > SLOW:
        for k in range(4):
            row[watch.GRID_RISE + k] = 0.0
            row[watch.TRACK_RISE + k] = 0.0
        return LONGEST_S
    return 0.0


@kernel
def _loosen(b: Bank, square: float, lasted_s: float, stamp: int) -> None:
    """Add an unexplained way [m^2] and its velocity to the covariance; count it."""
    for m in range(b.x.shape[0]):
        P = b.P[m]
        for k in range(2):
            P[ss.POSITION + k, ss.POSITION + k] += square
            P[ss.CURRENT + k, ss.CURRENT + k] += square / (lasted_s * lasted_s)
        if b.loose[ss.EXTRA] == 0.0:
            P[ss.DRAG, ss.DRAG] += DRAG_SIGMA * DRAG_SIGMA
    b.counters[ss.LOOSENED] += 1
    b.counters[ss.LOOSENED_NS] = stamp


@kernel
def obey(b: Bank, c: Settings, w: Work, outcome: Array, stamp: int, kept: bool) -> None:
    """Weigh the evidence of a decided fix against the model, and loosen it where it is wrong.

    Where ``kept``, what was done at its first time is done again.
    """
    if c.doubt <= 0.0:
        return
    stamp_s = stamp * 1e-9
    lasted_s = _contradicted(b, c, w, outcome, stamp_s)
    loose = b.loose
    if kept:
        if outcome[ss.WAY] > 0.0:
            _loosen(b, outcome[ss.WAY], outcome[ss.LASTED_S], stamp)
        loose[ss.EXTRA] = outcome[ss.FURTHER]
        return
    outcome[ss.WAY] = 0.0
    if loose[ss.EXTRA] > 0.0:
        since_s = max(0.0, stamp_s - loose[ss.NEWEST_S])
        loose[ss.EXTRA] *= math.exp(-since_s / FORGET_S)
        if loose[ss.EXTRA] < LEAST:
            loose[ss.EXTRA] = 0.0
    if lasted_s > 0.0:
        square = w.z3[0] * w.z3[0] + w.z3[1] * w.z3[1]
        outcome[ss.WAY] = square
        outcome[ss.LASTED_S] = lasted_s
        _loosen(b, square, lasted_s, stamp)
        further = max(square / (lasted_s * lasted_s * LASTS_S), 2.0 * loose[ss.EXTRA])
        loose[ss.EXTRA] = min(max(further, 2.0 * LEAST), MOST)
    loose[ss.NEWEST_S] = stamp_s
    outcome[ss.FURTHER] = loose[ss.EXTRA]


@kernel
def add_doubt(P: Array, x: Array, b: Bank, w: Work) -> None:
    """P <- P + u u^T (12, 12): the velocity through the water may be none, the current all.

    Velocity over ground stays as sure as it is. ``w.R`` is the attitude without the heading's
    bias.
    """
    if b.loose[ss.EXTRA] == 0.0:
        return
    R, v, u = w.R, w.v3, w.point
    for i in range(2):
        v[i] = R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2]
    for i in range(ss.N):
        u[i] = 0.0
    for j in range(3):
        u[j] = R[0, j] * v[0] + R[1, j] * v[1]
    for j in range(2):
        u[ss.CURRENT + j] = -v[j]
    for i in range(ss.N):
        for j in range(ss.N):
            P[i, j] += u[i] * u[j]
