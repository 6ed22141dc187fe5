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
from ..kernels.sins import ahead, present
from ..kernels.sins.offset import Profile, make_profile
from ..kernels.sins.present_covariance import STATES, covariance_now
from ..machine_code import Direct
from ..output_params import OutputParams
from .bleed import Bleed
from .engine import Engine
from .events import ImuSample
from .lever import Rows
from .params import EngineParams
from .sins.filter import NavigationFilter
from .sins.fusion import Fusion

_STEP, _SPEED, _ANGLE = 1e-8, 1e-9, 1e-11
"""Smaller steps [m], [m/s], [rad] are rounding, not corrections."""
_ROOM = 64
"""Samples that may wait before there is room for more."""


@dataclass(frozen=True)
class Now:
    """Navigation state of base_link at the newest IMU sample, with what changed since the last.

    Attributes
    ----------
    stamp_ns : int
    values : (VALUES,) array
        As `kernels.sins.present` names them; the properties here are views of it.
    jumps : int
        How often the track has jumped so far.
    """

    stamp_ns: int
    values: Array
    jumps: int

    @property
    def r_e(self) -> Array:
        """Position (3,), ECEF [m]."""
        return self.values[present.R_E : present.R_E + 3]

    @property
    def v_G(self) -> Array:
        """Velocity (3,), grid axes [m/s]."""
        return self.values[present.V_G : present.V_G + 3]

    @property
    def C_b_G(self) -> Array:
        """Attitude (3, 3)."""
        return self.values[present.C_B_G : present.C_B_G + 9].reshape(3, 3)

    @property
    def height(self) -> float:
        """Height above the ellipsoid [m]."""
        return float(self.values[present.HEIGHT])

    @property
    def omega_eb_b(self) -> Array:
        """Rate against the earth (3,), body axes [rad/s]."""
        return self.values[present.RATE : present.RATE + 3]

    @property
    def moved_e(self) -> Array:
        """Way (3,) since the `Now` before, without corrections, ECEF [m]."""
        return self.values[present.MOVED : present.MOVED + 3]

    @property
    def C_turn_b(self) -> Array:
        """Rotation (3, 3) since then, without corrections, body axes of now to those of then."""
        return self.values[present.TURN : present.TURN + 9].reshape(3, 3)

    @property
    def interval_s(self) -> float:
        """Length of the newest IMU interval [s]; 0 where there was none."""
        return float(self.values[present.INTERVAL])


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
        self._limits = np.array([engine_params.max_rate, engine_params.max_specific_force])
        self._lever_b = np.zeros(3)
        blend_s, angle = params.now_blend_s, math.radians(params.now_jump_angle_deg)
        self._offset_e = Bleed(params.now_acceleration, blend_s, params.now_jump)
        self._turn_e = Bleed(params.now_turn_acceleration, blend_s, angle)
        self._track, self._spare = present.make_track(), present.make_track()
        self._step, self._scratch = present.make_step(), present.make_scratch()
        self._stamps_ns, self._samples_b = _room_for(_ROOM)
        self._P = np.zeros((STATES, STATES))
        self._run, self._grow = Direct(present.follow), Direct(covariance_now)
        self._begun = self._lost = False
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
            self._lost = self._begun
            return None
        if engine.arm is not None:
            self._lever_b = engine.arm.lever_b
        f, track, before = fusion.filter, self._spare, self._track
        code = self._follow(f, track, before, waiting)
        if code == present.LOST:
            self._lost = self._begun
        if code in (present.LOST, present.NOTHING):
            return None
        self._track, self._spare, self._begun = track, before, True
        stamp_ns = int(track.marks[ahead.STAMP])
        values, step = np.empty(present.VALUES), self._step
        if code == present.FIRST:
            step.moved_e[:], step.C_turn_b[:] = 0.0, np.eye(3)
        else:
            self._correct(stamp_ns)
        present.describe_now(track, *self._profiles, self._lever_b, step, values, self._scratch)
        return Now(stamp_ns, values, self.jumps)

    def _follow(
        self,
        f: NavigationFilter,
        track: present.Track,
        before: present.Track,
        waiting: Sequence[ImuSample],
    ) -> int:
        """Bring the tracks of the filter and of the call before to the newest sample."""
        room = len(self._stamps_ns)
        if len(waiting) > room:
            self._stamps_ns, self._samples_b = _room_for(2 * len(waiting))
        stamps_ns, samples_b = self._stamps_ns, self._samples_b
        for k, sample in enumerate(waiting):
            stamps_ns[k] = sample.stamp_ns
            samples_b[k, 0], samples_b[k, 1] = sample.omega_ib_b, sample.f_b
        samples = stamps_ns, samples_b, len(waiting)
        rest = self._limits, self._lever_b, self._step, self._scratch
        given = f.state, f.settings, track, before, self._begun, *samples, *rest
        code: int = self._run.call((f,), *given)
        return code

    def _correct(self, stamp_ns: int) -> None:
        """Take the step from the track so far to the corrected one into the offsets."""
        step, taken = self._step, True
        if self._lost:
            taken = False
        elif _most(step.off_e) > _STEP or _most(step.speed_e) > _SPEED:
            taken = self._offset_e.add(stamp_ns, step.off_e, step.speed_e)
        if taken and _most(step.turn_e) > _ANGLE:
            c, _ = self._turn_e.at(stamp_ns)
            whole = attitude.log(attitude.exp(c) @ attitude.exp(step.turn_e))
            taken = self._turn_e.add(stamp_ns, whole - c, np.zeros(3))
        if not taken:
            self._offset_e.clear()
            self._turn_e.clear()
            self.jumps += 1
        self._lost = False

    @property
    def _profiles(self) -> tuple[Profile, Profile]:
        return self._offset_e.profile, self._turn_e.profile

    def covariance(self, engine: Engine) -> Array:
        """Covariance (15, 15) of `error_model.X` up to the biases at the last `Now`.

        That of the newest state, grown by the transition of the time ahead, plus the squares of
        the offsets that are still to be bled off: the published track is off by them.
        """
        fusion, track = engine.fusion, self._track
        if not (isinstance(fusion, Fusion) and self._begun):
            raise ValueError('there is no state')
        f, P = fusion.filter, np.empty((STATES, STATES))
        given = f.state, f.settings, track, *self._profiles, P, self._scratch
        self._grow.call((f,), *given)
        return self._at_base_link(P, track) if self._lever_b.any() else P

    def _at_base_link(self, P: Array, track: present.Track) -> Array:
        """Covariance of base_link from that of the IMU's point."""
        rows = Rows.of(track.r_e[None], track.v_G[None], P[None])
        interval_s = float(track.previous_dt[0]) or 1.0
        dt = float(track.previous_dt[0])
        rate = track.increments[:1] / dt if dt > 0.0 else np.zeros((1, 3))
        given = rate, np.array([1.0 / interval_s])
        bias_b = np.zeros((1, 3))  # taken off already
        rows.move(self._lever_b, self._p.gyro_noise_density, given, bias_b, track.C_b_G[None])
        moved: Array = rows.P[0]
        return moved


def _most(v: Array) -> float:
    """Largest size of three values; as numbers, NumPy takes several times as long."""
    x, y, z = v.tolist()
    largest: float = max(abs(x), abs(y), abs(z))
    return largest


def _room_for(samples: int) -> tuple[Ints, Array]:
    return np.zeros(samples, dtype=np.int64), np.zeros((samples, 2, 3))


def warm_up(f: NavigationFilter) -> None:
    """Compile or load the kernels used here, with the state of a filter."""
    track, step, scratch = present.make_track(), present.make_step(), present.make_scratch()
    before, lever_b, profile = present.make_track(), np.zeros(3), make_profile()
    limits, P = np.ones(2), np.empty((STATES, STATES))
    rest = *_room_for(1), 0, limits, lever_b, step, scratch
    present.follow(f.state, f.settings, track, before, False, *rest)
    present.describe_now(track, profile, profile, lever_b, step, np.empty(present.VALUES), scratch)
    covariance_now(f.state, f.settings, track, profile, profile, P, scratch)
    Bleed(1.0, 1.0, 1.0).at(0)
