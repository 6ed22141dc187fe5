"""State at the newest IMU sample, ahead of the ordered estimate, smooth enough to steer by.

The engine stands at the watermark, a reorder window behind the newest sample. From its newest
corrected state the strapdown runs through the samples that still wait. When a correction moves
that, the difference to the track so far is bled off with bounded acceleration (`bleed`).

Nothing of it goes back into the engine, and a replay does not repeat it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import attitude
from ..arrays import Array, Ints
from ..error_model import X
from ..kernels.frames.earth import OMEGA_IE, up_and_height_many
from ..kernels.frames.grid import fill_C_e_G_many
from ..kernels.sins import ahead
from ..kernels.sins import state as fs
from ..output_params import OutputParams
from .bleed import Bleed
from .engine import Engine
from .events import ImuSample
from .lever import Rows
from .params import EngineParams
from .plausibility import all_within
from .sins.filter import NavigationFilter
from .sins.fusion import Fusion

_STEP, _SPEED, _ANGLE = 1e-8, 1e-9, 1e-11
"""Smaller steps [m], [m/s], [rad] are rounding, not corrections."""
_STATES = 15
"""Attitude, velocity, position and biases of the IMU."""


@dataclass(frozen=True)
class Now:
    """Navigation state of base_link at the newest IMU sample, with what changed since the last.

    Attributes
    ----------
    stamp_ns : int
    r_e, v_G : (3,) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G, C_e_G : (3, 3) arrays
        Attitude; grid frame at the position.
    height : float
        Above the ellipsoid [m].
    omega_eb_b : (3,) array
        Rate against the earth, body axes [rad/s].
    moved_e : (3,) array
        Way since the `Now` before, without corrections, ECEF [m].
    C_turn_b : (3, 3) array
        Rotation since then, without corrections, body axes of now to those of then.
    interval_s : float
        Length of the newest IMU interval [s]; 0 where there was none.
    jumps : int
        How often the track has jumped so far.
    """

    stamp_ns: int
    r_e: Array
    v_G: Array
    C_b_G: Array
    C_e_G: Array
    height: float
    omega_eb_b: Array
    moved_e: Array
    C_turn_b: Array
    interval_s: float
    jumps: int


def _frame_at(r_e: Array) -> tuple[Array, float]:
    """C_e_G (3, 3) and height [m] at a position; as `grid` and `earth`, without their checks."""
    C_e_G, up_e, height = np.empty((1, 3, 3)), np.empty((1, 3)), np.empty(1)
    fill_C_e_G_many(r_e[None], C_e_G)
    up_and_height_many(r_e[None], up_e, height)
    return C_e_G[0], float(height[0])


class _Track:
    """Strapdown state of its own, begun at that of a filter."""

    def __init__(self, f: NavigationFilter) -> None:
        s, counters = f.state, f.state.counters
        self.C_b_G, self.v_G, self.r_e = s.C_b_G.copy(), s.v_G.copy(), s.r_e.copy()
        self.biases_b = np.array([s.b_gyro_b, s.b_accel_b])
        self.increments, self.previous = s.increments.copy(), s.previous.copy()
        self.previous_dt, self._held = s.previous_dt.copy(), s.held.copy()
        self._marks = counters[[fs.STAMP, fs.NEXT, fs.HELD, fs.HAS_PREVIOUS]]
        self._scratch = np.zeros((9, 3))
        c = f.settings
        self._constants = c.step_ns, c.gap_ns, c.instant
        self.place()

    def advance(self, stamps_ns: Ints, samples_b: Array) -> None:
        """Go through the IMU samples after the present stamp."""
        ahead.advance_strapdown(
            self.C_b_G,
            self.v_G,
            self.r_e,
            self.biases_b,
            self.increments,
            self.previous,
            self.previous_dt,
            self._held,
            self._marks,
            self._scratch,
            *self._constants,
            stamps_ns,
            samples_b,
        )
        self.place()

    def advance_as(self, other: _Track) -> None:
        """Go over the last interval of another track, to its stamp."""
        self._marks[ahead.HAS_PREVIOUS] = 0  # the sample is the mean of it already
        samples_b = (other.last_sample_b + other.biases_b)[None]
        self.advance(np.array([other.stamp_ns]), samples_b)

    def place(self) -> None:
        """Bring frames up to the state."""
        self.C_e_G, self.height = _frame_at(self.r_e)
        self.C_b_e = self.C_e_G.T @ self.C_b_G

    @property
    def stamp_ns(self) -> int:
        """Stamp of the state."""
        return int(self._marks[ahead.STAMP])

    @property
    def last_sample_b(self) -> Array:
        """Rate and specific force (2, 3) of the last interval, less the biases."""
        dt = float(self.previous_dt[0])
        return self.increments[:2] / dt if dt > 0.0 else np.zeros((2, 3))


class Predictor:
    """Predicts the state of an engine to the newest IMU sample; mode sins only.

    Parameters
    ----------
    engine_params : EngineParams
    params : OutputParams
        Limits of the smoothing.
    """

    def __init__(self, engine_params: EngineParams, params: OutputParams) -> None:
        self._p = engine_params
        self._lever_b: Array | None = None
        blend_s, angle = params.now_blend_s, math.radians(params.now_jump_angle_deg)
        self._offset_e = Bleed(params.now_acceleration, blend_s, params.now_jump)
        self._turn_e = Bleed(params.now_turn_acceleration, blend_s, angle)
        self._track: _Track | None = None
        self._lost = False
        self.jumps = 0

    def update(self, engine: Engine, waiting: Sequence[ImuSample]) -> Now | None:
        """State at the newest sample; None where there is no state, or no newer sample.

        Parameters
        ----------
        engine : Engine
        waiting : sequence of ImuSample
            What it has not processed yet, in order.
        """
        fusion = engine.fusion
        if not isinstance(fusion, Fusion):
            self._lost = self._track is not None
            return None
        self._lever_b = None if engine.arm is None else engine.arm.lever_b
        track, before = _Track(fusion.filter), self._track
        stamps_ns, samples_b = self._columns(waiting)
        track.advance(stamps_ns, samples_b)
        if not (np.isfinite(track.C_b_e).all() and np.isfinite(track.v_G).all()):
            self._lost = before is not None
            return None
        if before is None:
            self._track = track
            return self._now(track, np.zeros(3), np.eye(3))
        if track.stamp_ns <= before.stamp_ns:
            return None
        r_e, C_b_e = before.r_e.copy(), before.C_b_e
        if len(stamps_ns):
            before.advance(stamps_ns, samples_b)
        else:  # no window: the engine has the newest sample already
            before.advance_as(track)
        self._track = track
        self._follow(before, track)
        moved_e = before.r_e - r_e
        if self._lever_b is not None:
            moved_e -= (before.C_b_e - C_b_e) @ self._lever_b
        return self._now(track, moved_e, C_b_e.T @ before.C_b_e)

    def _columns(self, waiting: Sequence[ImuSample]) -> tuple[Ints, Array]:
        """Stamps (n,) and values (n, 2, 3) of the samples within the limits of the sensor."""
        stamps_ns = np.array([s.stamp_ns for s in waiting], dtype=np.int64)
        samples_b = np.array([(s.omega_ib_b, s.f_b) for s in waiting]).reshape(-1, 2, 3)
        good = all_within(samples_b[:, 0], self._p.max_rate)
        good &= all_within(samples_b[:, 1], self._p.max_specific_force)
        return stamps_ns[good], np.ascontiguousarray(samples_b[good])

    def _follow(self, before: _Track, track: _Track) -> None:
        """Take the step from the track so far to the corrected one into the offsets."""
        step_e = before.r_e - track.r_e
        speed_e = before.C_e_G.T @ before.v_G - track.C_e_G.T @ track.v_G
        turn_e = attitude.log(before.C_b_e @ track.C_b_e.T)
        stamp_ns = track.stamp_ns
        taken = True
        if self._lost:
            taken = False
        elif np.abs(step_e).max() > _STEP or np.abs(speed_e).max() > _SPEED:
            taken = self._offset_e.add(stamp_ns, step_e, speed_e)
        if taken and np.abs(turn_e).max() > _ANGLE:
            c, _ = self._turn_e.at(stamp_ns)
            whole = attitude.log(attitude.exp(c) @ attitude.exp(turn_e))
            taken = self._turn_e.add(stamp_ns, whole - c, np.zeros(3))
        if not taken:
            self._offset_e.clear()
            self._turn_e.clear()
            self.jumps += 1
        self._lost = False

    def _now(self, track: _Track, moved_e: Array, C_turn_b: Array) -> Now:
        r_e, v_G, C_b_G = track.r_e, track.v_G, track.C_b_G
        C_e_G, height = track.C_e_G, track.height
        b, rate = self._offset_e.at(track.stamp_ns)
        c, _ = self._turn_e.at(track.stamp_ns)
        if b.any() or rate.any() or c.any():
            r_e = r_e + b
            C_e_G, height = _frame_at(r_e)
            v_G = C_e_G @ (track.C_e_G.T @ v_G + rate)
            C_b_G = C_e_G @ (attitude.exp(c) @ track.C_b_e)
        omega_ie_b = OMEGA_IE * (C_b_G.T @ C_e_G[:, 2])
        omega_eb_b = track.last_sample_b[0] - omega_ie_b
        if self._lever_b is not None:
            lever_G = C_b_G @ self._lever_b
            r_e, height = r_e - C_e_G.T @ lever_G, height - float(lever_G[2])
            v_G = v_G - C_b_G @ np.cross(omega_eb_b, self._lever_b)
        return Now(
            track.stamp_ns,
            r_e.copy(),
            v_G.copy(),
            C_b_G.copy(),
            C_e_G,
            height,
            omega_eb_b,
            moved_e,
            C_turn_b,
            float(track.previous_dt[0]),
            self.jumps,
        )

    def covariance(self, engine: Engine) -> Array:
        """Covariance (15, 15) of `error_model.X` up to the biases at the last `Now`.

        That of the newest state, grown by the transition of the time ahead, plus the squares of
        the offsets that are still to be bled off: the published track is off by them.
        """
        fusion, track = engine.fusion, self._track
        if not isinstance(fusion, Fusion) or track is None:
            raise ValueError('there is no state')
        f, dt = fusion.filter, (track.stamp_ns - fusion.filter.stamp_ns) * 1e-9
        F = np.eye(_STATES)
        F[X.phi_G, X.b_gyro_b] = -track.C_b_G * dt
        F[X.dv_G, X.phi_G] = attitude.skew(track.C_b_G @ track.last_sample_b[1]) * dt
        F[X.dv_G, X.b_accel_b] = track.C_b_G * dt
        F[X.dr_e, X.dv_G] = track.C_e_G.T * dt
        P: Array = F @ f.published_P[:_STATES, :_STATES] @ F.T
        noise = np.repeat(f.settings.densities[:2] * dt * (1.0 + float(f.state.excess[0])), 3)
        P[np.arange(6), np.arange(6)] += noise
        (b, rate), (c, _) = self._offset_e.at(track.stamp_ns), self._turn_e.at(track.stamp_ns)
        P[X.dr_e, X.dr_e] += np.outer(b, b)
        P[X.dv_G, X.dv_G] += np.outer(track.C_e_G @ rate, track.C_e_G @ rate)
        P[X.phi_G, X.phi_G] += np.outer(track.C_e_G @ c, track.C_e_G @ c)
        return P if self._lever_b is None else self._at_base_link(P, track)

    def _at_base_link(self, P: Array, track: _Track) -> Array:
        """Covariance of base_link from that of the IMU's point."""
        assert self._lever_b is not None
        rows = Rows.of(track.r_e[None], track.v_G[None], P[None])
        interval_s = float(track.previous_dt[0]) or 1.0
        rate = track.last_sample_b[:1], np.array([1.0 / interval_s])
        bias_b = np.zeros((1, 3))  # taken off already
        rows.move(self._lever_b, self._p.gyro_noise_density, rate, bias_b, track.C_b_G[None])
        moved: Array = rows.P[0]
        return moved


def warm_up() -> None:
    """Compile or load the kernel used here."""
    C, v, r = np.eye(3), np.zeros(3), np.array([0.0, 0.0, 6356752.0])
    pairs, previous, dt = np.zeros((4, 3)), np.zeros((2, 3)), np.zeros(1)
    marks = np.zeros(ahead.MARKS, dtype=np.int64)
    work = np.zeros(8), marks, np.zeros((9, 3)), 100_000_000, 0, False
    stamps_ns = np.array([10_000_000])
    ahead.advance_strapdown(
        C, v, r, previous.copy(), pairs, previous, dt, *work, stamps_ns, np.zeros((1, 2, 3))
    )
