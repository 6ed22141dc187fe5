"""Streams of measurements through the filter in their total order: the engine's compiled loop."""

from __future__ import annotations

from . import filter_state as fs
from .cache import kernel, routine
from .filter import N
from .filter_aiding import control_event, has_bottom_lock
from .filter_events import depth_event, dvl_event, fix_event, imu_event
from .filter_fuse import locate
from .filter_model import E
from .filter_state import Frames, Log, Past, Rows, Settings, State, Streams, Work

_NEVER = 9_223_372_036_854_775_807


@kernel
def _process(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    streams: Streams,
    until_ns: int,
    until_rank: int,
    rows: Rows,
) -> int:
    """Process events as `advance` says; the frames of the state are left behind."""
    while True:
        i = s.counters[fs.IMU]
        e = s.counters[fs.DEPTH]
        d = s.counters[fs.DVL]
        f = s.counters[fs.FIX]
        u = s.counters[fs.CONTROL]
        stamp = _NEVER
        rank = 0
        if i < streams.counts[0]:
            stamp = streams.imu_stamps[i % streams.imu_stamps.shape[0]]
        if u < streams.counts[4]:
            other = streams.control_stamps[u % streams.control_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = 1
        if e < streams.counts[1]:
            other = streams.depth_stamps[e % streams.depth_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = 2
        if d < streams.counts[2]:
            other = streams.dvl_stamps[d % streams.dvl_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = 3
        if f < streams.counts[3]:
            other = streams.fix_stamps[f % streams.fix_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = 4
        if stamp > until_ns or (stamp == until_ns and rank >= until_rank) or stamp == _NEVER:
            return fs.DONE
        if 0 <= rows.io[0] < stamp:
            if rows.io[1] >= rows.stamps.shape[0]:
                return fs.FULL
            put_row(s, c, rows)
        if rank == 0:
            k = i % streams.imu_stamps.shape[0]
            before = s.counters[fs.STAMP]
            code = imu_event(s, c, past, w, log, stamp, streams.omega_ib_b[k], streams.f_b[k])
            if rows.stamps.shape[0] > 0 and stamp // c.output_ns != before // c.output_ns:
                rows.io[0] = stamp
        elif rank == 1:
            k = u % streams.control_stamps.shape[0]
            control_event(s, stamp, streams.control_force_b[k])
            code = fs.DONE
        elif rank == 2:
            k = e % streams.depth_stamps.shape[0]
            code = depth_event(s, fr, c, past, w, log, streams.depth[k], streams.depth_variance[k])
        elif rank == 3:
            k = d % streams.dvl_stamps.shape[0]
            code = dvl_event(
                s, fr, c, past, w, log, streams.dvl_v_m[k], streams.dvl_covariance_m[k]
            )
        else:
            k = f % streams.fix_stamps.shape[0]
            code = fix_event(
                s,
                fr,
                c,
                past,
                w,
                log,
                stamp,
                streams.fix_r_e[k],
                streams.fix_covariance_e[k],
                streams.fix_array_heading[k],
                streams.fix_outcomes[k],
            )
        if code < 0:
            return code


@routine
def advance(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    streams: Streams,
    until_ns: int,
    until_rank: int,
    rows: Rows,
) -> int:
    """Process what has come and stands before (until_ns, until_rank) in the total order.

    Ranks within a stamp: IMU 0, control 1, depth 2, DVL 3, fix 4 (events.Rank).

    Returns
    -------
    int
        DONE; FULL when there is no more room for output (call again with room); P_NOT_DEFINITE
        or S_NOT_DEFINITE, with the state as it was then.
    """
    code = _process(s, fr, c, past, w, log, streams, until_ns, until_rank, rows)
    locate(s, fr, c)
    return code


@routine
def put_row(s: State, c: Settings, rows: Rows) -> None:
    """Write the estimate that is due."""
    k = rows.io[1]
    rows.stamps[k] = s.counters[fs.STAMP]
    for j in range(fs.NAVIGATION):
        rows.flat[k, j] = s.flat[j]
    for a in range(N):
        for b in range(N):
            rows.P[k, a, b] = s.P[a, b]
    if c.aiding.on:
        s.model[fs.THRUST, fs.LOCKED] = 1.0 if has_bottom_lock(s, c) else 0.0
        for r in range(fs.MODEL_ROWS):
            for j in range(E):
                rows.flat[k, fs.NAVIGATION + r * E + j] = s.model[r, j]
    for a in range(3):
        for b in range(3):
            rows.tally[k, a, b] = s.tally[a, b]
            s.tally[a, b] = 0.0
    rows.io[0] = -1
    rows.io[1] += 1


@routine
def restore(s: State, fr: Frames, c: Settings, log: Log, number: int) -> None:
    """Go back to a snapshot; those after it are forgotten."""
    i = number % log.snapshot_flat.shape[0]
    for k in range(fs.FLAT):
        s.flat[k] = log.snapshot_flat[i, k]
    for k in range(fs.COUNTERS):
        s.counters[k] = log.snapshot_counters[i, k]
    for r in range(s.model.shape[0]):
        for k in range(E):
            s.model[r, k] = log.snapshot_flat[i, fs.FLAT + r * E + k]
    log.counts[1] = number + 1
    locate(s, fr, c)
