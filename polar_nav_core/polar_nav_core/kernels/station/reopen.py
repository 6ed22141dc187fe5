"""Gate that opens again for refused fixes which have agreed with one another for long.

A vehicle without DVL whose water turns round, whose thruster dies or that somebody holds is not
where its model says; then the gate refuses every fix, for good, because the error grows faster
than the covariance. The station stays where it is and its fixes are the only aid, so nothing can
vouch for the model against them: fixes that were refused in a row, for long enough and to the
same side, are believed. The covariance of velocity, position and current grows by the NIS per
row; what is known of drag and heading is kept, for a fault of the moment says little of them.

A first refused fix that lies farther off than the vehicle can have come since the one before, and
farther than noise reaches, is no matter of its model: fixes have jumped (a mirrored bearing, a
slot of the range), or the stated place of the station has. Then the position alone moves there,
with the variance of the offset. A velocity that took its share of such a jump would carry the
vehicle away, for long after the fixes are back.

Fixes refused to changing sides never open it: those are outliers.
"""

from __future__ import annotations

import math

from ...arrays import Array
from .. import watch
from ..cache import kernel
from . import state as ss
from .signatures import clear_signatures
from .state import Bank, Settings, Work

FEWEST = 8
"""Fixes refused in a row before a gate may open: of 30 % of outliers, 1 of 15,000."""
AGREEMENT = 0.7
"""Length of the mean of their directions."""
LEAST, MOST = 2.0, 100.0
"""Limits of the factor on the covariance."""
NOISE = 4.0
"""A jump is longer than the farthest way by so many sigma of the innovation."""
MOST_LEAP = 1e6
"""Longest way to a fix [m]: the longest acoustic range."""
SAME = 0.5
"""Share of the first offset that must be left at the opening: a jump stays."""
BACK = 0.5
"""Share of a way that may be left of all of them where it leads back."""
ENLARGED = ss.DRAG
"""States before this one are enlarged: velocity, position, current."""


@kernel
def metric(z: Array, S: Array, outcome: Array) -> None:
    """Innovation of a fix along x and y and its covariance from its row of outcomes.

    ``z`` (3,) is estimate less measurement [m]; the vertical is 0 with variance 1.
    """
    c = math.cos(outcome[ss.AZIMUTH])
    s = math.sin(outcome[ss.AZIMUTH])
    d = outcome[ss.DISTANCE]
    z[0] = -(c * outcome[ss.Z0] - d * s * outcome[ss.Z1])
    z[1] = -(s * outcome[ss.Z0] + d * c * outcome[ss.Z1])
    z[2] = 0.0
    s00 = outcome[ss.S00]
    s01 = d * outcome[ss.S01]
    s11 = d * d * outcome[ss.S11]
    for i in range(3):
        for j in range(3):
            S[i, j] = 0.0
    S[0, 0] = c * c * s00 - 2.0 * c * s * s01 + s * s * s11
    S[0, 1] = c * s * (s00 - s11) + (c * c - s * s) * s01
    S[1, 0] = S[0, 1]
    S[1, 1] = s * s * s00 + 2.0 * c * s * s01 + c * c * s11
    S[2, 2] = 1.0


@kernel
def _leaps(b: Bank, c: Settings, w: Work, length: float, since_s: float) -> bool:
    """Whether an offset ``w.z3`` of a length [m] is no matter of the model: see above.

    ``since_s``: time since the fix before, which was used.
    """
    if not (b.loose[ss.NEWEST_S] > 0.0 and since_s > 0.0 and length > 0.0):
        return False
    x = w.z3[0] / length
    y = w.z3[1] / length
    square = x * x * w.S3[0, 0] + 2.0 * x * y * w.S3[0, 1] + y * y * w.S3[1, 1]
    reach = c.max_speed * since_s + NOISE * math.sqrt(max(square, 0.0))
    far: bool = reach < length <= MOST_LEAP
    return far


@kernel
def opens(b: Bank, c: Settings, w: Work, outcome: Array, stamp: int) -> bool:
    """Whether this refused fix is the one that opens the gate; counts it."""
    if b.counters[ss.RUN] == 0:
        b.counters[ss.RUN_NS] = stamp
        b.flat[ss.SIDE] = 0.0
        b.flat[ss.SIDE + 1] = 0.0
    b.counters[ss.RUN] += 1
    metric(w.z3, w.S3, outcome)
    length = math.sqrt(w.z3[0] * w.z3[0] + w.z3[1] * w.z3[1])
    if b.counters[ss.RUN] == 1:
        leaps = _leaps(b, c, w, length, stamp * 1e-9 - b.loose[ss.NEWEST_S])
        for k in range(2):  # measured less expected
            b.counters[ss.LEAP_MM + k] = -int(1e3 * w.z3[k]) if leaps else 0
    if length > 0.0:
        b.flat[ss.SIDE] += w.z3[0] / length
        b.flat[ss.SIDE + 1] += w.z3[1] / length
    n = b.counters[ss.RUN]
    if c.reopen_ns == 0 or n < FEWEST or stamp - b.counters[ss.RUN_NS] < c.reopen_ns:
        return False
    x = b.flat[ss.SIDE]
    y = b.flat[ss.SIDE + 1]
    agree: bool = x * x + y * y > AGREEMENT * AGREEMENT * n * n
    return agree


@kernel
def enlarge(b: Bank, factor: float) -> None:
    """P <- D P D with D the root of the factor for velocity, position and current, else 1."""
    root = math.sqrt(factor)
    for m in range(b.x.shape[0]):
        P = b.P[m]
        for i in range(ss.N):
            for j in range(ss.N):
                if i < ENLARGED:
                    P[i, j] *= root
                if j < ENLARGED:
                    P[i, j] *= root


@kernel
def _jump(b: Bank, outcome: Array, jumps: Array) -> None:
    """Move the position by a jump, with the variance of its length.

    Moved, for rows of range and bearing at the old place say little of one so far away. ``jumps``
    is a log of corrections, or empty.
    """
    for m in range(b.x.shape[0]):
        for k in range(2):
            shift = outcome[ss.FOLLOWED + k]
            b.x[m, ss.POSITION + k] += shift
            b.P[m, ss.POSITION + k, ss.POSITION + k] -= outcome[ss.OPENING]
            if jumps.shape[0] > 0:
                jumps[(b.counters[ss.IMU] - 1) % jumps.shape[0], m, ss.POSITION + k] += shift


@kernel
def _follow(b: Bank, x: float, y: float) -> None:
    """Add a way [m] to fixes to the sum of those that the estimate has followed.

    One that leads back ends them all: what is left is noise and the model's drift.
    """
    sum_x = b.counters[ss.FOLLOWED_MM] + 1e3 * x
    sum_y = b.counters[ss.FOLLOWED_MM + 1] + 1e3 * y
    back = sum_x * sum_x + sum_y * sum_y < BACK * BACK * 1e6 * (x * x + y * y)
    b.counters[ss.FOLLOWED_MM] = 0 if back else int(sum_x)
    b.counters[ss.FOLLOWED_MM + 1] = 0 if back else int(sum_y)
    if back:
        b.counters[ss.JUMPED] = 0


@kernel
def _follow_opened(b: Bank, w: Work) -> None:
    """Count a fused fix that leads to where the gate was opened; ``w.z3``: its innovation [m]."""
    x, y = 1e-3 * b.counters[ss.OPENED_MM], 1e-3 * b.counters[ss.OPENED_MM + 1]
    along = -(x * w.z3[0] + y * w.z3[1])  # measured less expected
    if along > SAME * (x * x + y * y):
        _follow(b, x, y)
    b.counters[ss.OPENED_MM] = 0
    b.counters[ss.OPENED_MM + 1] = 0


@kernel
def open_gate(b: Bank, w: Work, outcome: Array, jumps: Array, stamp: int, may_jump: bool) -> None:
    """Enlarge the covariance by the NIS per row of a fix, or follow a jump where one may.

    The count of refused ones goes on: where that was not enough, the next fix opens it again.
    ``w.z3`` is as `opens` left it, ``jumps`` as for `_jump`.
    """
    d, a = outcome[ss.DISTANCE], outcome[ss.AZIMUTH]
    further, turned = d + outcome[ss.Z0], a + outcome[ss.Z1]
    x = further * math.cos(turned) - d * math.cos(a)
    y = further * math.sin(turned) - d * math.sin(a)
    leap, now = 0.0, 0.0
    for k in range(2):
        first = 1e-3 * b.counters[ss.LEAP_MM + k]
        leap += first * first
        now += w.z3[k] * w.z3[k]
        b.counters[ss.LEAP_MM + k] = 0
    far = may_jump and leap > 0.0 and now > SAME * SAME * leap
    length = math.hypot(x, y)
    short = min(1.0, MOST_LEAP / length) if length > 0.0 else 1.0
    outcome[ss.FOLLOWED] = short * x
    outcome[ss.FOLLOWED + 1] = short * y
    if far and length <= MOST_LEAP:
        outcome[ss.OPENING] = -(x * x + y * y)
    else:
        outcome[ss.OPENING] = min(max(0.5 * outcome[ss.NIS], LEAST), MOST)
    open_again(b, outcome, jumps, stamp)


@kernel
def open_again(b: Bank, outcome: Array, jumps: Array, stamp: int) -> None:
    """Enlarge the covariance, or follow a jump, as stored with a fix that keeps its decision."""
    x, y = outcome[ss.FOLLOWED], outcome[ss.FOLLOWED + 1]
    if outcome[ss.OPENING] < 0.0:
        _jump(b, outcome, jumps)
        b.counters[ss.JUMPED] = 1
        _follow(b, x, y)
    else:
        enlarge(b, outcome[ss.OPENING])
        b.counters[ss.OPENED_MM] = int(1e3 * x)
        b.counters[ss.OPENED_MM + 1] = int(1e3 * y)
    clear_signatures(b)
    b.counters[ss.OPENED_NS] = stamp
    b.counters[ss.OPENINGS] += 1


@kernel
def note(b: Bank, w: Work, outcome: Array, v_x: float, v_y: float) -> None:
    """Count a decided fix: in the memories of innovations, and where it ends refusals in a row.

    ``v_x``, ``v_y``: velocity through the water, station axes: where the thruster points.
    """
    fused = outcome[ss.DECIDED] == ss.FUSED
    if fused:
        b.counters[ss.RUN] = 0
    metric(w.z3, w.S3, outcome)
    if fused and (b.counters[ss.OPENED_MM] != 0 or b.counters[ss.OPENED_MM + 1] != 0):
        _follow_opened(b, w)
    if w.S3[0, 0] > 0.0 and w.S3[1, 1] > 0.0 and outcome[ss.NIS] >= 0.0:
        nis = outcome[ss.NIS]
        memories = b.memories[ss.FIX_ROW]
        watch.observe(memories, w.z3, w.S3, nis, 2, fused, v_x, v_y, w.z3, w.S3)
