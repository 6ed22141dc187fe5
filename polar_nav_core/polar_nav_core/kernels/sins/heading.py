"""Heading, and roll and pitch, of an AHRS or compass as measurements of the strapdown.

Its slow bias and its coloured error are estimated: the first two of the last three states, which
hold the leader's errors otherwise. Each angle is a scalar update. Derivation:
docs/derivations/heading.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from .. import watch
from ..cache import kernel, routine
from . import compass, rings
from . import state as fs
from .aiding import correct_block
from .consider import clear, update_sensitivity
from .enlarged import hold_covariance, tell_enlarged
from .fuse import apply_correction, enter_update
from .hindsight import is_held, subtract_deviation
from .judge import judge
from .reopen import (
    AGREEMENT,
    CHANCES,
    FEWEST,
    LEAST,
    LONG_FEWEST,
    MOST,
    SHARE,
    agrees,
    inflate,
)
from .rings import Log, Past
from .rows import DR, PHI
from .settings import Settings
from .state import State
from .update import MARKOV, NAV, USBL, N, update
from .work import Work

BIAS = USBL
COLOURED = USBL + 1
GRAVITY = 9.83
"""Near a pole [m/s^2]."""

# Places in State.heading.
USED = 0
GATED = 1
WEAK = 2  # refused because the reference is weak
HORIZONTAL = 3  # horizontal part of the reference at the newest heading [nT], or cos(latitude)
PLACES = 4


@kernel
def add_heading_dynamics(c: Settings, Phi: Array, inverse: Array, q: Array, dt: float) -> None:
    """Replace the decay and the noise of the coloured error, which has its own time constant."""
    decay = math.exp(-dt / c.heading.noise[compass.MARKOV_TAU])
    Phi[COLOURED, COLOURED] = decay
    inverse[NAV, COLOURED - MARKOV] = 1.0 / decay
    q[COLOURED] = c.heading.noise[compass.MARKOV_VARIANCE] * (1.0 - decay * decay)


@kernel
def _clear_rows(w: Work) -> None:
    for k in range(N):
        w.H[0, k] = 0.0
    clear(w.J)


@kernel
def turn_rate(s: State) -> float:
    """Rate of turn about up [rad/s], counterclockwise."""
    rate = 0.0
    for k in range(3):
        rate += s.C_b_G[2, k] * (s.omega_ib_b[k] - s.b_gyro_b[k])
    return rate


@kernel
def turn_error(s: State, c: Settings) -> float:
    """Tilt [rad] by which an AHRS is off in a turn, which it cannot tell from gravity: v w / g."""
    speed = math.sqrt(s.v_G[0] * s.v_G[0] + s.v_G[1] * s.v_G[1])
    error: float = c.heading.noise[compass.TURN] * speed * abs(turn_rate(s)) / GRAVITY
    return error


@kernel
def tilt_rows(s: State, c: Settings, w: Work, up_b: Array, axis: int) -> None:
    """Row of the measured vertical along a grid axis, 0 east or 1 north: z = (C_b_G up_b)_axis.

    It is coloured: as white noise once per period its variance is 2 tau / period times as large.
    """
    _clear_rows(w)
    z = 0.0
    for k in range(3):
        z += s.C_b_G[axis, k] * up_b[k]
    w.z[0] = z
    # exp(-[phi x]) up = up - phi x up = (-phi_north, phi_east, 1)
    if axis == 0:
        w.H[0, PHI + 1] = -1.0
    else:
        w.H[0, PHI] = 1.0
    noise = c.heading.noise
    times = max(1.0, 2.0 * noise[compass.MARKOV_TAU] / (c.heading.period_ns * 1e-9))
    turn = turn_error(s, c)
    w.R[0, 0] = (noise[compass.TILT] + turn * turn) * times


@kernel
def heading_rows(s: State, c: Settings, w: Work, stamp_ns: int, heading: float) -> bool:
    """Row of a heading; False where its reference is too weak, or the vehicle points up.

    z = h - (heading + north - bias - coloured), with h the estimated grid heading of the body's x
    axis, north the grid azimuth of the reference at the estimated place, and the heading brought
    to the stamp of the state by the rate of turn.
    """
    _clear_rows(w)
    h = c.heading
    east, north, up = compass.reference_at(h, s.r_e, w.C_e_G)
    horizontal = math.sqrt(east * east + north * north)
    s.heading[HORIZONTAL] = horizontal
    x = s.C_b_G[0, 0]
    y = s.C_b_G[1, 0]
    level = x * x + y * y
    if compass.is_weak(h, east, north) or level < 0.03:  # 10 deg from the vertical
        return False
    azimuth = math.atan2(east, north)
    since = (stamp_ns - s.counters[fs.STAMP]) * 1e-9
    measured = heading - h.noise[compass.DECLINATION] + azimuth + turn_rate(s) * since
    measured -= s.usbl_bias_a[0] + s.usbl_bias_a[1]
    w.z[0] = compass.wrapped(math.atan2(x, y) - measured)
    rise = s.C_b_G[2, 0] / level
    w.H[0, PHI] = -rise * x
    w.H[0, PHI + 1] = -rise * y
    w.H[0, PHI + 2] = 1.0
    w.H[0, BIAS] = -1.0
    w.H[0, COLOURED] = -1.0
    turn = turn_error(s, c)
    variance = h.noise[compass.WHITE]
    if h.reference == compass.MAGNETIC:
        turn *= max(1.0, abs(up) / horizontal)
        variance += max(0.0, compass.declination_variance(horizontal) - h.noise[compass.STATED])
    w.R[0, 0] = variance + turn * turn
    if h.reference == compass.TRUE or h.reference == compass.MAGNETIC:
        _add_slopes(s, c, w, azimuth)
    return True


@kernel
def _add_slopes(s: State, c: Settings, w: Work, azimuth: float) -> None:
    """Change of the innovation with the position, by which the reference turns."""
    for axis in range(2):
        for k in range(3):
            w.point_e[k] = s.r_e[k] + compass.AWAY * w.C_e_G[axis, k]
        east, north, _ = compass.reference_at(c.heading, w.point_e, w.C_a_G)
        slope = compass.wrapped(math.atan2(east, north) - azimuth) / compass.AWAY
        for k in range(3):
            w.H[0, DR + k] -= slope * w.C_e_G[axis, k]


@kernel
def _opens(s: State, c: Settings) -> bool:
    """Whether refused headings agree for long enough to be believed, as `reopen.opens`."""
    if c.reopen_ns == 0 or s.counters[fs.HEADING_OPENINGS] >= CHANCES:
        return False
    if s.counters[fs.STAMP] - s.counters[fs.HEADING_OPENED_NS] < c.reopen_ns:
        return False
    row = s.heading_memories[watch.SHORT]
    weight = row[watch.WEIGHT]
    if weight < FEWEST or row[watch.REFUSED] < SHARE * weight:
        return False
    row = s.heading_memories[watch.LONG]
    mean = row[watch.GATE + 2] * row[watch.GATE + 2]
    square = row[watch.GATE_SQUARE + 2]
    return bool(row[watch.WEIGHT] >= LONG_FEWEST and mean > AGREEMENT * square * row[watch.WEIGHT])


@kernel
def _open_gate(s: State, w: Work) -> None:
    """Let the bias be what refused headings say; without fixes that agree, all else is in doubt.

    The heading of the navigation is not moved by that: what is learnt later shows which was off.
    """
    if not agrees(s, fs.FIX_ROW):
        inflate(s, min(max(w.nis[0], LEAST), MOST))
    s.P[BIAS, BIAS] += w.z[0] * w.z[0]
    for k in range(watch.MEMORIES):
        for j in range(watch.WIDTH):
            s.heading_memories[k, j] = 0.0
    s.counters[fs.HEADING_OPENED_NS] = s.counters[fs.STAMP]
    s.counters[fs.HEADING_OPENINGS] += 1


@kernel
def _fuse_row(s: State, c: Settings, past: Past, w: Work, log: Log, watched: bool) -> int:
    """Gate the row in the scratch and fuse it; FUSED, REFUSED or S_NOT_DEFINITE."""
    w.nis[1] = 1.0
    if is_held(log):
        subtract_deviation(log, w, fs.SCALAR)
    if not judge(s, c, w, w.R, fs.SCALAR):
        return fs.S_NOT_DEFINITE
    fused = bool(w.nis[0] <= c.gates[fs.SCALAR])
    if watched:
        watch.observe(
            s.heading_memories,
            w.z,
            w.wide,
            w.nis[0],
            fs.SCALAR,
            fused,
            s.v_G[0],
            s.v_G[1],
            w.z,
            w.wide,
        )
        if not fused and _opens(s, c):
            hold_covariance(s, w)
            _open_gate(s, w)
            tell_enlarged(s, w, log)
            if not judge(s, c, w, w.R, fs.SCALAR):
                return fs.S_NOT_DEFINITE
            fused = bool(w.nis[0] <= c.gates[fs.SCALAR])
    if not fused:
        return fs.REFUSED
    update(s.P, w.x, w.S, w.z, fs.SCALAR, w.K, w.PHt, w.L, w.D)
    if s.counters[fs.CONSIDERS] == 1:
        update_sensitivity(s.sensitivity, w.K, w.moved, fs.SCALAR)
    if c.aiding.on:
        correct_block(s, w, fs.SCALAR)
    if log.H.shape[0] > 0:
        enter_update(s, w, log, rings.UPDATE, fs.SCALAR, fs.SCALAR, fs.HEADING_RANK)
    apply_correction(s, c, past, w, log)
    return fs.FUSED


@routine
def heading_event(
    s: State,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    stamp_ns: int,
    heading: float,
    up_b: Array,
) -> int:
    """Fuse one heading, and the tilt with it, if one is due; returns the code of a failed update.

    Parameters
    ----------
    s, past, log : in place
    c, w : settings, scratch
    stamp_ns, heading : int, float
        Of the measurement [ns]; clockwise from the reference [rad].
    up_b : (3,) array
        Vertical, body axes [-]; NaN where only a heading was measured.
    """
    now_ns = s.counters[fs.STAMP]
    if now_ns - s.counters[fs.HEADING_TRY_NS] < c.heading.period_ns:
        return fs.NO_MEASUREMENT
    s.counters[fs.HEADING_TRY_NS] = now_ns
    if c.heading.tilts and not math.isnan(up_b[0]):
        for axis in range(2):
            tilt_rows(s, c, w, up_b, axis)
            code = _fuse_row(s, c, past, w, log, False)
            if code < 0:
                return code
    if not heading_rows(s, c, w, stamp_ns, heading):
        s.heading[WEAK] += 1.0
        return fs.NO_MEASUREMENT
    code = _fuse_row(s, c, past, w, log, True)
    if code == fs.FUSED:
        s.heading[USED] += 1.0
        s.counters[fs.HEADING_USED_NS] = now_ns
    elif code == fs.REFUSED:
        s.heading[GATED] += 1.0
    return code
