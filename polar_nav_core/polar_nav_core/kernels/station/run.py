"""Streams of measurements through the filter of station mode in their total order.

Equations: docs/derivations/station.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from ..queues import earlier, is_before
from ..sins.state import NEVER_NS
from . import state as ss
from .common import add_common
from .depth import depth_event
from .fix import fix_event
from .obey import add_doubt
from .signatures import advance_signatures, clear_signatures
from .state import Bank, Log, Rows, Settings, Streams, Work
from .step import imu_event, lever_arm, locate, to_station, turned

SECOND_NS = 1_000_000_000
"""How often a state is tested in full."""


@kernel
def copy_rows(out: Array, of: Array) -> None:
    """Copy an array (rows, columns) from ``of`` to ``out``."""
    for i in range(of.shape[0]):
        for j in range(of.shape[1]):
            out[i, j] = of[i, j]


@kernel
def copy_tables(out: Array, of: Array) -> None:
    """Copy an array (tables, rows, columns) from ``of`` to ``out``."""
    for i in range(of.shape[0]):
        copy_rows(out[i], of[i])


@entry
@kernel
def take_snapshot(b: Bank, log: Log) -> None:
    """Store a copy of the bank as the newest snapshot."""
    n = log.x.shape[0]
    if n == 0:
        return
    i = log.counts[0] % n
    for m in range(b.x.shape[0]):
        log.log_weight[i, m] = b.log_weight[m]
        log.weight[i, m] = b.weight[m]
        for j in range(ss.N):
            log.x[i, m, j] = b.x[m, j]
            for k in range(ss.N):
                log.P[i, m, j, k] = b.P[m, j, k]
            for k in range(ss.COMMON):
                log.S[i, m, j, k] = b.S[m, j, k]
    copy_tables(log.memories[i], b.memories)
    copy_tables(log.signatures[i], b.signatures)
    for j in range(ss.FLAT):
        log.flat[i, j] = b.flat[j]
    for j in range(ss.LOOSE):
        log.loose[i, j] = b.loose[j]
    for j in range(ss.COUNTERS):
        log.counters[i, j] = b.counters[j]
    log.counts[0] += 1


@entry
@routine
def restore(b: Bank, log: Log, number: int) -> None:
    """Replace the bank by a stored snapshot and forget the snapshots after it."""
    i = number % log.x.shape[0]
    for m in range(b.x.shape[0]):
        b.log_weight[m] = log.log_weight[i, m]
        b.weight[m] = log.weight[i, m]
        for j in range(ss.N):
            b.x[m, j] = log.x[i, m, j]
            for k in range(ss.N):
                b.P[m, j, k] = log.P[i, m, j, k]
            for k in range(ss.COMMON):
                b.S[m, j, k] = log.S[i, m, j, k]
    copy_tables(b.memories, log.memories[i])
    copy_tables(b.signatures, log.signatures[i])
    for j in range(ss.FLAT):
        b.flat[j] = log.flat[i, j]
    for j in range(ss.LOOSE):
        b.loose[j] = log.loose[i, j]
    for j in range(ss.COUNTERS):
        b.counters[j] = log.counters[i, j]
    log.counts[0] = number + 1


@kernel
def _is_covariance(P: Array, L: Array, published: bool) -> bool:
    """Whether P has a Cholesky factor, left in L; states without variance are left out."""
    n = ss.DYNAMIC if published else ss.N
    for i in range(n):
        unknown = i == ss.STATION and P[i, i] == 0.0
        for j in range(i + 1):
            s = P[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if unknown:
                L[i, j] = 0.0
            elif i > j:
                L[i, j] = s / L[j, j]
            elif s > 0.0 and s < math.inf:
                L[i, i] = math.sqrt(s)
            else:
                return False
    return True


@kernel
def _keep(b: Bank, c: Settings, w: Work, log: Log) -> bool:
    """Store the bank as the newest sound state if it is one; else False."""
    good = log.good
    for m in range(b.x.shape[0]):
        if not _is_covariance(b.P[m], w.L, c.published):
            return False
    for m in range(b.x.shape[0]):
        good.log_weight[m] = b.log_weight[m]
        good.weight[m] = b.weight[m]
        for j in range(ss.N):
            good.x[m, j] = b.x[m, j]
            for k in range(ss.N):
                good.P[m, j, k] = b.P[m, j, k]
    for j in range(ss.FLAT):
        good.flat[j] = b.flat[j]
    for j in range(ss.COUNTERS):
        good.counters[j] = b.counters[j]
    return True


@entry
@routine
def healthy(b: Bank, c: Settings) -> bool:
    """Whether all variances are positive and finite, and the weights of the members finite."""
    for m in range(b.x.shape[0]):
        if not b.weight[m] <= 1.0:
            return False
        for i in range(ss.DYNAMIC if c.published else ss.STATION):
            v = b.P[m, i, i]
            if not (v > 0.0 and v < math.inf and abs(b.x[m, i]) < math.inf):
                return False
    return True


@kernel
def _next_measurement(b: Bank, streams: Streams) -> tuple[int, int]:
    """Stamp [ns] and rank of the next measurement, IMU samples included; NEVER_NS: none waits."""
    counts, taken = streams.counts, b.counters
    at, rank = NEVER_NS, ss.IMU_RANK
    at, rank = earlier(at, rank, streams.imu_stamps, taken[ss.IMU], counts[0], rank)
    at, rank = earlier(
        at, rank, streams.control_stamps, taken[ss.CONTROL], counts[1], ss.CONTROL_RANK
    )
    at, rank = earlier(at, rank, streams.depth_stamps, taken[ss.DEPTH], counts[2], ss.DEPTH_RANK)
    return earlier(at, rank, streams.fix_stamps, taken[ss.FIX], counts[3], ss.FIX_RANK)


@kernel
def _apply_control(b: Bank, streams: Streams) -> None:
    """Change the thrust to that of the next control sample."""
    i = b.counters[ss.CONTROL]
    b.counters[ss.THRUST_NS] = streams.control_stamps[i % streams.force_b.shape[0]]
    for k in range(3):
        b.flat[ss.FORCE + k] = streams.force_b[i % streams.force_b.shape[0], k]
    b.counters[ss.CONTROL] = i + 1


@entry
@routine
def advance(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    log: Log,
    until_ns: int,
    until_rank: int,
    frozen: bool,
    rows: Rows,
) -> int:
    """Process all before (until_ns, until_rank); returns a code for why processing stopped.

    Parameters
    ----------
    frozen : bool
        Filter stored inputs again with the slopes and decisions of the first time.

    Returns
    -------
    int
        DONE; FULL when there is no more room for output (call again with room); NOT_DEFINITE.
    """
    while True:
        stamp, rank = _next_measurement(b, streams)
        if stamp == NEVER_NS or not is_before(stamp, rank, until_ns, until_rank):
            return ss.DONE
        if 0 <= rows.io[0] < stamp:
            if rows.io[1] >= rows.stamps.shape[0]:
                return ss.FULL
            put_row(b, c, w, streams, rows)
        if rank == ss.IMU_RANK:
            before = b.counters[ss.STAMP]
            place = log.points[b.counters[ss.IMU] % log.points.shape[0]]
            imu_event(b, c, w, streams, log.points, log.jumps, log.tape, frozen)
            advance_signatures(b, c, w, place, stamp)
            if rows.stamps.shape[0] > 0 and stamp // c.output_ns != before // c.output_ns:
                rows.io[0] = stamp
            if not healthy(b, c):
                return ss.NOT_DEFINITE
            if stamp // SECOND_NS != before // SECOND_NS and not _keep(b, c, w, log):
                return ss.NOT_DEFINITE
            if b.counters[ss.IMU] % c.snapshot_every == 0:
                take_snapshot(b, log)
        elif rank == ss.CONTROL_RANK:
            _apply_control(b, streams)
        elif rank == ss.DEPTH_RANK:
            depth_event(b, c, w, streams, log.jumps, log.tape)
        else:
            fix_event(b, c, w, streams, log.jumps, log.tape, stamp, frozen)
            if not healthy(b, c):
                return ss.NOT_DEFINITE


@entry
@routine
def put_row(b: Bank, c: Settings, w: Work, streams: Streams, rows: Rows) -> None:
    """Write the estimate that is due: the bank's mixture, matched in mean and covariance.

    With what the common errors add to the covariance.
    """
    k = rows.io[1]
    members = b.x.shape[0]
    x = rows.x[k]
    P = rows.P_x[k]
    for i in range(ss.N):
        x[i] = 0.0
        for m in range(members):
            x[i] += b.weight[m] * b.x[m, i]
    for i in range(ss.N):
        for j in range(i + 1):
            s = 0.0
            for m in range(members):
                s += b.weight[m] * (b.P[m, i, j] + (b.x[m, i] - x[i]) * (b.x[m, j] - x[j]))
            P[i, j] = s
            P[j, i] = s
    q = 0.0
    for m in range(members):
        q += b.weight[m] * c.q_current[m]
        rows.weight[k, m] = b.weight[m]
    rows.walk[k] = q
    rows.stamps[k] = b.counters[ss.STAMP]
    for a in range(2):
        for j in range(3):
            rows.tally[k, a, j] = b.tally[a, j]
            b.tally[a, j] = 0.0
    if c.published:
        relate_to_water(b, w, streams, x, P)
    else:
        if c.shares:
            add_common(P, b, c, w)
        to_station(w.C_A, streams.C_b_G[(b.counters[ss.IMU] - 1) % streams.imu_stamps.shape[0]], b)
        turned(w.R, w.C_A, x[ss.HEADING])
        add_doubt(P, x, b, w)
    fill_navigation(b, c, w, streams, x, P, rows.r_e[k], rows.v_G[k], rows.C_b_G[k], rows.P[k])
    rows.io[0] = -1
    rows.io[1] += 1


@kernel
def relate_to_water(b: Bank, w: Work, streams: Streams, x: Array, P: Array) -> None:
    """Replace v of the published state by v_r = v - R^T V; P is NaN where not estimated."""
    to_station(w.C_A, streams.C_b_G[(b.counters[ss.IMU] - 1) % streams.imu_stamps.shape[0]], b)
    for i in range(3):
        x[i] -= w.C_A[0, i] * x[ss.CURRENT] + w.C_A[1, i] * x[ss.CURRENT + 1]
    for i in range(ss.N):
        for j in range(ss.N):
            if i >= ss.DYNAMIC or j >= ss.DYNAMIC:
                P[i, j] = math.nan


@kernel
def fill_navigation(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    x: Array,
    P_x: Array,
    r_e: Array,
    v_G: Array,
    C_b_G: Array,
    P: Array,
) -> None:
    """Position (ECEF), velocity and attitude (grid axes) of the state x, with their covariance P.

    P (9, 9): errors of attitude, velocity (grid axes) and position (ECEF), estimate minus truth.
    """
    lever_arm(
        b, w, streams, b.counters[ss.IMU] - 1, c.lever_fix_b
    )  # for the attitude at the newest sample
    turned(w.R, w.C_A, x[ss.HEADING])
    for i in range(3):
        w.v3[i] = w.R[i, 0] * x[0] + w.R[i, 1] * x[1] + w.R[i, 2] * x[2]
        r_e[i] = c.origin_e[i]
        for j in range(3):
            r_e[i] += c.C_e_A[j, i] * x[ss.POSITION + j]
    T = w.T
    for i in range(6):
        for j in range(ss.N):
            T[i, j] = 0.0
    axes = b.flat[ss.AXES : ss.AXES + 9]  # C_A_G
    for i in range(3):
        v_G[i] = 0.0
        for j in range(3):
            C_b_G[i, j] = 0.0
            v_G[i] += axes[3 * i + j] * w.v3[j]
            for k in range(3):
                C_b_G[i, j] += axes[3 * i + k] * w.R[k, j]
            T[i, j] = C_b_G[i, j]
            T[3 + i, ss.POSITION + j] = c.C_e_A[j, i]
        for j in range(2):
            v_G[i] += axes[3 * i + j] * x[ss.CURRENT + j]
            T[i, ss.CURRENT + j] = axes[3 * i + j]
        T[i, ss.HEADING] = axes[3 * i] * w.v3[1] - axes[3 * i + 1] * w.v3[0]
    states = ss.DYNAMIC if c.published else ss.N
    for i in range(6):
        for j in range(states):
            s = 0.0
            for k in range(states):
                s += T[i, k] * P_x[k, j]
            w.TP[i, j] = s
    for i in range(6):
        for j in range(i + 1):
            s = 0.0
            for k in range(states):
                s += w.TP[i, k] * T[j, k]
            P[3 + i, 3 + j] = s
            P[3 + j, 3 + i] = s
    variance = attitude_variance(b, c, streams)
    add_attitude(P, v_G, variance)
    for i in range(6):
        for j in range(3):
            P[3 + i, j] = 0.0
            P[j, 3 + i] = 0.0
        if not c.published:  # what lasts of the attitude's error is the heading's bias
            P[3 + i, 2] = w.TP[i, ss.HEADING]
            P[2, 3 + i] = P[3 + i, 2]
    for i in range(3):
        for j in range(3):
            P[i, j] = variance if i == j else 0.0
    if not c.published:
        P[2, 2] += P_x[ss.HEADING, ss.HEADING]


@kernel
def attitude_variance(b: Bank, c: Settings, streams: Streams) -> float:
    """White error of the smoothed attitude, per axis [rad^2]."""
    if c.attitude_tau <= 0.0 or b.counters[ss.IMU] < 2:
        return c.attitude_variance
    n = streams.imu_stamps.shape[0]
    i = b.counters[ss.IMU] - 1
    dt = (streams.imu_stamps[i % n] - streams.imu_stamps[(i - 1) % n]) * 1e-9
    share: float = max(dt / (2.0 * c.attitude_tau + dt), 1.0 / (i + 1.0))
    return c.attitude_variance * share


@kernel
def add_attitude(P: Array, v_G: Array, variance: float) -> None:
    """Add the white attitude error to the covariance of velocity: variance (v^2 I - v v^T)."""
    square = v_G[0] * v_G[0] + v_G[1] * v_G[1] + v_G[2] * v_G[2]
    for i in range(3):
        P[3 + i, 3 + i] += variance * square
        for j in range(3):
            P[3 + i, 3 + j] -= variance * v_G[i] * v_G[j]


@entry
@routine
def start(b: Bank, c: Settings, w: Work, log: Log) -> None:
    """Fill place and axes of a new state and store the first snapshot."""
    locate(b, b.x, c, w)
    clear_signatures(b)
    log.counts[0] = 0
    take_snapshot(b, log)
    _keep(b, c, w, log)
