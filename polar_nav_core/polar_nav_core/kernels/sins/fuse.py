"""Fusion of one measurement: judged, update, feedback, and the stored past.

A sensor whose refused measurements agree gets another chance here (`reopen`, `runaway`).
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import apart, entry, kernel, routine
from . import rings
from . import state as fs
from .aiding import correct_block, fill_block_gain, store_block_rows
from .bend import add_bend_of_carried_ping, add_bend_of_correction, add_bend_of_ping
from .carried import note_ping, note_turn
from .consider import update_sensitivity
from .enlarged import hold_covariance, tell_bend, tell_enlarged
from .far import begin_move, end_move, is_far
from .hindsight import (
    add_to_deviation,
    decision,
    gain_of_refused,
    is_held,
    pass_over,
    sample_of,
    subtract_deviation,
)
from .imu import place
from .judge import adapt_noise, dof_of, is_definite_in_doubt, judge, passes, remember
from .reopen import (
    begin_anew,
    doubt_heading,
    may_begin_anew,
    note_leap,
    open_gate,
    opens,
    turns_too_far,
)
from .rings import Log, Past
from .runaway import follow, open_wide, runs_away
from .settings import Settings
from .signatures import note
from .state import Frames, State
from .update import feed_back, update
from .work import Work


@entry
@kernel
def locate(s: State, fr: Frames, c: Settings) -> None:
    """Fill the frames and the transponder's position of the state."""
    fr.height[0] = place(
        s.r_e,
        s.v_G,
        s.C_b_G,
        c.lever_point_b,
        fr.C_e_G,
        fr.omega_ie_G,
        fr.lever_G,
        fr.point_e,
        fr.velocity_e,
    )


@kernel
def correct_and_remember(s: State, c: Settings, past: Past, C_e_G: Array, x: Array) -> None:
    """Correct the state by an estimated error (24,), and store it; the frames stay behind.

    A large turn of the attitude leaves what is nonlinear of it in the covariance; a large change
    of the position follows the surface (`far`). Where the velocity turns with the attitude, its
    error goes along (`carried`). C_e_G is scratch.
    """
    if c.gap_ns > 0:
        add_bend_of_correction(s.P, s.v_G, x)
    if c.carries_heading:
        note_turn(s.carried, s.v_G, x)
    far = is_far(s.P, x)
    height = begin_move(s.turn, s.r_e, C_e_G) if far else 0.0
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
    if far:
        end_move(s.turn, s.r_e, C_e_G, x, height)
    i = s.counters[fs.CORRECTIONS] % past.corrections.shape[0]
    for k in range(past.corrections.shape[1]):
        past.corrections[i, k] = x[k]
    past.correction_steps[i] = s.counters[fs.STEPS]
    s.counters[fs.CORRECTIONS] += 1
    s.counters[fs.HELD] = 0


@entry
@kernel
def feed_back_and_remember(s: State, fr: Frames, c: Settings, past: Past, x: Array) -> None:
    """Correct the state by an estimated error (24,), and store it; the frames follow."""
    correct_and_remember(s, c, past, fr.C_e_G, x)
    locate(s, fr, c)


@kernel
def enter(
    log: Log, kind: int, number: int, stamp_ns: int, rank: int, epochs: int, rows: int, dof: int
) -> None:
    """Append an entry to the order of linear steps; of a step ``rows`` and ``dof`` are 0."""
    i = log.counts[0] % log.kinds.shape[0]
    log.kinds[i] = kind
    log.numbers[i] = number
    log.stamps[i] = stamp_ns
    log.ranks[i] = rank
    log.epochs[i] = epochs
    log.rows[i] = rows
    log.dof[i] = dof
    log.counts[0] += 1


@apart
@routine
def fuse_rows(
    s: State, c: Settings, past: Past, w: Work, log: Log, m: int, stream: int, rank: int
) -> int:
    """Fuse the rows H, R, z of the scratch; FUSED, REFUSED by the gate or S_NOT_DEFINITE.

    First m rows; ``stream`` is their row of tally and noise, ``rank`` their place in the log. The
    frames are left behind: `fuse_filled` and `run.advance` bring them up to date.
    """
    if is_held(log):
        subtract_deviation(log, w, m)
    elif c.gap_ns > 0 and stream == fs.DVL_ROW:
        if c.carries_heading:
            add_bend_of_carried_ping(w.R, s.P, s.v_G, w.H, w.PHt, w.S)
        else:
            add_bend_of_ping(w.R, s.P, s.v_G)
    adapt_noise(s, c, w, stream, m)
    if not judge(s, c, w, w.R, m):
        return fs.S_NOT_DEFINITE
    imposed = decision(s, log, stream)
    if imposed == rings.BY_GATE:
        fused = passes(s, c, w, w.z, stream, m)
    else:
        w.nis[1] = 1.0
        fused = imposed == rings.TO_FUSE
    anew = False
    refused = s.counters[fs.REFUSED_ROW + stream]
    is_evidence = remember(s, c, w, w.z, stream, m, fused)
    if not fused and opens(s, c, stream):
        # The newest ping that was used, or the start where there was none.
        since_ns = max(s.counters[fs.USED_NS + stream], s.counters[fs.OPENED_NS + stream])
        hold_covariance(s, w)
        open_gate(s, w, stream, m)
        may_anew = may_begin_anew(s, c, stream)
        for again in range(2 if may_anew else 1):
            if fused:
                break
            if again == 1:
                begin_anew(s, w, since_ns)
                anew = True
            if not judge(s, c, w, w.R, m):
                return fs.S_NOT_DEFINITE
            fused = passes(s, c, w, w.z, stream, m)
            if may_anew and again == 0 and fused:
                fused = not turns_too_far(w, m)
        tell_enlarged(s, w, log)
    if stream != fs.FIX_ROW and c.most_excess > 0.0:
        follow(s, c, w, stream, m, fused)
        tries = 2 if not fused and runs_away(s, c, stream) else 0
        if tries > 0:
            hold_covariance(s, w)
        for again in range(tries):
            if fused:
                break
            open_wide(s, c, w, stream, m, again)
            if not judge(s, c, w, w.R, m):
                return fs.S_NOT_DEFINITE
            fused = passes(s, c, w, w.z, stream, m)
        if tries > 0:
            tell_enlarged(s, w, log)
    if (
        fused
        and c.reopen_ns > 0
        and stream != fs.FIX_ROW
        and not is_definite_in_doubt(s, c, w, stream, m)
    ):
        return fs.S_NOT_DEFINITE
    if not fused:
        if s.counting[0]:
            s.tally[stream, fs.GATED] += 1.0
        if log.hindsight.keeps[0] == 1:
            gain_of_refused(w, m)
            if c.aiding.on:
                fill_block_gain(s, w, m)
            enter_update(s, w, log, rings.KEPT, m, dof_of(w, stream, m), rank)
            pass_over(s, past)
        return fs.REFUSED
    update(s.P, w.x, w.S, w.z, m, w.K, w.PHt, w.L, w.D)
    if s.counters[fs.CONSIDERS] == 1:
        update_sensitivity(s.sensitivity, w.K, w.moved, m)
    if is_evidence:
        note(s, past, w, stream, m, 0.0)
    if c.aiding.on:
        correct_block(s, w, m)
    if s.counting[0]:
        s.tally[stream, fs.UPDATES] += 1.0
        s.tally[stream, fs.NIS_SUM] += w.nis[0]
    if log.H.shape[0] > 0:
        enter_update(s, w, log, rings.UPDATE, m, dof_of(w, stream, m), rank)
    if stream == fs.DVL_ROW and not is_held(log):
        note_leap(s, c, w, refused)
    if c.carries_heading and stream == fs.DVL_ROW and not anew and not is_held(log):
        note_ping(s.carried, s.v_G, w.x)
    apply_correction(s, c, past, w, log)
    if anew:
        hold_covariance(s, w)
        doubt_heading(s)
        tell_enlarged(s, w, log)
    return fs.FUSED


@kernel
def enter_update(s: State, w: Work, log: Log, kind: int, m: int, dof: int, rank: int) -> None:
    """Append the update in the scratch to the order of linear steps, under the next number.

    Of m rows and ``dof`` degrees of freedom; ``rank`` is its place in the order.
    """
    number = s.counters[fs.CORRECTIONS]
    store_update(log, number, w, m)
    if log.model_rows.shape[0] > 0:
        store_block_rows(log.model_rows[number % log.model_rows.shape[0]], w)
    log.samples[log.counts[0] % log.kinds.shape[0]] = sample_of(s, log, rank)
    enter(log, kind, number, s.counters[fs.STAMP], rank, s.counters[fs.EPOCHS], m, dof)


@kernel
def apply_correction(s: State, c: Settings, past: Past, w: Work, log: Log) -> None:
    """Correct the state by the last update, or, where it is held to a track, its deviation."""
    if is_held(log):
        add_to_deviation(log, w)
        pass_over(s, past)
    else:
        if c.gap_ns > 0:
            tell_bend(s, w, log)
        correct_and_remember(s, c, past, w.C_e_G, w.x)


@entry
@routine
def fuse_filled(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    m: int,
    stream: int,
    rank: int,
) -> int:
    """`fuse_rows` for rows that Python has filled; the frames follow."""
    code = fuse_rows(s, c, past, w, log, m, stream, rank)
    locate(s, fr, c)
    return code


@kernel
def store_update(log: Log, number: int, w: Work, m: int) -> None:
    """Store rows, innovation, correction, gain, S and its factor of a fused measurement.

    And what a common error does to the innovation, which is zero where there is none.
    """
    i = number % log.H.shape[0]
    for a in range(3):
        if a < m:
            for k in range(log.moved.shape[2]):
                log.moved[i, a, k] = w.moved[a, k]
            for k in range(log.H.shape[2]):
                log.H[i, a, k] = w.H[a, k]
        else:
            for k in range(log.moved.shape[2]):
                log.moved[i, a, k] = 0.0
            for k in range(log.H.shape[2]):
                log.H[i, a, k] = 0.0
        for k in range(log.K.shape[2]):
            log.K[i, a, k] = w.K[a, k]
        log.z[i, a] = w.z[a] if a < m else 0.0
        for b in range(3):
            inside = a < m and b < m
            log.S[i, a, b] = w.S[a, b] if inside else 0.0
            log.L[i, a, b] = w.L[a, b] if inside else 0.0
    for k in range(log.x.shape[1]):
        log.x[i, k] = w.x[k]
