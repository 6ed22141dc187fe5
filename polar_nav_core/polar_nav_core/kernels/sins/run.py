"""Streams of measurements through the filter in their total order: the engine's compiled loop."""

from __future__ import annotations

from ..cache import kernel, routine
from . import state as fs
from .aiding import control_event, count_good_ping, has_bottom_lock, model_is_definite
from .columns import describe
from .events import fill_depth, fill_dvl, fill_fix, imu_event, note_outcome
from .fuse import fuse_rows, locate, ping_passes
from .late import OUT_OF_REACH, fill_late_fix
from .model import E
from .state import Frames, Log, Past, Rows, Settings, State, Streams, Work
from .update import N, is_positive_definite


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
    imu_room = streams.imu_stamps.shape[0]
    while True:
        # The next measurement; within a stamp the ranks decide: control, depth, DVL, fix.
        e = s.counters[fs.DEPTH]
        d = s.counters[fs.DVL]
        f = s.counters[fs.FIX]
        u = s.counters[fs.CONTROL]
        stamp = fs.NEVER_NS
        rank = fs.FIX_RANK
        if u < streams.counts[4]:
            stamp = streams.control_stamps[u % streams.control_stamps.shape[0]]
            rank = fs.CONTROL_RANK
        if e < streams.counts[1]:
            other = streams.depth_stamps[e % streams.depth_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = fs.DEPTH_RANK
        if d < streams.counts[2]:
            other = streams.dvl_stamps[d % streams.dvl_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = fs.DVL_RANK
        if f < streams.counts[3]:
            other = streams.fix_stamps[f % streams.fix_stamps.shape[0]]
            if other < stamp:
                stamp = other
                rank = fs.FIX_RANK
        # IMU samples up to there: the first of their stamps.
        last = min(stamp, until_ns if until_rank > fs.IMU_RANK else until_ns - 1)
        left = streams.counts[0] - s.counters[fs.IMU]
        k = s.counters[fs.IMU] % imu_room
        while left > 0 and streams.imu_stamps[k] <= last:
            now = streams.imu_stamps[k]
            if 0 <= rows.io[0] < now:
                if rows.io[1] >= rows.stamps.shape[0]:
                    return fs.FULL
                put_row(s, c, rows)
            code = imu_event(s, c, past, w, log, now, streams.omega_ib_b[k], streams.f_b[k])
            if now >= rows.io[2]:
                rows.io[0] = now
                rows.io[2] = (now // c.output_ns + 1) * c.output_ns
            if code < 0:
                return code
            left -= 1
            k += 1
            if k == imu_room:
                k = 0
        if stamp > until_ns or (stamp == until_ns and rank >= until_rank) or stamp == fs.NEVER_NS:
            return fs.DONE
        if 0 <= rows.io[0] < stamp:
            if rows.io[1] >= rows.stamps.shape[0]:
                return fs.FULL
            put_row(s, c, rows)
        if rank == fs.CONTROL_RANK:
            k = u % streams.control_stamps.shape[0]
            control_event(s, stamp, streams.control_force_b[k])
            continue
        locate(s, fr, c)
        if rank == fs.DEPTH_RANK:
            s.counters[fs.DEPTH] += 1
            k = e % streams.depth_stamps.shape[0]
            fill_depth(s, fr, c, w, streams.depth[k], streams.depth_variance[k])
            m, row = fs.SCALAR, fs.DEPTH_ROW
        elif rank == fs.DVL_RANK:
            s.counters[fs.DVL] += 1
            k = d % streams.dvl_stamps.shape[0]
            fill_dvl(s, fr, c, w, streams.dvl_v_m[k], streams.dvl_covariance_m[k])
            m, row = fs.VECTOR, fs.DVL_ROW
            if c.aiding.on and not has_bottom_lock(s, c):
                # After a loss of lock the first pings are only watched.
                code = ping_passes(s, c, w)
                if code < 0:
                    return code
                if not count_good_ping(s, c, code == fs.FUSED):
                    s.tally[fs.DVL_ROW, fs.GATED] += float(s.counting[0])
                    continue
        else:
            k = f % streams.fix_stamps.shape[0]
            steps = 0
            if c.back_propagates:
                steps = fill_late_fix(
                    s,
                    fr,
                    c,
                    past,
                    w,
                    streams.fix_validities[k],
                    streams.fix_r_e[k],
                    streams.fix_covariance_e[k],
                    streams.fix_array_heading[k],
                )
                if steps == OUT_OF_REACH:
                    return fs.STOPPED
            else:
                fill_fix(
                    s,
                    fr,
                    c,
                    w,
                    stamp,
                    streams.fix_r_e[k],
                    streams.fix_covariance_e[k],
                    streams.fix_array_heading[k],
                )
            s.counters[fs.FIX] += 1
            streams.fix_notes[k, 0] = steps
            streams.fix_notes[k, 1] = s.counters[fs.STAMP]
            streams.fix_notes[k, 2] = rows.io[1]
            m, row = fs.VECTOR, fs.FIX_ROW
        code = fuse_rows(s, c, past, w, log, m, row, rank)
        if rank == fs.DVL_RANK and code == fs.FUSED:
            s.counters[fs.LOCK_NS] = s.counters[fs.STAMP]
        if rank == fs.FIX_RANK:
            note_outcome(w, code, streams.fix_outcomes[k])
            if c.back_propagates and code == fs.REFUSED:
                return fs.STOPPED
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
        DONE; FULL when there is no more room for output (call again with room); STOPPED after a
        late fix that the gate refused, and before one that is out of reach, which the caller has
        to answer; P_NOT_DEFINITE or S_NOT_DEFINITE, with the state as it was then.
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
    if rows.P.shape[0] > 0:
        for a in range(N):
            for b in range(N):
                rows.P[k, a, b] = s.P[a, b]
    else:
        describe(s.r_e, s.C_b_G, s.P, rows.told[k], rows.scratch)
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
def process_again(
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
    snapshot: int,
) -> int:
    """Go back to a snapshot (-1: to none) and `advance`; nothing is counted a second time."""
    if snapshot >= 0:
        _restore(s, log, snapshot)
    s.counting[0] = 0
    code = advance(s, fr, c, past, w, log, streams, until_ns, until_rank, rows)
    s.counting[0] = 1
    if code == fs.DONE:
        good = is_positive_definite(s.P, c.active, w.LP)
        if good and c.aiding.on:
            good = model_is_definite(s, c, w, True)
        if not good:
            return fs.P_NOT_DEFINITE
    return code


@kernel
def _restore(s: State, log: Log, number: int) -> None:
    """Put a snapshot into place; those after it are forgotten."""
    i = number % log.snapshot_flat.shape[0]
    for k in range(fs.FLAT):
        s.flat[k] = log.snapshot_flat[i, k]
    for k in range(fs.COUNTERS):
        s.counters[k] = log.snapshot_counters[i, k]
    for r in range(s.model.shape[0]):
        for k in range(E):
            s.model[r, k] = log.snapshot_flat[i, fs.FLAT + r * E + k]
    log.counts[1] = number + 1
