"""Fusion of one measurement: noise, gate, update, feedback, and the stored past.

Whole runs, clones and fixes that are fused again share `adapt_noise`, `judge` and `passes`.
Derivation of the adapted noise: docs/derivations/adaptation.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from .. import watch
from ..cache import entry, kernel, routine
from ..watch import observe
from . import state as fs
from .aiding import correct_block, fill_block_gain, store_block_rows
from .bend import add_bend_of_correction, add_bend_of_ping
from .consider import COLUMNS, innovation_sensitivity, update_sensitivity, widen
from .enlarged import hold_covariance, tell_bend, tell_enlarged
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
from .reopen import FEWEST, agrees, begin_anew, may_begin_anew, open_gate, opens
from .runaway import follow, open_wide, runs_away
from .shared import forget, learn, residual, whitened
from .signatures import note
from .state import Frames, Log, Past, Settings, State, Work
from .update import N, cholesky, feed_back, innovation_covariance, nis_of, update


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
def correct_and_remember(s: State, c: Settings, past: Past, x: Array) -> None:
    """Correct the state by an estimated error (24,), and store it; the frames stay behind.

    A large turn of the attitude leaves what is nonlinear of it in the covariance.
    """
    if c.gap_ns > 0:
        add_bend_of_correction(s.P, s.v_G, x)
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
    i = s.counters[fs.CORRECTIONS] % past.corrections.shape[0]
    for k in range(N):
        past.corrections[i, k] = x[k]
    past.correction_steps[i] = s.counters[fs.STEPS]
    s.counters[fs.CORRECTIONS] += 1
    s.counters[fs.HELD] = 0


@entry
@kernel
def feed_back_and_remember(s: State, fr: Frames, c: Settings, past: Past, x: Array) -> None:
    """Correct the state by an estimated error (24,), and store it; the frames follow."""
    correct_and_remember(s, c, past, x)
    locate(s, fr, c)


@kernel
def enter(
    log: Log, kind: int, number: int, stamp_ns: int, rank: int, epochs: int, rows: int
) -> None:
    """Append an entry to the order of linear steps."""
    i = log.counts[0] % log.kinds.shape[0]
    log.kinds[i] = kind
    log.numbers[i] = number
    log.stamps[i] = stamp_ns
    log.ranks[i] = rank
    log.epochs[i] = epochs
    log.rows[i] = rows
    log.counts[0] += 1


@kernel
def scale_noise(R: Array, noise: Array, c: Settings) -> None:
    """R <- D R D, D^2 the adapted ratio per axis (columns 1..3 of ``noise``), within bounds."""
    for a in range(3):
        row = math.sqrt(min(max(noise[1 + a], c.floor), c.ceiling))
        for b in range(3):
            R[a, b] *= row * math.sqrt(min(max(noise[1 + b], c.floor), c.ceiling))


@kernel
def learn_noise(noise: Array, z: Array, stated: Array, b: float, enlargement: float) -> None:
    """Fading average of z^2 / stated variance per axis; ``noise[0]`` is b^k."""
    noise[0] *= b
    d = (1.0 - b) / (1.0 - noise[0])
    for a in range(3):
        noise[1 + a] = (1.0 - d) * noise[1 + a] + d * z[a] * z[a] / (enlargement * stated[a, a])


@kernel
def judge_rows(w: Work, P: Array, H: Array, R: Array, z: Array, m: int) -> bool:
    """Whether S is positive definite; PHt, S, its factor and NIS are in the scratch."""
    innovation_covariance(w.S, w.PHt, P, H, R, m)
    if not cholesky(w.L, w.S, m):
        return False
    w.nis[0] = nis_of(w.L, z, w.w, m)
    return True


@entry
@kernel
def judge(s: State, c: Settings, w: Work, R: Array, m: int) -> bool:
    """Whether S is positive definite; PHt, S, its factor and NIS are in the scratch.

    NIS is that of S with the common errors.
    """
    if not judge_rows(w, s.P, w.H, R, w.z, m):
        return False
    if s.counters[fs.CONSIDERS] == 1:
        for a in range(m):
            for k in range(COLUMNS):
                w.moved[a, k] = w.J[a, k]
        innovation_sensitivity(w.moved, w.H, s.sensitivity, m)
        return judge_wide(c, w, w.z, m)
    for a in range(m):
        for b in range(m):
            w.wide[a, b] = w.S[a, b]
    return True


@kernel
def judge_wide(c: Settings, w: Work, z: Array, m: int) -> bool:
    """Whether S with the common errors is positive definite; NIS is that of it.

    S stands in the scratch, and in ``moved`` what the innovation z does per common error.
    """
    widen(w.wide, w.S, w.moved, c.common, m)
    if not cholesky(w.wide_L, w.wide, m):
        return False
    w.nis[0] = nis_of(w.wide_L, z, w.w, m)
    return True


@entry
@kernel
def remember(s: State, c: Settings, w: Work, z: Array, stream: int, m: int, fused: bool) -> bool:
    """Add a judged measurement to the memories of its stream (watch); stores when it was used.

    What it shows of the common errors is learned from those that are used (shared). Returns
    whether its residual, which is in the scratch then, is evidence about slow faults (signatures).
    """
    if fused:
        s.counters[fs.USED_NS + stream] = s.counters[fs.STAMP]
        s.counters[fs.USES + stream] += 1
        s.counters[fs.REFUSED_ROW + stream] = 0
    else:
        s.counters[fs.REFUSED_ROW + stream] += 1
    memories = s.memories[stream]
    v_x, v_y = s.v_G[0], s.v_G[1]
    if s.counters[fs.CONSIDERS] == 1:
        dt = (s.counters[fs.STAMP] - s.counters[fs.SHARED_NS]) * 1e-9
        if dt > 0.0 and s.counters[fs.SHARED_NS] > 0:
            forget(s.shared, dt)
        s.counters[fs.SHARED_NS] = s.counters[fs.STAMP]
        for a in range(m):
            for k in range(COLUMNS):
                w.per_sigma[a, k] = w.moved[a, k]
        residual(w.residual, w.narrow, s.shared, w.per_sigma, c.common, z, w.wide, m)
        nis = whitened(w.narrow_L, w.narrow, w.residual, w.w, m)
        if nis >= 0.0:
            observe(memories, w.residual, w.narrow, nis, m, fused, v_x, v_y, z, w.wide)
            if fused:
                learn(s.shared, w.per_sigma, w.narrow_L, w.w, w.learned, w.nis[1], m)
            return fused
    observe(memories, z, w.wide, w.nis[0], m, fused, v_x, v_y, z, w.wide)
    return fused and s.counters[fs.CONSIDERS] == 0


@kernel
def adapt_noise(s: State, c: Settings, w: Work, stream: int, m: int) -> None:
    """Store R as stated, and scale it as the stream's noise is adapted; three rows only."""
    if c.adaptive and m == fs.VECTOR:
        for a in range(3):
            for b in range(3):
                w.stated[a, b] = w.R[a, b]
        scale_noise(w.R, s.noise[stream], c)


@kernel
def passes(s: State, c: Settings, w: Work, z: Array, stream: int, m: int) -> bool:
    """Whether a judged measurement passes the gate; if so, its weight and the adapted noise.

    Of a fix far off, R and S in the scratch are enlarged; ``nis[1]`` says by how much. ``z`` is
    the innovation that belongs to S.
    """
    w.nis[1] = 1.0
    if not w.nis[0] <= c.gates[m]:
        return False
    if stream == fs.FIX_ROW and w.nis[0] > c.far_nis and _is_out_of_reach(s, c, w, z):
        return False
    if stream == fs.FIX_ROW:
        w.nis[1] = enlarge(w, c)
    if c.adaptive and m == fs.VECTOR:
        learn_noise(s.noise[stream], z, w.stated, c.forgetting, w.nis[1])
    return True


@kernel
def _is_out_of_reach(s: State, c: Settings, w: Work, z: Array) -> bool:
    """Whether a fix lies farther off than the vehicle can have moved since one was used.

    Since the start, or since the gate was opened, where none was used after it.
    """
    used_ns = max(s.counters[fs.USED_NS + fs.FIX_ROW], s.counters[fs.OPENED_NS + fs.FIX_ROW])
    reach = c.max_speed * ((s.counters[fs.STAMP] - used_ns) * 1e-9 + w.age[0])
    far: bool = z[0] * z[0] + z[1] * z[1] + z[2] * z[2] > reach * reach
    return far


@kernel
def _doubt(s: State, c: Settings, w: Work, stream: int, m: int) -> bool:
    """Enlarge the noise of a local sensor of which most is refused; whether S is definite then.

    What passes the gate does so by chance, at whatever phase of the error it comes, and its stated
    noise is not that of its stream: R <- R mean(NIS per row) of what came lately, refused or not.
    """
    row = s.memories[stream, watch.SHORT]
    weight = row[watch.WEIGHT]
    if weight < FEWEST or agrees(s, stream) or not row[watch.NIS] > weight:
        return True
    for a in range(m):
        for b in range(m):
            w.R[a, b] *= row[watch.NIS] / weight
    nis = w.nis[0]
    definite = judge(s, c, w, w.R, m)
    w.nis[0] = nis
    return definite


@kernel
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
        add_bend_of_ping(w.R, s.P, s.v_G)
    adapt_noise(s, c, w, stream, m)
    if not judge(s, c, w, w.R, m):
        return fs.S_NOT_DEFINITE
    imposed = decision(s, log, stream)
    if imposed == fs.BY_GATE:
        fused = passes(s, c, w, w.z, stream, m)
    else:
        w.nis[1] = 1.0
        fused = imposed == fs.TO_FUSE
    is_evidence = remember(s, c, w, w.z, stream, m, fused)
    if not fused and opens(s, c, stream):
        # The newest ping that was used, or the start where there was none.
        since_ns = max(s.counters[fs.USED_NS + stream], s.counters[fs.OPENED_NS + stream])
        hold_covariance(s, w)
        open_gate(s, w, stream, m)
        for again in range(2 if may_begin_anew(s, c, stream) else 1):
            if fused:
                break
            if again == 1:
                begin_anew(s, w, since_ns)
            if not judge(s, c, w, w.R, m):
                return fs.S_NOT_DEFINITE
            fused = passes(s, c, w, w.z, stream, m)
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
    if fused and c.reopen_ns > 0 and stream != fs.FIX_ROW and not _doubt(s, c, w, stream, m):
        return fs.S_NOT_DEFINITE
    if not fused:
        if s.counting[0]:
            s.tally[stream, fs.GATED] += 1.0
        if log.hindsight.keeps[0] == 1:
            gain_of_refused(w, m)
            if c.aiding.on:
                fill_block_gain(s, w, m)
            enter_update(s, w, log, fs.KEPT, m, rank)
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
        enter_update(s, w, log, fs.UPDATE, m, rank)
    apply_correction(s, c, past, w, log)
    return fs.FUSED


@kernel
def enter_update(s: State, w: Work, log: Log, kind: int, m: int, rank: int) -> None:
    """Append the update in the scratch to the order of linear steps, under the next number."""
    number = s.counters[fs.CORRECTIONS]
    store_update(log, number, w, m)
    if log.model_rows.shape[0] > 0:
        store_block_rows(log.model_rows[number % log.model_rows.shape[0]], w)
    log.samples[log.counts[0] % log.kinds.shape[0]] = sample_of(s, log, rank)
    enter(log, kind, number, s.counters[fs.STAMP], rank, s.counters[fs.EPOCHS], m)


@kernel
def apply_correction(s: State, c: Settings, past: Past, w: Work, log: Log) -> None:
    """Correct the state by the last update, or, where it is held to a track, its deviation."""
    if is_held(log):
        add_to_deviation(log, w)
        pass_over(s, past)
    else:
        if c.gap_ns > 0:
            tell_bend(s, w, log)
        correct_and_remember(s, c, past, w.x)


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
def ping_passes(s: State, c: Settings, w: Work) -> int:
    """FUSED if the ping in H, R, z would pass the gate, REFUSED, or S_NOT_DEFINITE."""
    for a in range(3):
        for b in range(3):
            w.stated[a, b] = w.R[a, b]
    if c.gap_ns > 0:
        add_bend_of_ping(w.stated, s.P, s.v_G)
    if c.adaptive:
        scale_noise(w.stated, s.noise[fs.DVL_ROW], c)
    w.nis[1] = 1.0
    if not judge(s, c, w, w.stated, fs.VECTOR):
        return fs.S_NOT_DEFINITE
    return fs.FUSED if w.nis[0] <= c.gates[fs.VECTOR] else fs.REFUSED


@kernel
def enlarge(w: Work, c: Settings) -> float:
    """Factor lambda >= 1 of a fix that passed the gate, by its NIS (engine.sins.robust).

    R <- R + (lambda - 1) S in the scratch; S and its factor follow.
    """
    if c.robust == fs.ROBUST_NONE or not w.nis[0] > c.robust_threshold:
        return 1.0
    factor: float = w.nis[0] / c.robust_threshold
    if c.robust == fs.ROBUST_HUBER:
        factor = math.sqrt(factor)
    root = math.sqrt(factor)
    for a in range(3):
        for b in range(3):
            w.R[a, b] += (factor - 1.0) * w.S[a, b]
            w.S[a, b] *= factor
            w.L[a, b] *= root
    return factor


@kernel
def store_update(log: Log, number: int, w: Work, m: int) -> None:
    """Store rows, innovation, correction, gain, S and its factor of a fused measurement.

    And what a common error does to the innovation, which is zero where there is none.
    """
    i = number % log.H.shape[0]
    for a in range(3):
        for k in range(COLUMNS):
            log.moved[i, a, k] = w.moved[a, k] if a < m else 0.0
        log.z[i, a] = w.z[a] if a < m else 0.0
        for k in range(N):
            log.H[i, a, k] = w.H[a, k] if a < m else 0.0
            log.K[i, a, k] = w.K[a, k]
        for b in range(3):
            inside = a < m and b < m
            log.S[i, a, b] = w.S[a, b] if inside else 0.0
            log.L[i, a, b] = w.L[a, b] if inside else 0.0
    for k in range(N):
        log.x[i, k] = w.x[k]
