"""IMU samples and the filter: the strapdown, the covariance step, epochs and snapshots.

These are the only places where the state moves; the live node, a replay and a rewind call the
same compiled code, so that they get the same bits.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from ..limits import AXIS, EARTH
from . import rings
from . import state as fs
from .aiding import compare_velocities, model_is_definite, predict_model, store_block_step
from .bend import add_bend_of_gravity
from .carried import carry_heading, carry_yaw
from .consider import (
    DVL_LATENCY,
    clear,
    predict_sensitivity,
)
from .far import turn_transition
from .fill import begin_sample, end_missing, is_overdue, next_missing, until_own_ns
from .fuse import correct_and_remember, enter, enter_update
from .gap import add_gap_noise
from .heading import add_heading_dynamics
from .hindsight import carry_deviation, hold, is_held
from .imu import hold_surroundings, imu_step, take_means
from .model import E
from .rings import Log, Past
from .settings import Settings
from .shock import doubt_shock
from .state import State
from .swing import body_acceleration, follow
from .transition import fill_transition
from .update import MARKOV, USBL, N, is_positive_definite, predict
from .work import Work

GRAVITY = 7
"""Place of gravity in State.held."""


@kernel
def _process_noise(q: Array, s: State, c: Settings, dt: float, decays: Array) -> None:
    """Variances added in a step of dt; ``decays`` has those of the last one, often as long."""
    imu = 1.0 + s.excess[0]
    if dt != decays[0]:
        decays[0] = dt
        decays[1] = c.markov[0] * -math.expm1(-2.0 * dt / c.markov[1])
        decays[2] = c.usbl[0] * -math.expm1(-2.0 * dt / c.usbl[1])
    markov, usbl = decays[1], decays[2]
    for k in range(3):
        q[k] = imu * c.densities[0] * dt
        q[3 + k] = imu * c.densities[1] * dt
        q[6 + k] = 0.0
        q[9 + k] = c.densities[2] * dt
        q[12 + k] = c.densities[3] * dt
        q[15 + k] = 0.0
        q[MARKOV + k] = markov
        q[USBL + k] = usbl


@kernel
def _copy(s: State, flat: Array) -> None:
    """Copy the state without its counters to a row, or as much of it as that has room for."""
    for k in range(min(fs.FLAT, flat.shape[0])):
        flat[k] = s.flat[k]
    for r in range(s.model.shape[0]):
        for k in range(E):
            flat[fs.FLAT + r * E + k] = s.model[r, k]


@entry
@kernel
def take_snapshot(s: State, log: Log) -> None:
    """Store the state, if there is room for snapshots at all."""
    if log.snapshot_flat.shape[0] == 0:
        return
    i = log.counts[1] % log.snapshot_flat.shape[0]
    if log.hindsight.deviations.shape[0] > 0:
        for k in range(N):
            log.hindsight.deviations[i, k] = log.hindsight.deviation[k]
    _copy(s, log.snapshot_flat[i])
    for k in range(fs.COUNTERS):
        log.snapshot_counters[i, k] = s.counters[k]
    log.counts[1] += 1


@kernel
def _keep_good(s: State, log: Log, stamp_ns: int) -> None:
    """Store a sound state, from which a filter that is lost later is restored."""
    _copy(s, log.good_flat[0])
    log.good_ns[0] = stamp_ns


@kernel
def covariance_step(
    s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int, dt: float, gap: float
) -> int:
    """DONE, or P_NOT_DEFINITE, of the covariance step of dt [s] that ends at a stamp.

    ``gap`` is 0, or the time since the last IMU sample where the step bridges a gap [s]. There
    no force and no rate is integrated, so that no error of theirs gets into the state.
    """
    s.counters[fs.STEPS] += 1
    number = s.counters[fs.STEPS]
    Phi = past.transitions[number % past.transitions.shape[0]]
    take_means(s.sums, w.C_mean, w.f_mean, w.omega_mean)
    C_mean = w.C_mean
    if gap > 0.0:
        C_mean = w.C_m_G
        for i in range(3):
            for j in range(3):
                C_mean[i, j] = 0.0
                w.C_mean[i, j] = s.C_b_G[i, j]
    tau_usbl = c.usbl[1] if c.estimates_usbl_bias or c.heading.on else 0.0
    inverse = past.inverses[number % past.inverses.shape[0]]
    fill_transition(Phi, inverse, w.F15, s.r_e, s.v_G, C_mean, w.f_mean, dt, c.markov[1], tau_usbl)
    turn_transition(Phi, inverse, s.turn)
    if s.counters[fs.CONSIDERS] == 1:
        carry_yaw(s.sensitivity, s.C_b_G, s.carried)
    carry_heading(Phi, inverse, s.carried)
    if c.aiding.on:
        predict_model(s, c, w, Phi, stamp_ns, dt)
    _process_noise(w.q, s, c, dt, w.decays)
    if c.heading.on:
        add_heading_dynamics(c, Phi, inverse, w.q, dt)
    if c.gap_ns > 0:
        add_bend_of_gravity(w.q, s.P, dt)
    if gap > 0.0:
        add_gap_noise(w.q, s.P, c.gap_variances, gap - dt, gap)
    predict(s.P, Phi, w.q, w.M)
    if s.counters[fs.CONSIDERS] == 1:
        predict_sensitivity(s.sensitivity, Phi, w.M)
    if is_held(log):
        carry_deviation(log, Phi, w.x)
    # The mean of a Markov error decays as its transition says.
    for k in range(3):
        s.dvl_markov_m[k] *= Phi[MARKOV, MARKOV]
        s.usbl_bias_a[k] *= Phi[USBL + k, USBL + k]
    total, square = 0.0, 0.0
    for k in range(3):
        total += s.r_e[k] + s.v_G[k]
        square += s.r_e[k] * s.r_e[k]
    good = math.isfinite(total) and EARTH[0] ** 2 <= square <= EARTH[1] ** 2
    good = good and math.hypot(s.r_e[0], s.r_e[2]) >= AXIS
    for k in range(c.active):
        good = good and s.P[k, k] > 0.0
    # The whole test costs as much as the step; after going back it is made once, at the end.
    thorough = number % fs.STEPS_PER_TEST == 0 and s.counting[0] == 1
    if good and thorough:
        good = is_positive_definite(s.P, c.active, w.LP)
    if good and c.aiding.on:
        good = model_is_definite(s, c, w, thorough)
    if not good:
        return fs.P_NOT_DEFINITE
    if thorough:
        _keep_good(s, log, stamp_ns)
    if log.step_P.shape[0] > 0:
        slot = number % log.step_P.shape[0]
        for i in range(N):
            for j in range(s.P.shape[1]):
                log.step_P[slot, i, j] = s.P[i, j]
        if c.aiding.on and log.model_steps.shape[0] > 0:
            store_block_step(log.model_steps[slot], w)
        enter(
            log,
            rings.STEP,
            number,
            stamp_ns,
            fs.IMU_RANK,
            s.counters[fs.EPOCHS],
            fs.NO_MEASUREMENT,
            fs.NO_MEASUREMENT,
        )
    return fs.DONE


@entry
@kernel
def begin_step(s: State, c: Settings, stamp_ns: int) -> None:
    """Begin a covariance step at a stamp; the first sample of another period ends it."""
    s.counters[fs.BOUNDARY] = stamp_ns
    s.counters[fs.NEXT] = (stamp_ns // c.step_ns + 1) * c.step_ns
    s.counters[fs.HELD] = 0


@kernel
def finish_step(
    s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int, step: float, gap: float
) -> int:
    """Covariance step [s] that ends at a stamp, its epoch, and the beginning of the next.

    DONE, or the code of a failure; ``gap`` as of `covariance_step`.
    """
    code = covariance_step(s, c, past, w, log, stamp_ns, step, gap)
    if is_held(log):
        hold(s, log, w.x)
    begin_step(s, c, stamp_ns)
    add_epoch(s, c, past)
    # A measurement like others, after the epoch; inside this event, so that a snapshot has it.
    if c.aiding.on and code == fs.DONE:
        code = compare_with_model(s, c, past, w, log, step)
    return code


@routine
def _end_step(
    s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int, own: int
) -> int:
    """End the covariance step at a stamp and begin the next; DONE, or the code of a failure."""
    step = (stamp_ns - s.counters[fs.BOUNDARY]) * 1e-9
    code: int = finish_step(s, c, past, w, log, stamp_ns, step, 0.0)
    if s.counters[fs.WAITS] == 1 or s.counters[fs.STEPS] % c.steps_per_snapshot == 0:
        s.counters[fs.WAITS] = 0 if own == fs.SAMPLE else 1
        if own == fs.SAMPLE:
            take_snapshot(s, log)
    return code


@kernel
def _advance_to(
    s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int, own: int
) -> int:
    """`advance_to` where it is inlined: whoever calls by all arrays copies them at each sample."""
    before_ns = s.counters[fs.STAMP]
    dt = (stamp_ns - before_ns) * 1e-9
    if s.counters[fs.HELD] == 0:
        until_ns = max(stamp_ns, s.counters[fs.NEXT])
        hold_surroundings(s.held, s.v_G, s.r_e, (until_ns - before_ns) * 1e-9)
        s.counters[fs.HELD] = 1
    imu_step(
        s.C_b_G,
        s.v_G,
        s.r_e,
        s.b_gyro_b,
        s.b_accel_b,
        w.omega,
        w.f,
        s.increments,
        dt,
        s.previous_dt[0],
        s.sums,
        s.held,
    )
    for k in range(3):
        s.omega_ib_b[k] = w.omega[k]
    if c.common[DVL_LATENCY] > 0.0:
        _follow_swing(s, c, w, dt)
    s.previous_dt[0] = dt
    s.counters[fs.STAMP] = stamp_ns
    if own == fs.SAMPLE:
        s.counters[fs.IMU_NS] = stamp_ns
        s.counters[fs.IMU] += 1
    if stamp_ns >= s.counters[fs.NEXT]:
        code: int = _end_step(s, c, past, w, log, stamp_ns, own)
        return code
    add_epoch(s, c, past)
    return fs.DONE


@routine
def advance_to(
    s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int, own: int
) -> int:
    """Advance to a stamp by the mean rate and force in the scratch; a step where it ends one.

    ``own`` is SAMPLE, or STAND_IN for what is interpolated or held in place of one. A snapshot
    then waits: it would know of a sample that comes later.
    """
    return _advance_to(s, c, past, w, log, stamp_ns, own)


@kernel
def imu_event(
    s: State,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    stamp_ns: int,
    omega_ib_b: Array,
    f_b: Array,
) -> int:
    """Advance to the end of a sample's interval; a covariance step where it ends one."""
    filled, owes = fs.DONE, False
    if c.shock > 0.0:
        doubt_shock(s, c, w, log, stamp_ns, omega_ib_b, f_b)
    if c.fills:
        owes = begin_sample(s, c, w, stamp_ns, omega_ib_b, f_b)
        while filled == fs.DONE and s.counters[fs.STAMP] < until_own_ns(s, w):
            to_ns = next_missing(s, w, omega_ib_b, f_b)
            filled = advance_to(s, c, past, w, log, to_ns, fs.STAND_IN)
        end_missing(s, c, w, omega_ib_b, f_b)
    for k in range(3):
        w.omega[k] = omega_ib_b[k]
        w.f[k] = f_b[k]
    if c.instant and s.counters[fs.HAS_PREVIOUS] == 1:
        for k in range(3):
            w.omega[k] = 0.5 * (omega_ib_b[k] + s.previous[0, k])
            w.f[k] = 0.5 * (f_b[k] + s.previous[1, k])
    for k in range(3):
        s.previous[0, k] = omega_ib_b[k]
        s.previous[1, k] = f_b[k]
    s.counters[fs.HAS_PREVIOUS] = 1
    if owes:
        dt = (stamp_ns - s.counters[fs.STAMP]) * 1e-9
        for k in range(3):
            w.omega[k] += w.owed[0, k] / dt
            w.f[k] += w.owed[1, k] / dt
    code = _advance_to(s, c, past, w, log, stamp_ns, fs.SAMPLE)
    if owes:  # that is no rate of the vehicle
        for k in range(3):
            s.omega_ib_b[k] = omega_ib_b[k]
    return min(code, filled)


@kernel
def hold_to_ping(s: State, c: Settings, past: Past, w: Work, log: Log, stamp_ns: int) -> int:
    """Advance to a ping's stamp by the last sample where the next one is missing (fill)."""
    if not is_overdue(s, c, stamp_ns):
        return fs.DONE
    for k in range(3):
        w.omega[k] = s.previous[0, k]
        w.f[k] = s.previous[1, k]
    s.counters[fs.HELD_NS] = stamp_ns
    return advance_to(s, c, past, w, log, stamp_ns, fs.STAND_IN)


@kernel
def _follow_swing(s: State, c: Settings, w: Work, dt: float) -> None:
    """Take a sample of dt [s] into the acceleration that late pings have missed."""
    for k in range(3):
        w.omega[k] = s.increments[0, k] / dt
        w.f[k] = s.increments[1, k] / dt
    body_acceleration(w.acceleration, s.C_b_G, s.v_G, w.omega, w.f, s.held[GRAVITY])
    first = s.previous_dt[0] == 0.0
    follow(s.swing, w.acceleration, c.common[DVL_LATENCY], dt, first, w.share)


@kernel
def compare_with_model(s: State, c: Settings, past: Past, w: Work, log: Log, dt: float) -> int:
    """Fuse the velocity of the vehicle's model after a step of dt [s]; DONE, or a failure."""
    code: int = compare_velocities(s, c, w, dt)
    if code == fs.FUSED:
        if log.model_rows.shape[0] > 0:
            clear(w.moved)  # the filter knows no common error of the model
            enter_update(s, w, log, rings.UPDATE, fs.VECTOR, fs.VECTOR, fs.IMU_RANK)
        correct_and_remember(s, c, past, w.C_e_G, w.x)
    return min(code, fs.DONE)


@entry
@kernel
def add_epoch(s: State, c: Settings, past: Past) -> None:
    """Store the IMU epoch: after a covariance step that ends at it, before its measurements."""
    i = s.counters[fs.EPOCHS] % past.stamps.shape[0]
    past.stamps[i] = s.counters[fs.STAMP]
    past.steps[i] = s.counters[fs.STEPS]
    past.firsts[i] = s.counters[fs.CORRECTIONS]
    for k in range(3):
        past.positions[i, k] = s.r_e[k]
        past.velocities[i, k] = s.v_G[k]
        past.usbl_biases[i, k] = s.usbl_bias_a[k]
        past.levers[i, k] = (
            s.C_b_G[k, 0] * c.lever_point_b[0]
            + s.C_b_G[k, 1] * c.lever_point_b[1]
            + s.C_b_G[k, 2] * c.lever_point_b[2]
        )
    s.counters[fs.EPOCHS] += 1


@kernel
def note_outcome(s: State, w: Work, code: int, outcome: Array) -> None:
    """Outcome of a fix, into (OUTCOME,), as `Streams.fix_outcomes` has it; variances [m^2]."""
    outcome[0] = float(code)
    outcome[1] = w.nis[0]
    for a in range(3):
        outcome[2 + a] = w.z[a]
        outcome[5 + a] = w.wide[a, a] if s.counters[fs.CONSIDERS] == 1 else w.S[a, a] / w.nis[1]
    outcome[rings.ENLARGEMENT] = w.nis[1]
    outcome[rings.DOF] = float(w.dof[0])
