"""Faults of station mode in the run's streams, one dataclass each.

As in faults.py, ``applied(world, scale)`` gives the world with ``scale`` times the fault. Those
that move the vehicle: station_motion.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from polar_nav_core.arrays import Ints
from polar_nav_core.engine.events import Fix
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_sim.randomness import stream

from ..station.world import NS, StationWorld
from .faults import Fault


@dataclass(frozen=True, kw_only=True)
class StationFault(Fault):
    """No fault; base of the faults of station mode."""

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World with ``scale`` times the fault."""
        del scale
        return world


def polar_of(fix: Fix) -> PolarFix:
    """Range and bearing of a station's fix."""
    if fix.polar is None:
        raise TypeError('a fix of a station has range and bearing')
    return fix.polar


def with_fixes(world: StationWorld, fixes: tuple[Fix, ...]) -> StationWorld:
    """World with other fixes."""
    return replace(world, inputs=replace(world.inputs, fixes=fixes))


def rows_of(world: StationWorld, stamps_ns: Ints) -> Ints:
    """Row of the run of each message, (n,): another fault may have taken some of them away."""
    all_ns = world.run.start_ns + np.rint(world.run.t_s * NS).astype(np.int64)
    return np.searchsorted(all_ns, stamps_ns)


def time_s(world: StationWorld, stamp_ns: int) -> float:
    """Time since the start of the run [s]."""
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
            if time_s(world, fix.validity_ns) < self.start_s:
                return fix
            p = polar_of(fix)
            bad = replace(
                p,
                range=p.range * (1.0 + scale * self.range_scale),
                bearing=wrapped(p.bearing + turn),
                station=p.station + shift,
            )
            return replace(fix, polar=bad)

        return with_fixes(world, tuple(map(off, world.inputs.fixes)))


@dataclass(frozen=True, kw_only=True)
class RangeOutliers(StationFault):
    """A share of ranges off by ``size_m``, either way or always too long."""

    DRAWS: ClassVar[bool] = True
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
        return with_fixes(
            world,
            tuple(
                replace(f, polar=replace(polar_of(f), range=polar_of(f).range + e))
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
        return with_fixes(world, fixes)


@dataclass(frozen=True, kw_only=True)
class AhrsHeading(StationFault):
    """The AHRS' heading off [deg], drifting [deg/h], for a time [s]."""

    offset_deg: float = 0.0
    drift_deg_h: float = 0.0
    length_s: float = math.inf

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose attitude is turned about up."""
        since_s = world.run.t_s[rows_of(world, world.inputs.imu_stamps_ns)] - self.start_s
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
        i = world.inputs
        t = world.run.t_s[rows_of(world, i.imu_stamps_ns)]
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
        i = world.inputs
        t = world.run.t_s[rows_of(world, i.control_stamps_ns)]
        factor = 1.0 + scale * (self.factor - 1.0) * (t >= self.start_s)[:, None]
        return replace(world, inputs=replace(i, force_b=i.force_b * factor))


@dataclass(frozen=True, kw_only=True)
class ThrustGlitch(StationFault):
    """One absurd thrust [N] held for a time [s], then no thrust messages for another [s]."""

    force_n: float = 0.0
    held_s: float = 0.0
    silent_s: float = 0.0

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose thrust messages are absurd, or missing: the last one holds then."""
        i = world.inputs
        t = world.run.t_s[rows_of(world, i.control_stamps_ns)]
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
            since_s = time_s(world, fix.validity_ns) - self.start_s
            if not 0.0 <= since_s < self.length_s:
                return fix
            p = polar_of(fix)
            turn = math.radians(self.bearing_deg + self.bearing_dph * since_s / 3600.0)
            turn -= 2.0 * p.bearing if self.mirrored else 0.0
            longer = self.range_m + self.range_mps * since_s
            bad = replace(
                p, range=p.range + scale * longer, bearing=wrapped(p.bearing + scale * turn)
            )
            return replace(fix, polar=bad)

        return with_fixes(world, tuple(map(off, world.inputs.fixes)))


@dataclass(frozen=True, kw_only=True)
class AhrsDeviation(StationFault):
    """Heading off by a sine of the heading [deg], as of iron in the vehicle."""

    deg: float

    def applied(self, world: StationWorld, scale: float) -> StationWorld:  # type: ignore[override]
        """World whose compass has a deviation."""
        rows = rows_of(world, world.inputs.imu_stamps_ns)
        on = world.run.t_s[rows] >= self.start_s
        a = scale * math.radians(self.deg) * on * np.sin(world.run.psi[rows])
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
        on = (world.run.t_s[rows_of(world, i.control_stamps_ns)] >= self.start_s)[:, None]
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

    def is_drawn(self) -> bool:
        """Whether one of them has another shape at each seed."""
        return self.one.is_drawn() or self.other.is_drawn()


def wrapped(angle: float) -> float:
    """The same angle, from -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)
