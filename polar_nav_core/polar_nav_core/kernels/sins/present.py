"""State at the newest IMU sample: the strapdown ahead of the filter, smoothed, with a covariance.

Two tracks run through the samples that the filter has not processed yet: one from its newest
state, and the one so far. What a correction has moved is the difference of the two.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Array, Ints
from ..cache import entry, kernel, routine
from ..frames.body import rotation_coefficients
from ..frames.earth import OMEGA_IE, up_and_height
from ..frames.grid import fill_C_e_G
from . import state as fs
from .ahead import HAS_PREVIOUS, HELD, MARKS, NEXT, STAMP, advance_strapdown
from .columns import QUATERNION, WIDTH, _quaternion
from .consider import COLUMNS
from .offset import Profile, offset_at
from .settings import Settings
from .state import State
from .update import N

LOST, NOTHING, FIRST, FOLLOWED = -1, 0, 1, 2
"""What `follow` returns: not finite; no newer sample; nothing to compare with; both tracks."""
# Places in the values of a `Now`.
R_E, V_G, C_B_G, C_E_G, HEIGHT, RATE, MOVED, TURN, INTERVAL = 0, 3, 6, 15, 24, 25, 28, 31, 40
VALUES = 41


class Track(NamedTuple):
    """Strapdown state ahead of the filter, and what follows from it."""

    C_b_G: Array
    v_G: Array
    r_e: Array
    biases_b: Array  # (2, 3): gyro, accelerometer
    increments: Array
    previous: Array
    previous_dt: Array
    held: Array
    marks: Ints
    C_e_G: Array
    C_b_e: Array
    height: Array  # (1,)


def make_track() -> Track:
    """Return a track of zeros."""
    return Track(
        C_b_G=np.zeros((3, 3)),
        v_G=np.zeros(3),
        r_e=np.zeros(3),
        biases_b=np.zeros((2, 3)),
        increments=np.zeros((4, 3)),
        previous=np.zeros((2, 3)),
        previous_dt=np.zeros(1),
        held=np.zeros(8),
        marks=np.zeros(MARKS, dtype=np.int64),
        C_e_G=np.zeros((3, 3)),
        C_b_e=np.zeros((3, 3)),
        height=np.zeros(1),
    )


class Step(NamedTuple):
    """What moved the track so far, and what it is off by from the one of the newest state."""

    moved_e: Array
    C_turn_b: Array
    off_e: Array
    speed_e: Array
    turn_e: Array


def make_step() -> Step:
    """Return a step of zeros."""
    return Step(np.zeros(3), np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros(3))


class Scratch(NamedTuple):
    """Scratch of the kernels here."""

    strapdown: Array
    rotations: Array  # (3, 3, 3)
    vectors: Array  # (4, 3)
    row: Array
    P: Array
    columns: Array  # (COLUMNS, 24)


def make_scratch() -> Scratch:
    """Return scratch."""
    return Scratch(
        strapdown=np.zeros((9, 3)),
        rotations=np.zeros((3, 3, 3)),
        vectors=np.zeros((4, 3)),
        row=np.zeros(WIDTH),
        P=np.zeros((N, N)),
        columns=np.zeros((COLUMNS, N)),
    )


@kernel
def _multiply(A: Array, B: Array, out: Array) -> None:
    """Fill out = A B, (3, 3) each; `out` is neither."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def _multiply_turned(A: Array, B: Array, out: Array) -> None:
    """Fill out = A^T B, (3, 3) each; `out` is neither."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]


@kernel
def _place(t: Track) -> None:
    """Bring frames up to the state of a track."""
    u_x, u_y, u_z, height = up_and_height(t.r_e[0], t.r_e[1], t.r_e[2])
    fill_C_e_G(u_x, u_y, u_z, t.C_e_G)
    t.height[0] = height
    _multiply_turned(t.C_e_G, t.C_b_G, t.C_b_e)


@kernel
def _begin(t: Track, s: State) -> None:
    """Begin a track at the state of a filter."""
    for i in range(3):
        t.v_G[i] = s.v_G[i]
        t.r_e[i] = s.r_e[i]
        t.biases_b[0, i] = s.b_gyro_b[i]
        t.biases_b[1, i] = s.b_accel_b[i]
        for j in range(3):
            t.C_b_G[i, j] = s.C_b_G[i, j]
        for k in range(4):
            t.increments[k, i] = s.increments[k, i]
        for k in range(2):
            t.previous[k, i] = s.previous[k, i]
    t.previous_dt[0] = s.previous_dt[0]
    for i in range(8):
        t.held[i] = s.held[i]
    t.marks[STAMP] = s.counters[fs.STAMP]
    t.marks[NEXT] = s.counters[fs.NEXT]
    t.marks[HELD] = s.counters[fs.HELD]
    t.marks[HAS_PREVIOUS] = s.counters[fs.HAS_PREVIOUS]


@kernel
def _keep_usable(stamps_ns: Ints, samples_b: Array, count: int, limits: Array) -> int:
    """Move the samples within the limits of the sensor to the front; returns their number."""
    kept = 0
    for i in range(count):
        good = True
        for j in range(2):
            for k in range(3):
                good = good and abs(samples_b[i, j, k]) <= limits[j]
        if good:
            stamps_ns[kept] = stamps_ns[i]
            for j in range(2):
                for k in range(3):
                    samples_b[kept, j, k] = samples_b[i, j, k]
            kept += 1
    return kept


@routine
def _advance(
    t: Track, c: Settings, stamps_ns: Ints, samples_b: Array, count: int, w: Scratch
) -> None:
    """Go through the IMU samples after the stamp of a track."""
    advance_strapdown(
        t.C_b_G,
        t.v_G,
        t.r_e,
        t.biases_b,
        t.increments,
        t.previous,
        t.previous_dt,
        t.held,
        t.marks,
        w.strapdown,
        c.step_ns,
        c.gap_ns,
        c.instant,
        stamps_ns[:count],
        samples_b[:count],
    )
    _place(t)


@kernel
def last_sample(t: Track, j: int, k: int) -> float:
    """Component k of the rate (j = 0) or force (1) of the last interval, less the bias."""
    dt: float = t.previous_dt[0]
    if dt <= 0.0:
        return 0.0
    value: float = t.increments[j, k] / dt
    return value


@kernel
def _is_finite(t: Track) -> bool:
    total = 0.0
    for i in range(3):
        total += t.v_G[i]
        for j in range(3):
            total += t.C_b_e[i, j]
    return math.isfinite(total)


@kernel
def _rotation_vector(C: Array, row: Array, out: Array) -> None:
    """Rotation vector [rad] of a rotation matrix, as `attitude.log`."""
    _quaternion(C, row)
    q = row[QUATERNION : QUATERNION + 4]
    sine = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    factor = 2.0
    if sine >= 1e-9:
        factor = 2.0 * math.atan2(sine, q[3]) / sine
    for k in range(3):
        out[k] = factor * q[k]


@entry
@routine
def follow(
    s: State,
    c: Settings,
    track: Track,
    before: Track,
    begun: bool,
    stamps_ns: Ints,
    samples_b: Array,
    count: int,
    limits: Array,
    lever_b: Array,
    step: Step,
    w: Scratch,
) -> int:
    """Bring a track from a filter's state, and the one so far, to the newest sample.

    Parameters
    ----------
    s, c : State, Settings
        Of the filter; nothing of it is changed.
    track : Track
        Becomes the one from the filter's state.
    before : Track
        That of the last call, moved on, if it has ``begun``.
    stamps_ns, samples_b : (n,), (n, 2, 3) arrays
        IMU samples in order, the first ``count`` of them, that the filter has not processed; those
        beyond the ``limits`` (2,) of the sensor are taken out.
    lever_b : (3,) array
        IMU from base_link, body axes [m].
    step : Step
        Is filled where it returns FOLLOWED.
    w : Scratch

    Returns
    -------
    int
        FOLLOWED, FIRST, NOTHING or LOST.
    """
    _begin(track, s)
    count = _keep_usable(stamps_ns, samples_b, count, limits)
    _advance(track, c, stamps_ns, samples_b, count, w)
    if not _is_finite(track):
        return LOST
    if not begun:
        return FIRST
    if track.marks[STAMP] <= before.marks[STAMP]:
        return NOTHING
    C_b_e, C_off, r_e = w.rotations[0], w.rotations[1], w.vectors[0]
    for i in range(3):
        r_e[i] = before.r_e[i]
        for j in range(3):
            C_b_e[i, j] = before.C_b_e[i, j]
    if count == 0:  # no window: the filter has the newest sample already
        count = 1
        stamps_ns[0] = track.marks[STAMP]
        before.marks[HAS_PREVIOUS] = 0  # the sample is the mean of the interval already
        for j in range(2):
            for k in range(3):
                samples_b[0, j, k] = last_sample(track, j, k) + track.biases_b[j, k]
    _advance(before, c, stamps_ns, samples_b, count, w)
    _multiply_turned(C_b_e, before.C_b_e, step.C_turn_b)
    for i in range(3):
        step.moved_e[i] = before.r_e[i] - r_e[i]
        for k in range(3):
            step.moved_e[i] -= (before.C_b_e[i, k] - C_b_e[i, k]) * lever_b[k]
        step.off_e[i] = before.r_e[i] - track.r_e[i]
        step.speed_e[i] = 0.0
        for k in range(3):
            step.speed_e[i] += (
                before.C_e_G[k, i] * before.v_G[k] - track.C_e_G[k, i] * track.v_G[k]
            )
        for j in range(3):
            C_off[i, j] = 0.0
            for k in range(3):
                C_off[i, j] += before.C_b_e[i, k] * track.C_b_e[j, k]
    _rotation_vector(C_off, w.row, step.turn_e)
    return FOLLOWED


@kernel
def _turned(c: Array, C: Array, out: Array) -> None:
    """Fill out = exp([c x]) C for a rotation vector c (3,) [rad]; all (3, 3)."""
    half_sine, half_cosine, _ = rotation_coefficients(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    first, second = 2.0 * half_sine * half_cosine, 2.0 * half_sine * half_sine
    for j in range(3):
        x, y, z = C[0, j], C[1, j], C[2, j]
        u, v, w = c[1] * z - c[2] * y, c[2] * x - c[0] * z, c[0] * y - c[1] * x
        out[0, j] = x + first * u + second * (c[1] * w - c[2] * v)
        out[1, j] = y + first * v + second * (c[2] * u - c[0] * w)
        out[2, j] = z + first * w + second * (c[0] * v - c[1] * u)


@entry
@routine
def describe_now(
    t: Track, offset: Profile, turn: Profile, lever_b: Array, step: Step, now: Array, w: Scratch
) -> None:
    """Fill the values (VALUES,) of base_link at the stamp of a track.

    Parameters
    ----------
    t : Track
    offset, turn : Profile
        What the published track is off by: position [m] and rotation vector [rad], ECEF.
    lever_b : (3,) array
        IMU from base_link, body axes [m].
    step : Step
        To this stamp.
    now : (VALUES,) array
    w : Scratch
    """
    b, c = w.vectors[:2], w.vectors[2:]
    offset_at(offset, t.marks[STAMP], b)
    offset_at(turn, t.marks[STAMP], c)
    C_b_e = w.rotations[0]
    C_b_G, C_e_G = now[C_B_G : C_B_G + 9].reshape(3, 3), now[C_E_G : C_E_G + 9].reshape(3, 3)
    r_e, v_G, rate = now[R_E : R_E + 3], now[V_G : V_G + 3], now[RATE : RATE + 3]
    moved = False
    for k in range(3):
        moved = moved or b[0, k] != 0.0 or b[1, k] != 0.0 or c[0, k] != 0.0
        r_e[k] = t.r_e[k] + b[0, k]
        v_G[k] = t.v_G[k]
        for j in range(3):
            C_b_G[k, j] = t.C_b_G[k, j]
            C_e_G[k, j] = t.C_e_G[k, j]
    height = t.height[0]
    if moved:
        u_x, u_y, u_z, height = up_and_height(r_e[0], r_e[1], r_e[2])
        fill_C_e_G(u_x, u_y, u_z, C_e_G)
        _turned(c[0], t.C_b_e, C_b_e)
        _multiply(C_e_G, C_b_e, C_b_G)
        for i in range(3):  # the velocity in ECEF, with the rate of the offset
            b[1, i] += (
                t.C_e_G[0, i] * t.v_G[0] + t.C_e_G[1, i] * t.v_G[1] + t.C_e_G[2, i] * t.v_G[2]
            )
        for i in range(3):
            v_G[i] = C_e_G[i, 0] * b[1, 0] + C_e_G[i, 1] * b[1, 1] + C_e_G[i, 2] * b[1, 2]
    for k in range(3):
        spin = 0.0
        for i in range(3):
            spin += C_b_G[i, k] * C_e_G[i, 2]
        rate[k] = last_sample(t, 0, k) - OMEGA_IE * spin
    if lever_b[0] != 0.0 or lever_b[1] != 0.0 or lever_b[2] != 0.0:
        lever_G, swing_b = b[0], b[1]
        swing_b[0] = rate[1] * lever_b[2] - rate[2] * lever_b[1]
        swing_b[1] = rate[2] * lever_b[0] - rate[0] * lever_b[2]
        swing_b[2] = rate[0] * lever_b[1] - rate[1] * lever_b[0]
        for i in range(3):
            lever_G[i] = 0.0
            for k in range(3):
                lever_G[i] += C_b_G[i, k] * lever_b[k]
                v_G[i] -= C_b_G[i, k] * swing_b[k]
        for i in range(3):
            for k in range(3):
                r_e[i] -= C_e_G[k, i] * lever_G[k]
        height -= lever_G[2]
    now[HEIGHT] = height
    now[INTERVAL] = t.previous_dt[0]
    for i in range(3):
        now[MOVED + i] = step.moved_e[i]
        for j in range(3):
            now[TURN + 3 * i + j] = step.C_turn_b[i, j]
