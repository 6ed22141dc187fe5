"""Pings refused in a row keep the filter from running away: noise of the IMU above the stated one.

With an IMU far worse than stated (vibration, another class than the parameters name) the error
outgrows the covariance between two pings, every ping is refused, and nothing else holds the
velocity. So pings that are refused in a row and agree with one another are believed, as often as
it takes, while no position fix vouches for the inertial navigation. Each time the covariance is
enlarged by what the innovation needs, and the variance of the IMU's noise by STEP. From then on
that noise follows the NIS of the DVL (of depths where there is none), up and down, until it is the
stated one again.
"""

from __future__ import annotations

import math

from .. import watch
from ..cache import kernel
from . import state as fs
from .gap import MOST_HEADING, MOST_TILT
from .reopen import (
    LEAST,
    MOST,
    POSITION,
    VELOCITY,
    VOUCHED_NS,
    agrees,
    note_opening,
    square_of,
)
from .settings import Settings
from .state import State
from .update import N
from .work import Work

FEWEST = 10.0
"""Refused in a row that agree, before they are believed."""
LEAST_NS = 2_000_000_000
"""Time that they take at least."""
JUMP, RATE = 0.5, 2.0
"""Two velocities [m/s] or heights [m] that follow each other agree within this, and within this
per second between them: faster than a vehicle, slower than outliers."""
BREAK_S = 5.0
"""After so long without one there is no row."""
FEW_FIXES = 5
"""Fewer fixes ever used vouch only until a gate may open, Settings.reopen_ns."""
STEP = 9.0
"""Factor on the variance of the IMU's noise, each time."""
GAIN = 0.02
"""Of the logarithm of that variance, per ping and NIS per row above 1 + LEAK."""
LEAK = 0.1
LIMIT = 4.0
"""NIS per row that one ping counts for at most."""
MOST_GYRO, MOST_ACCEL = 0.02, 0.5
"""Sigmas [rad/s], [m/s^2] up to which biases are made uncertain; gap: the attitude's."""
NUMBER, VALUE = 0, 1
"""Columns of State.runs."""
GYRO, ACCEL, OTHERS = 9, 12, 15
"""First states of a kind."""


@kernel
def follow(s: State, c: Settings, w: Work, stream: int, m: int, fused: bool) -> None:
    """Count a judged measurement in its row of refused ones; raised IMU noise follows its NIS."""
    run = s.runs[stream]
    if fused:
        run[NUMBER] = 0.0
    else:
        now_ns = s.counters[fs.STAMP]
        dt = (now_ns - s.counters[fs.REFUSED_NS + stream]) * 1e-9
        limit = JUMP + RATE * dt
        if m == fs.SCALAR:
            limit += abs(s.v_G[2]) * dt
        square = 0.0
        for k in range(m):
            value = s.v_G[k] - w.z[k] if m == fs.VECTOR else w.z[k]
            square += (value - run[VALUE + k]) * (value - run[VALUE + k])
            run[VALUE + k] = value
        if run[NUMBER] == 0.0 or dt > BREAK_S or not square <= limit * limit:
            run[NUMBER] = 0.0
            s.counters[fs.RUN_NS + stream] = now_ns
        run[NUMBER] += 1.0
        s.counters[fs.REFUSED_NS + stream] = now_ns
    alone = s.memories[fs.DVL_ROW, watch.SHORT, watch.WEIGHT] == 0.0
    if s.excess[0] > 0.0 and (stream == fs.DVL_ROW or alone):
        change = GAIN * (min(w.nis[0] / m, LIMIT) - 1.0 - LEAK)
        _raise_noise(s, c, math.exp(change))


@kernel
def _raise_noise(s: State, c: Settings, factor: float) -> None:
    """Change the variance of the IMU's noise by a factor, within the limits."""
    s.excess[0] = min(max((1.0 + s.excess[0]) * factor - 1.0, 0.0), c.most_excess)


@kernel
def runs_away(s: State, c: Settings, stream: int) -> bool:
    """Whether a row of refused measurements is long enough to be used, with nothing against it."""
    length_ns = s.counters[fs.STAMP] - s.counters[fs.RUN_NS + stream]
    if s.runs[stream, NUMBER] < FEWEST or length_ns < LEAST_NS:
        return False
    # A depth knows nothing of the horizontal velocity, and a DVL that is used holds the vertical.
    if stream == fs.DEPTH_ROW and s.excess[0] == 0.0 and agrees(s, fs.DVL_ROW):
        return False
    # No fix yet: the first ones may be under way, and no IMU noise has been raised.
    if s.memories[fs.FIX_ROW, watch.SHORT, watch.WEIGHT] == 0.0 and s.excess[0] == 0.0:
        return bool(s.counters[fs.STAMP] - s.counters[fs.OPENED_NS + stream] > c.reopen_ns)
    if not agrees(s, fs.FIX_ROW):
        return True
    since_ns = s.counters[fs.STAMP] - s.counters[fs.USED_NS + fs.FIX_ROW]
    few = s.counters[fs.USES + fs.FIX_ROW] < FEW_FIXES and length_ns > c.reopen_ns
    return bool(since_ns > VOUCHED_NS or few)


@kernel
def open_wide(s: State, c: Settings, w: Work, stream: int, m: int, again: int) -> None:
    """Enlarge P for a refused measurement, and the IMU's noise; ``again`` is 1 if that failed.

    At first P <- D P D: correlations stay, so that the next pings correct tilt and biases. What
    the position may have lost in the row is added to it. Then the innovation itself is.
    """
    square = square_of(w, m)
    if again == 1:
        first = VELOCITY if m == fs.VECTOR else POSITION
        for k in range(first, first + 3):
            s.P[k, k] += square
        return
    root = math.sqrt(min(max(w.nis[0] / m, LEAST), MOST))
    for i in range(OTHERS):
        if POSITION <= i < GYRO:
            continue
        most = math.inf
        if i < 3:
            most = MOST_TILT if i < 2 else MOST_HEADING
        elif i >= GYRO:
            most = MOST_GYRO if i < ACCEL else MOST_ACCEL
        d = max(1.0, min(root, most / math.sqrt(s.P[i, i])))
        for j in range(N):
            s.P[i, j] *= d
        for j in range(N):
            s.P[j, i] *= d
        if c.aiding.on:
            for j in range(s.model.shape[1]):
                s.model[fs.P_XE + i, j] *= d
    if m == fs.VECTOR:
        length = (s.counters[fs.STAMP] - s.counters[fs.RUN_NS + stream]) * 1e-9
        for k in range(POSITION, GYRO):
            s.P[k, k] += square * length * length / 3.0
    _raise_noise(s, c, STEP)
    s.runs[stream, NUMBER] = 0.0
    note_opening(s, stream)
