"""Faults of station mode: one dataclass each, applied to the run's streams or to its motion.

As in faults.py, ``applied(world, scale)`` gives the world with ``scale`` times the fault. Where
the *vehicle* does something else (dead thruster, held, another current), its true motion is
displaced: velocity through the water follows the plane surge-sway model with the simulation's own
mass and drag (`water_velocity`), position is its integral, and every fix is measured anew from
there. Attitude and acoustic delays stay those of the undisturbed run (30 m are 20 ms of sound).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core.engine.events import Array, Fix
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_sim.offline_station import StationRun
from polar_nav_sim.randomness import stream

from ..station.world import NS, StationWorld
from .faults import Fault

_STEP = 10
"""Samples of 10 ms per step of the surge-sway model."""


@dataclass(frozen=True, kw_only=True)
class StationFault(Fault):
    """No fault; base of the faults of station mode."""

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World with ``scale`` times the fault."""
        del scale
        return world


def _polar(fix: Fix) -> PolarFix:
    if fix.polar is None:
        raise TypeError('a fix of a station has range and bearing')
    return fix.polar


def _with_fixes(world: StationWorld, fixes: tuple[Fix, ...]) -> StationWorld:
    return replace(world, inputs=replace(world.inputs, fixes=fixes))


def _time_s(world: StationWorld, stamp_ns: int) -> float:
    return (stamp_ns - world.run.start_ns) / NS


@dataclass(frozen=True, kw_only=True)
class StationError(StationFault):
    """Errors common to all fixes: range scale, bearing [deg], station along x [m]."""

    range_scale: float = 0.0
    bearing_deg: float = 0.0
    station_m: float = 0.0

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose station is off."""
        turn = scale * math.radians(self.bearing_deg)
        shift = scale * np.array([self.station_m, 0.0, 0.0])

        def off(fix: Fix) -> Fix:
            if _time_s(world, fix.validity_ns) < self.start_s:
                return fix
            p = _polar(fix)
            bad = replace(
                p,
                range=p.range * (1.0 + scale * self.range_scale),
                bearing=_wrapped(p.bearing + turn),
                station=p.station + shift,
            )
            return replace(fix, polar=bad)

        return _with_fixes(world, tuple(map(off, world.inputs.fixes)))


@dataclass(frozen=True, kw_only=True)
class RangeOutliers(StationFault):
    """A share of ranges off by ``size_m``, either way or always too long."""

    share: float
    size_m: float
    one_sided: bool = False

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World with outliers."""
        rng = stream(world.run.seed, 'mismatch/range_outliers')
        n = len(world.inputs.fixes)
        bad = rng.random(n) < self.share
        sign = np.where(self.one_sided | (rng.random(n) < 0.5), 1.0, -1.0)
        error = scale * self.size_m * bad * sign
        return _with_fixes(
            world,
            tuple(
                replace(f, polar=replace(_polar(f), range=_polar(f).range + e))
                for f, e in zip(world.inputs.fixes, error, strict=True)
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Validity(StationFault):
    """Times of validity stated late (positive) or early [s]."""

    late_s: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose fixes state other times."""
        shift = round(scale * self.late_s * NS)
        fixes = tuple(
            replace(f, validity_ns=min(f.validity_ns + shift, f.receive_ns))
            for f in world.inputs.fixes
        )
        return _with_fixes(world, fixes)


@dataclass(frozen=True, kw_only=True)
class AhrsHeading(StationFault):
    """The AHRS' heading off [deg], drifting [deg/h], for a time [s]."""

    offset_deg: float = 0.0
    drift_deg_h: float = 0.0
    length_s: float = math.inf

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose attitude is turned about up."""
        since_s = world.run.t_s - self.start_s
        on = (since_s >= 0.0) & (since_s < self.length_s)
        angle_deg = on * (self.offset_deg + self.drift_deg_h * since_s / 3600.0)
        a = scale * np.radians(angle_deg)
        turn = np.zeros((len(a), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(a)
        turn[:, 1, 0], turn[:, 0, 1] = np.sin(a), -np.sin(a)
        turn[:, 2, 2] = 1.0
        i = world.inputs
        return replace(world, inputs=replace(i, C_b_G=turn @ i.C_b_G))


@dataclass(frozen=True, kw_only=True)
class AhrsOut(StationFault):
    """No AHRS messages for a time [s]."""

    length_s: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World without these samples; a part of a gap is none."""
        t, i = world.run.t_s, world.inputs
        keep = (scale < 1.0) | (t < self.start_s) | (t >= self.start_s + self.length_s)
        kept = replace(
            i,
            imu_stamps_ns=i.imu_stamps_ns[keep],
            omega_ib_b=i.omega_ib_b[keep],
            C_b_G=i.C_b_G[keep],
        )
        return replace(world, inputs=kept)


@dataclass(frozen=True, kw_only=True)
class ThrustStated(StationFault):
    """The stated thrust is a multiple of the true one."""

    factor: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose thrust messages are too large or small."""
        on = (world.run.t_s >= self.start_s)[:, None]
        factor = 1.0 + scale * (self.factor - 1.0) * on
        i = world.inputs
        return replace(world, inputs=replace(i, force_b=i.force_b * factor))


@dataclass(frozen=True, kw_only=True)
class ThrustGlitch(StationFault):
    """One absurd thrust [N] held for a time [s], then no thrust messages for another [s]."""

    force_n: float = 0.0
    held_s: float = 0.0
    silent_s: float = 0.0

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose thrust messages are absurd, or missing: the last one holds then."""
        i, t = world.inputs, world.run.t_s
        force_b = i.force_b.copy()
        absurd = (t >= self.start_s) & (t < self.start_s + max(self.held_s, 0.005))
        if self.force_n:
            force_b[absurd, 0] += scale * self.force_n
        end_s = self.start_s + self.held_s + self.silent_s
        silent = (t >= self.start_s + self.held_s) & (t < end_s)
        if scale >= 1.0:
            keep = ~silent
            stamps = i.control_stamps_ns[keep]
            return replace(
                world, inputs=replace(i, control_stamps_ns=stamps, force_b=force_b[keep])
            )
        if silent.any():
            last = force_b[max(0, int(np.argmax(silent)) - 1)]
            share = scale if not self.force_n else 1.0
            force_b[silent] += share * (last - force_b[silent])
        return replace(world, inputs=replace(i, force_b=force_b))


@dataclass(frozen=True, kw_only=True)
class ThrusterDead(StationFault):
    """The thruster is dead, while its messages go on."""

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose vehicle only drifts."""
        run = world.run
        k = int(np.searchsorted(run.t_s, self.start_s))
        with_it = water_velocity(run, k, run.v_r_b[k, :2], 1.0)
        without = water_velocity(run, k, run.v_r_b[k, :2], 0.0)
        return displaced(world, scale * _to_station(run, without - with_it))


@dataclass(frozen=True, kw_only=True)
class Held(StationFault):
    """The vehicle stands still over ground for a time [s], then goes on."""

    length_s: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose vehicle is held."""
        run = world.run
        first, last = np.searchsorted(run.t_s, [self.start_s, self.start_s + self.length_s])
        current_b = np.einsum('ji,j->i', run.true_C_b_G[last], run.current[last])
        after = water_velocity(run, int(last), -current_b[:2], 1.0)
        before = water_velocity(run, int(last), run.v_r_b[last, :2], 1.0)
        d_v_S = _to_station(run, after - before)
        d_v_S[first:last] = -run.v[first:last, :2]
        return displaced(world, scale * d_v_S)


@dataclass(frozen=True, kw_only=True)
class CurrentReverses(StationFault):
    """From the fault's start on the water turns round within ``length_s``.

    It stays turned, or turns ``again`` and again. ``speed_mps`` is the speed of the water before
    and after, in the world without the reversal, too; the undisturbed run's is replaced.
    """

    speed_mps: float
    length_s: float
    again: bool = False

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World with the other current."""
        run = world.run
        unit = run.current[:, :2] / np.linalg.norm(run.current[:, :2], axis=1)[:, None]
        most = math.inf if self.again else 1.0
        turned = np.pi * np.clip((run.t_s - self.start_s) / self.length_s, 0.0, most)
        share = 1.0 + scale * (np.cos(turned) - 1.0)
        wanted = self.speed_mps * unit * share[:, None]
        return displaced(world, wanted - run.current[:, :2], current=True)


@dataclass(frozen=True, kw_only=True)
class DragGrows(StationFault):
    """Drag of the vehicle that grows by a share within a time [s], as by weed or a torn cover."""

    share: float
    ramp_s: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose vehicle becomes slower."""
        run = world.run
        k = int(np.searchsorted(run.t_s, self.start_s))
        grown = np.clip((run.t_s - self.start_s) / self.ramp_s, 0.0, 1.0)
        v = run.v_r_b[k, :2]
        usual = water_velocity(run, k, v, 1.0)
        slower = water_velocity(run, k, v, 1.0, drag=1.0 + scale * self.share * grown)
        return displaced(world, _to_station(run, slower - usual))


@dataclass(frozen=True, kw_only=True)
class CurrentBegins(StationFault):
    """Further current across the one that is there [m/s], within a time [s], as at a front."""

    speed_mps: float
    ramp_s: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World with the current."""
        run = world.run
        grown = np.clip((run.t_s - self.start_s) / self.ramp_s, 0.0, 1.0)
        unit = run.current[:, :2] / np.linalg.norm(run.current[:, :2], axis=1)[:, None]
        across = np.column_stack([-unit[:, 1], unit[:, 0]])
        return displaced(world, scale * self.speed_mps * grown[:, None] * across, current=True)


@dataclass(frozen=True, kw_only=True)
class FixesOff(StationFault):
    """Ranges off by a constant [m] or more and more [m/s], bearings too [deg], [deg/h].

    ``mirrored``: bearings with the other sign, against the station's x axis. For ``length_s``.
    """

    range_m: float = 0.0
    range_mps: float = 0.0
    bearing_deg: float = 0.0
    bearing_dph: float = 0.0
    mirrored: bool = False
    length_s: float = math.inf

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose station is off."""

        def off(fix: Fix) -> Fix:
            since_s = _time_s(world, fix.validity_ns) - self.start_s
            if not 0.0 <= since_s < self.length_s:
                return fix
            p = _polar(fix)
            turn = math.radians(self.bearing_deg + self.bearing_dph * since_s / 3600.0)
            turn -= 2.0 * p.bearing if self.mirrored else 0.0
            longer = self.range_m + self.range_mps * since_s
            bad = replace(
                p, range=p.range + scale * longer, bearing=_wrapped(p.bearing + scale * turn)
            )
            return replace(fix, polar=bad)

        return _with_fixes(world, tuple(map(off, world.inputs.fixes)))


@dataclass(frozen=True, kw_only=True)
class AhrsDeviation(StationFault):
    """Heading off by a sine of the heading [deg], as of iron in the vehicle."""

    deg: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose compass has a deviation."""
        on = world.run.t_s >= self.start_s
        a = scale * math.radians(self.deg) * on * np.sin(world.run.psi)
        turn = np.zeros((len(a), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(a)
        turn[:, 1, 0], turn[:, 0, 1] = np.sin(a), -np.sin(a)
        turn[:, 2, 2] = 1.0
        i = world.inputs
        return replace(world, inputs=replace(i, C_b_G=turn @ i.C_b_G))


@dataclass(frozen=True, kw_only=True)
class DepthOff(StationFault):
    """Depth off by a constant [m], or stuck at one value."""

    bias_m: float = 0.0
    stuck: bool = False

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose depth sensor is off."""
        i = world.inputs
        t = (i.depth_stamps_ns - world.run.start_ns) / NS
        on = t >= self.start_s
        error = np.full(len(t), self.bias_m)
        if self.stuck:
            error += i.depth[max(0, int(np.argmax(on)) - 1)] - i.depth
        return replace(world, inputs=replace(i, depth=i.depth + scale * on * error))


@dataclass(frozen=True, kw_only=True)
class ThrustLate(StationFault):
    """Thrust messages that are late by a time [s]."""

    late_s: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose thrust trails behind; part of a delay is a part of its error."""
        i = world.inputs
        rows = round(self.late_s / float(np.median(np.diff(world.run.t_s))))
        late = np.concatenate([np.repeat(i.force_b[:1], rows, axis=0), i.force_b[:-rows]])
        on = (world.run.t_s >= self.start_s)[:, None]
        return replace(
            world, inputs=replace(i, force_b=i.force_b + scale * on * (late - i.force_b))
        )


@dataclass(frozen=True, kw_only=True)
class StationBoth(StationFault):
    """Two faults at once."""

    one: StationFault
    other: StationFault

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World with both."""
        return self.other.applied(self.one.applied(world, scale), scale)


def water_velocity(
    run: StationRun, first: int, v_b: Array, thrust: float, drag: Array | None = None
) -> Array:
    """Velocity through the water in surge and sway from sample ``first`` on [m/s], shape (n, 2).

    Fossen's plane model without yaw dynamics, M v' = thrust F - drag D(v) v - C(r) v with the
    added mass in C, explicit steps of 0.1 s; zero before ``first``. ``drag`` (n,) is 1 by default.
    """
    b = run.body
    mass = b.mass_kg + np.array(b.added_mass[:2])
    linear, quadratic = np.array(b.drag_linear[:2]), np.array(b.drag_quadratic[:2])
    rate = np.gradient(run.psi, run.t_s)
    out = np.zeros((len(run.t_s), 2))
    v = np.array(v_b, dtype=np.float64)
    for k in range(first, len(run.t_s), _STEP):
        out[k : k + _STEP] = v
        force = np.array([thrust * run.force_b[k, 0], 0.0])
        coriolis = rate[k] * np.array([-mass[1] * v[1], mass[0] * v[0]])
        step_s = float(run.t_s[min(k + _STEP, len(out) - 1)] - run.t_s[k])
        more = 1.0 if drag is None else float(drag[k])
        v = v + step_s * (force - more * (linear + quadratic * np.abs(v)) * v - coriolis) / mass
    return out


def _to_station(run: StationRun, v_b: Array) -> Array:
    """Surge and sway (n, 2) along station x and y, by the true heading."""
    c, s = np.cos(run.psi), np.sin(run.psi)
    return np.column_stack([c * v_b[:, 0] - s * v_b[:, 1], s * v_b[:, 0] + c * v_b[:, 1]])


def displaced(world: StationWorld, d_v_S: Array, *, current: bool = False) -> StationWorld:
    """World whose vehicle moves with a further horizontal velocity (n, 2) [m/s], station axes."""
    run = world.run
    step_s = np.diff(run.t_s, prepend=run.t_s[0])[:, None]
    moved = np.zeros_like(run.p)
    moved[:, :2] = np.cumsum(step_s * d_v_S, axis=0)
    extra = np.zeros_like(run.v)
    extra[:, :2] = d_v_S
    valid_s = np.array([_time_s(world, f.validity_ns) for f in world.inputs.fixes])
    d_fix = np.column_stack([np.interp(valid_s, run.t_s, moved[:, i]) for i in range(3)])
    true = run.fixes.true_position.copy()
    fixes = tuple(
        replace(f, polar=_seen_from(_polar(f), true[k], true[k] + d_fix[k]))
        for k, f in enumerate(world.inputs.fixes)
    )
    true[: len(d_fix)] += d_fix
    changed = replace(
        run,
        p=run.p + moved,
        v=run.v + extra,
        v_r_b=run.v_r_b,
        current=run.current + extra if current else run.current,
        fixes=replace(run.fixes, true_position=true),
    )
    return _with_fixes(replace(world, run=changed), fixes)


def _seen_from(p: PolarFix, before: Array, now: Array) -> PolarFix:
    """Measurement from a position with the errors drawn at another one."""
    a, b = before - p.station, now - p.station
    turn = math.atan2(b[1], b[0]) - math.atan2(a[1], a[0])
    longer = float(np.linalg.norm(b) - np.linalg.norm(a))
    return replace(p, range=p.range + longer, bearing=_wrapped(p.bearing + turn))


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
