"""Filter that is run once more for a smoother: held to a track, its decisions imposed.

Held to a track, the state is set to that track at each of its stamps, and between them it moves by
the IMU. What is linearized there is exact where the track is; corrections do not move the state,
they are summed up as its estimated error, the deviation. Equations:
docs/derivations/smoother.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from . import rings
from . import state as fs
from .rings import Log, Past
from .state import State
from .update import (
    ACCEL,
    COUPLED,
    DR,
    DV,
    GYRO,
    MARKOV,
    NAV,
    SCALE,
    USBL,
    N,
    feed_back,
    gain_of,
)
from .work import Work


@kernel
def is_held(log: Log) -> bool:
    """Whether the state is held to a track."""
    held: bool = log.hindsight.stamps.shape[0] > 0
    return held


@kernel
def decision(s: State, log: Log, stream: int) -> int:
    """BY_GATE, TO_FUSE or TO_REFUSE for the measurement at hand of a stream."""
    h = log.hindsight
    if stream == fs.FIX_ROW:
        imposed: int = h.fix[0]
        return imposed
    imposed = rings.BY_GATE
    if stream == fs.DVL_ROW and h.dvl.shape[0] > 0:
        imposed = h.dvl[s.counters[fs.DVL] - 1]
    elif stream == fs.DEPTH_ROW and h.depth.shape[0] > 0:
        imposed = h.depth[s.counters[fs.DEPTH] - 1]
    return imposed


@kernel
def sample_of(s: State, log: Log, rank: int) -> int:
    """Number of the measurement at hand in its stream; of a fix as its driver counts."""
    if rank == fs.FIX_RANK:
        number: int = log.hindsight.fix[1]
        return number
    place = fs.HEADING
    if rank == fs.DEPTH_RANK:
        place = fs.DEPTH
    elif rank == fs.DVL_RANK:
        place = fs.DVL
    return int(s.counters[place] - 1)


@kernel
def subtract_deviation(log: Log, w: Work, m: int) -> None:
    """Subtract H deviation from z, that of the held state: the innovation of the estimate."""
    x = log.hindsight.deviation
    for a in range(m):
        for k in range(N):
            h = w.H[a, k]
            if h != 0.0:
                w.z[a] -= h * x[k]


@kernel
def pass_over(s: State, past: Past) -> None:
    """Count a correction of nothing."""
    i = s.counters[fs.CORRECTIONS] % past.corrections.shape[0]
    for k in range(N):
        past.corrections[i, k] = 0.0
    past.correction_steps[i] = s.counters[fs.STEPS]
    s.counters[fs.CORRECTIONS] += 1


@kernel
def add_to_deviation(log: Log, w: Work) -> None:
    """Add the correction of the last update to the estimated error of the held state."""
    for k in range(N):
        log.hindsight.deviation[k] += w.x[k]


@kernel
def gain_of_refused(w: Work, m: int) -> None:
    """Gain that a judged measurement would have had, into the scratch; its correction is zero."""
    gain_of(w.K, w.D, w.PHt, w.L, w.S, m)
    for k in range(N):
        w.x[k] = 0.0


@kernel
def carry_deviation(log: Log, Phi: Array, moved: Array) -> None:
    """Deviation <- Phi deviation, over a covariance step. ``moved`` is scratch (24,)."""
    x = log.hindsight.deviation
    for i in range(NAV):
        moved[i] = 0.0
        for j in range(COUPLED):
            moved[i] += Phi[i, j] * x[j]
    for i in range(NAV, N):
        moved[i] = Phi[i, i] * x[i]
    for i in range(N):
        x[i] = moved[i]


@kernel
def _turn_between(C: Array, onto: Array, x: Array) -> None:
    """Write the rotation vector (3,) that turns C onto another attitude: onto = exp([x x]) C."""
    trace = 0.0
    for i in range(3):
        x[i] = 0.0
        for j in range(3):
            trace += onto[i, j] * C[i, j]
    for j in range(3):
        x[0] += 0.5 * (onto[2, j] * C[1, j] - onto[1, j] * C[2, j])
        x[1] += 0.5 * (onto[0, j] * C[2, j] - onto[2, j] * C[0, j])
        x[2] += 0.5 * (onto[1, j] * C[0, j] - onto[0, j] * C[1, j])
    sine = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    if sine > 1e-8:
        times = math.atan2(sine, 0.5 * (trace - 1.0)) / sine
        for i in range(3):
            x[i] *= times


@entry
@routine
def hold(s: State, log: Log, x: Array) -> None:
    """Set the state to the track if that has its stamp; the deviation follows. x is scratch (24,).

    The track is passed in order: of a stamp that is not on it, nothing is changed.
    """
    h = log.hindsight
    place = h.place[0]
    while place < h.stamps.shape[0] and h.stamps[place] < s.counters[fs.STAMP]:
        place += 1
    h.place[0] = place
    if place == h.stamps.shape[0] or h.stamps[place] != s.counters[fs.STAMP]:
        return
    row = h.states[place]
    _turn_between(s.C_b_G, row[:9].reshape((3, 3)), x)
    for k in range(3):
        x[DV + k] = s.v_G[k] - row[9 + k]
        x[DR + k] = s.r_e[k] - row[12 + k]
        x[GYRO + k] = row[15 + k] - s.b_gyro_b[k]
        x[ACCEL + k] = row[18 + k] - s.b_accel_b[k]
        x[SCALE + k] = row[21 + k] - s.dvl_scale_m[k]
        x[MARKOV + k] = row[24 + k] - s.dvl_markov_m[k]
        x[USBL + k] = row[27 + k] - s.usbl_bias_a[k]
    for k in range(N):
        h.deviation[k] -= x[k]
    feed_back(
        x,
        s.C_b_G,
        s.v_G,
        s.r_e,
        s.b_gyro_b,
        s.b_accel_b,
        s.dvl_scale_m,
        s.dvl_markov_m,
        s.usbl_bias_a,
    )
