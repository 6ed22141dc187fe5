"""Streams of measurements through the filter in their total order: the engine's compiled loop.

`advance` is what Python calls; each kind of measurement has a kernel that fills its rows, and one
call of `fuse_rows` takes them all.
"""

from __future__ import annotations

from ..cache import apart, entry, kernel, routine
from ..queues import earlier, is_before
from . import state as fs
from .aiding import (
    control_event,
    count_good_ping,
    fuse_water_ping,
    has_bottom_lock,
)
from .bridge import bridge, bridge_to_sample, is_gap
from .columns import describe
from .consider import add_common, add_common_blocks, add_conflict, fix_common
from .events import hold_to_ping, imu_event, note_outcome
from .fill import add_held_to_ping
from .fuse import correct_and_remember, fuse_rows, locate
from .heading import heading_event
from .hidden import leave_out_leader
from .hindsight import is_held
from .judge import ping_passes
from .late import OUT_OF_REACH, fill_late_fix
from .measured import consider_leader, fill_depth, fill_dvl, fill_fix
from .model import E
from .output import Rows
from .planned import refusal_stops, take_decision
from .rings import Log, Past, Streams
from .settings import Settings
from .state import Frames, State
from .work import Work


@kernel
def _next_measurement(s: State, streams: Streams) -> tuple[int, int]:
    """Stamp [ns] and rank of the next measurement but IMU samples; NEVER_NS when none waits.

    Within a stamp the order is control, depth, DVL, heading, fix.
    """
    counts, taken = streams.counts, s.counters
    at, rank = fs.NEVER_NS, fs.CONTROL_RANK
    at, rank = earlier(at, rank, streams.control_stamps, taken[fs.CONTROL], counts[4], rank)
    at, rank = earlier(at, rank, streams.depth_stamps, taken[fs.DEPTH], counts[1], fs.DEPTH_RANK)
    at, rank = earlier(at, rank, streams.dvl_stamps, taken[fs.DVL], counts[2], fs.DVL_RANK)
    at, rank = earlier(
        at, rank, streams.heading_stamps, taken[fs.HEADING], counts[5], fs.HEADING_RANK
    )
    return earlier(at, rank, streams.fix_stamps, taken[fs.FIX], counts[3], fs.FIX_RANK)


@kernel
def _write_due(s: State, c: Settings, rows: Rows, stamp: int) -> bool:
    """Write the output that is due before a stamp; False when there is no room for it."""
    if 0 <= rows.io[0] < stamp:
        if rows.io[1] >= rows.stamps.shape[0]:
            return False
        put_row(s, c, rows)
    return True


@kernel
def _imu_until(
    s: State,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    streams: Streams,
    last_ns: int,
    rows: Rows,
) -> int:
    """Process all IMU samples up to a stamp; DONE, FULL, or the negative code of a failed step."""
    room = streams.imu_stamps.shape[0]
    left = streams.counts[0] - s.counters[fs.IMU]
    k = s.counters[fs.IMU] % room
    while left > 0 and streams.imu_stamps[k] <= last_ns:
        now = streams.imu_stamps[k]
        if not _write_due(s, c, rows, now):
            return fs.FULL
        if is_gap(s, c, now):
            bridge_to_sample(s, c, past, w, log, now)  # a failure shows in the step to come
        code = imu_event(s, c, past, w, log, now, streams.omega_ib_b[k], streams.f_b[k])
        if now >= rows.io[2]:
            rows.io[0] = now
            rows.io[2] = (now // c.output_ns + 1) * c.output_ns
        if code < 0:
            return code
        left -= 1
        k += 1
        if k == room:
            k = 0
    return fs.DONE


@kernel
def _apply_control(s: State, streams: Streams, stamp: int) -> None:
    """Change the thrust to that of the next control sample."""
    k = s.counters[fs.CONTROL] % streams.control_stamps.shape[0]
    control_event(s, stamp, streams.control_force_b[k])


@kernel
def _fuse_next_heading(
    s: State, c: Settings, past: Past, w: Work, log: Log, streams: Streams
) -> int:
    """Fuse the next heading; returns the code of its update."""
    k = s.counters[fs.HEADING] % streams.heading_stamps.shape[0]
    s.counters[fs.HEADING] += 1
    heading, up_b = streams.headings[k], streams.heading_up_b[k]
    code: int = heading_event(s, c, past, w, log, streams.heading_stamps[k], heading, up_b)
    return code


@kernel
def _fill_next_depth(s: State, fr: Frames, c: Settings, w: Work, streams: Streams) -> int:
    """Fill the rows of the next depth into the scratch; returns their number."""
    k = s.counters[fs.DEPTH] % streams.depth_stamps.shape[0]
    s.counters[fs.DEPTH] += 1
    fill_depth(s, fr, c, w, streams.depth[k], streams.depth_variance[k])
    return fs.SCALAR


@kernel
def _fill_next_ping(
    s: State, fr: Frames, c: Settings, past: Past, w: Work, log: Log, streams: Streams
) -> int:
    """Fill the rows of the next ping into the scratch; returns their number, or a code below zero.

    With a vehicle's model, the first pings after a loss of bottom lock are only watched: then
    there are no rows to fuse. Nor are there of a velocity through the water: it is fused here, and
    only without lock.

    A state that is held to a track is linearized at the velocity of that track.
    """
    k = s.counters[fs.DVL] % streams.dvl_stamps.shape[0]
    s.counters[fs.DVL] += 1
    if streams.dvl_water[k] == 1:
        if c.aiding.on and not has_bottom_lock(s, c):
            code = fuse_water_ping(s, fr, c, w, streams.dvl_v_m[k], streams.dvl_covariance_m[k])
            if code < 0:
                return code
            if code == fs.FUSED:
                correct_and_remember(s, c, past, w.C_e_G, w.x)
        return fs.NO_MEASUREMENT
    fill_dvl(s, fr, c, w, streams.dvl_v_m[k], streams.dvl_covariance_m[k], is_held(log))
    add_held_to_ping(s, w.R)
    if c.aiding.on and not has_bottom_lock(s, c):
        code = ping_passes(s, c, w)
        if code < 0:
            return code
        if not count_good_ping(s, c, code == fs.FUSED):
            s.tally[fs.DVL_ROW, fs.GATED] += float(s.counting[0])
            return fs.NO_MEASUREMENT
    return fs.VECTOR


@kernel
def _fill_next_fix(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    streams: Streams,
    stamp: int,
    rows: Rows,
) -> int:
    """Fill the rows of the next fix into the scratch; returns their number, or STOPPED.

    Late fixes of `back_propagate` are referred to now; others are valid at their place. STOPPED
    is for a fix older than the stored past, which stays the next one.
    """
    k = s.counters[fs.FIX] % streams.fix_stamps.shape[0]
    r_e, covariance_e = streams.fix_r_e[k], streams.fix_covariance_e[k]
    heading, relative_e = streams.fix_array_heading[k], streams.fix_relative_e[k]
    common_e = streams.fix_common_e[k]
    w.dof[0] = streams.fix_dof[k]
    steps = 0
    if c.back_propagates:
        validity_ns = streams.fix_validities[k]
        steps = fill_late_fix(s, fr, c, past, w, validity_ns, r_e, covariance_e, heading, common_e)
        consider_leader(s, c, common_e)
        if s.counters[fs.CONSIDERS] == 1:
            fix_common(w.J, fr.C_e_G, relative_e, s.v_G, common_e)
        if steps == OUT_OF_REACH:
            return fs.STOPPED
    else:
        fill_fix(s, fr, c, w, stamp, r_e, covariance_e, heading, relative_e, common_e)
    s.counters[fs.FIX] += 1
    streams.fix_notes[k, 0] = steps
    streams.fix_notes[k, 1] = s.counters[fs.STAMP]
    streams.fix_notes[k, 2] = rows.io[1]
    return fs.VECTOR


@kernel
def _note_fix(s: State, c: Settings, w: Work, log: Log, streams: Streams, code: int) -> int:
    """Store the outcome of the newest fix; returns its code, STOPPED where a refusal stops."""
    k = (s.counters[fs.FIX] - 1) % streams.fix_stamps.shape[0]
    note_outcome(s, w, code, streams.fix_outcomes[k])
    if code == fs.REFUSED and refusal_stops(c, log):
        return fs.STOPPED
    return code


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
    """Process the events up to a place; returns as `advance`, with the frames not up to date."""
    while True:
        stamp, rank = _next_measurement(s, streams)
        # IMU samples up to there: the first of their stamps.
        last_ns = min(stamp, until_ns if until_rank > fs.IMU_RANK else until_ns - 1)
        code = _imu_until(s, c, past, w, log, streams, last_ns, rows)
        if code < 0:
            return code
        if stamp == fs.NEVER_NS or not is_before(stamp, rank, until_ns, until_rank):
            return fs.DONE
        if not _write_due(s, c, rows, stamp):
            return fs.FULL
        if rank == fs.CONTROL_RANK:
            _apply_control(s, streams, stamp)
            continue
        if is_gap(s, c, stamp):
            bridge(s, c, past, w, log, stamp)  # a failure shows in S, or in the step to come
        elif rank == fs.DVL_RANK:
            code = hold_to_ping(s, c, past, w, log, stamp)
            if code < 0:
                return code
        if rank == fs.HEADING_RANK:
            code = _fuse_next_heading(s, c, past, w, log, streams)
            if code < 0:
                return code
            continue
        locate(s, fr, c)
        if rank == fs.DEPTH_RANK:
            stream, m = fs.DEPTH_ROW, _fill_next_depth(s, fr, c, w, streams)
        elif rank == fs.DVL_RANK:
            stream, m = fs.DVL_ROW, _fill_next_ping(s, fr, c, past, w, log, streams)
        else:
            take_decision(s, log, streams)
            stream, m = fs.FIX_ROW, _fill_next_fix(s, fr, c, past, w, streams, stamp, rows)
        if m < 0:
            return m
        if m == fs.NO_MEASUREMENT:
            continue
        # One call for all: what it compiles to is long.
        code = fuse_rows(s, c, past, w, log, m, stream, rank)
        if rank == fs.DVL_RANK and code == fs.FUSED:
            s.counters[fs.LOCK_NS] = s.counters[fs.STAMP]
        elif rank == fs.FIX_RANK:
            code = _note_fix(s, c, w, log, streams, code)
        if code < 0:
            return code


@entry
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
    """Process all before (until_ns, until_rank); returns a code for why processing stopped.

    Ranks within a stamp: events.Rank.

    Parameters
    ----------
    s, fr, past, log : in place
        State, what follows from it, the stored past and the order of linear steps.
    c : Settings
    w : Work
        Scratch.
    streams : Streams
        Measurements; the outcomes of fixes are written into it.
    until_ns, until_rank : int
        Where to stop in the total order [ns], [-].
    rows : Rows
        Takes the estimates that are due.

    Returns
    -------
    int
        DONE; FULL when there is no more room for output (call again with room); STOPPED after a
        late fix that the gate refused, and before one that is out of reach, which the caller has
        to answer; P_NOT_DEFINITE or S_NOT_DEFINITE, with the state as it was then.
    """
    code: int = run_until(s, fr, c, past, w, log, streams, until_ns, until_rank, rows)
    return code


@apart
@routine
def run_until(
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
    """`advance`, for kernels: those that call it are compiled beside it and not after it."""
    code = _process(s, fr, c, past, w, log, streams, until_ns, until_rank, rows)
    locate(s, fr, c)
    return code


@entry
@routine
def put_row(s: State, c: Settings, rows: Rows) -> None:
    """Write the estimate that is due to the next row of output."""
    k = rows.io[1]
    rows.stamps[k] = s.counters[fs.STAMP]
    for j in range(fs.NAVIGATION):
        rows.flat[k, j] = s.flat[j]
    total = rows.P[k] if rows.P.shape[0] > 0 else rows.total
    n = total.shape[0]
    for a in range(n):
        for b in range(n):
            total[a, b] = s.P[a, b]
    if s.counters[fs.CONSIDERS] == 1:
        if rows.P.shape[0] > 0:
            add_common(total, s.sensitivity, c.common, rows.columns)
        else:  # nothing else is described
            add_common_blocks(total, s.sensitivity, c.common)
    add_conflict(total, s.conflict)
    if c.shares_leader or c.heading.on:
        leave_out_leader(total, rows.flat[k])
    if rows.P.shape[0] == 0:
        describe(s.r_e, s.C_b_G, total, rows.derived[k], rows.scratch)
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


@entry
@routine
def restore(s: State, log: Log, number: int) -> None:
    """Replace the state by a stored snapshot and forget the snapshots after it."""
    i = number % log.snapshot_flat.shape[0]
    for k in range(fs.FLAT):
        s.flat[k] = log.snapshot_flat[i, k]
    for k in range(fs.COUNTERS):
        s.counters[k] = log.snapshot_counters[i, k]
    for r in range(s.model.shape[0]):
        for k in range(E):
            s.model[r, k] = log.snapshot_flat[i, fs.FLAT + r * E + k]
    log.counts[1] = number + 1
