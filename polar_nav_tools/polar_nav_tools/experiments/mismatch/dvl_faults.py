"""Faults of DVL and depth in an inertial vehicle's world; what they have in common: faults.py."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_sim.sensors.noise import GaussMarkov

from ..world import World
from . import worlds
from .faults import Fault


@dataclass(frozen=True, kw_only=True)
class DvlGain(Fault):
    """DVL velocities too long by a share (scale, sound speed), and turned about body z [deg]."""

    scale: float = 0.0
    turn_deg: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are longer and turned."""
        i = world.inputs
        angle = scale * math.radians(self.turn_deg)
        c, s = math.cos(angle), math.sin(angle)
        C = (1.0 + scale * self.scale) * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        on = self._on(worlds.seconds(world, i.dvl_stamps_ns))
        return worlds.add_dvl(world, on * (i.dvl_v_m @ (C - np.eye(3)).T))


@dataclass(frozen=True, kw_only=True)
class DvlMirrored(Fault):
    """Velocity to port with the wrong sign."""

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are mirrored; part of a fault is a smaller number."""
        i = world.inputs
        error = i.dvl_v_m * np.array([0.0, -2.0, 0.0])
        return worlds.add_dvl(
            world, scale * self._on(worlds.seconds(world, i.dvl_stamps_ns)) * error
        )


@dataclass(frozen=True, kw_only=True)
class DvlWater(Fault):
    """Pings of the water in place of the bottom: off by a current [m/s], at once or as a ramp."""

    current: float
    ramp_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are relative to water that flows north-east."""
        stamps = world.inputs.dvl_stamps_ns
        grown = _grown(worlds.seconds(world, stamps) - self.start_s, self.ramp_s)
        water_G = np.tile(self.current * np.array([0.8, 0.6, 0.0]), (len(stamps), 1))
        water_b = worlds.to_body(worlds.attitude_at(world, stamps), water_G)
        return worlds.add_dvl(world, -scale * grown * water_b)


@dataclass(frozen=True, kw_only=True)
class DvlScaleGrows(Fault):
    """Scale error that grows to ``scale`` within a time [s]."""

    scale: float
    ramp_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose pings become longer."""
        i = world.inputs
        grown = _grown(worlds.seconds(world, i.dvl_stamps_ns) - self.start_s, self.ramp_s)
        return worlds.add_dvl(world, scale * self.scale * grown * i.dvl_v_m)


def _grown(since_s: Array, ramp_s: float) -> Array:
    """Share of a fault that began a time ago, 0 to 1, shape (n, 1)."""
    if not ramp_s:
        return np.asarray(since_s >= 0.0, dtype=np.float64)[:, None]
    return np.asarray(np.clip(since_s / ramp_s, 0.0, 1.0))[:, None]


@dataclass(frozen=True, kw_only=True)
class DvlSlow(Fault):
    """Slow DVL errors: Gauss-Markov velocity [m/s] and a constant scale per axis."""

    DRAWS: ClassVar[bool] = True
    sigma: float
    tau_s: float
    scale_sigma: float

    def applied(self, world: World, scale: float) -> World:
        """World whose DVL has the errors."""
        i, rng = world.inputs, worlds.drawn(world, 'dvl_slow')
        n = len(i.dvl_stamps_ns)
        step_s = 1.0 / world.spec.dvl_rate_hz
        slow = GaussMarkov(np.full(3, self.sigma), self.tau_s, step_s, rng.normal(size=3))
        gain = self.scale_sigma * rng.standard_normal(3)
        error = slow.advance(rng.standard_normal((n, 3))) + gain * i.dvl_v_m
        return worlds.add_dvl(
            world, scale * self._on(worlds.seconds(world, i.dvl_stamps_ns)) * error
        )


@dataclass(frozen=True, kw_only=True)
class DvlPlace(Fault):
    """DVL ahead of where it is stated to be [m], and pings late by a time [s]."""

    lever_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lag_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are of another place and time."""
        stamps = world.inputs.dvl_stamps_ns
        now, lag_ns = world.truth.state(stamps), round(scale * self.lag_s * 1e9)
        then_ns = np.maximum(stamps - lag_ns, world.truth.start_ns)
        then = world.truth.state(then_ns)
        error = worlds.to_body(then.C_b_G, then.v_G) - worlds.to_body(now.C_b_G, now.v_G)
        rows = np.searchsorted(world.inputs.imu_stamps_ns, stamps)
        turning = np.cross(world.inputs.omega_ib_b[rows], np.array(self.lever_b))
        on = self._on(worlds.seconds(world, stamps))
        return worlds.add_dvl(world, on * (error + scale * turning))


@dataclass(frozen=True, kw_only=True)
class DvlBadPings(Fault):
    """A share of pings with errors of ``sigma`` on every axis, stated as good."""

    DRAWS: ClassVar[bool] = True
    share: float
    sigma: float

    def applied(self, world: World, scale: float) -> World:
        """World with bad pings."""
        rng, n = worlds.drawn(world, 'dvl_bad'), len(world.inputs.dvl_stamps_ns)
        bad = rng.random(n) < self.share
        error = self.sigma * rng.standard_normal((n, 3)) * bad[:, None]
        on = self._on(worlds.seconds(world, world.inputs.dvl_stamps_ns))
        return worlds.add_dvl(world, scale * on * error)


@dataclass(frozen=True, kw_only=True)
class DvlStuck(Fault):
    """The DVL repeats one ping."""

    def applied(self, world: World, scale: float) -> World:
        """World whose pings stand still from the fault's start on."""
        i = world.inputs
        on = self._on(worlds.seconds(world, i.dvl_stamps_ns))
        last = i.dvl_v_m[max(0, int(np.argmax(on)) - 1)]
        return worlds.add_dvl(world, scale * on * (last - i.dvl_v_m))


@dataclass(frozen=True, kw_only=True)
class DvlOut(Fault):
    """No bottom lock for a time [s]."""

    length_s: float

    def applied(self, world: World, scale: float) -> World:
        """World with invalid pings; a part of an outage is none."""
        i = world.inputs
        t = worlds.seconds(world, i.dvl_stamps_ns)
        out = (scale >= 1.0) & (t >= self.start_s) & (t < self.start_s + self.length_s)
        return replace(world, inputs=replace(i, dvl_valid=i.dvl_valid & ~out))


@dataclass(frozen=True, kw_only=True)
class DepthError(Fault):
    """Depth off by a constant [m], by one that grows [m/s], or stuck at one value."""

    bias_m: float = 0.0
    drift_mps: float = 0.0
    stuck: bool = False

    def applied(self, world: World, scale: float) -> World:
        """World whose barometer is off."""
        i = world.inputs
        on = self._on(worlds.seconds(world, i.depth_stamps_ns))[:, 0]
        since_s = worlds.seconds(world, i.depth_stamps_ns) - self.start_s
        error = self.bias_m + self.drift_mps * since_s
        if self.stuck:
            error = error + i.depth[max(0, int(np.argmax(on)) - 1)] - i.depth
        return worlds.add_depth(world, scale * on * error)


@dataclass(frozen=True, kw_only=True)
class DvlBias(Fault):
    """Velocity off by a constant in the instrument's axes [m/s], whatever the speed."""

    bias_m: tuple[float, float, float]

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are off."""
        on = self._on(worlds.seconds(world, world.inputs.dvl_stamps_ns))
        return worlds.add_dvl(world, scale * on * np.array(self.bias_m))


@dataclass(frozen=True, kw_only=True)
class DvlOneSided(Fault):
    """A share of pings that are too fast along x by ``size`` [m/s], as of a wrong beam."""

    DRAWS: ClassVar[bool] = True
    share: float
    size: float

    def applied(self, world: World, scale: float) -> World:
        """World with one-sided outliers."""
        n = len(world.inputs.dvl_stamps_ns)
        bad = worlds.drawn(world, 'dvl_one_sided').random(n) < self.share
        on = self._on(worlds.seconds(world, world.inputs.dvl_stamps_ns))
        error = on * bad[:, None] * np.array([self.size, 0.0, 0.0])
        return worlds.add_dvl(world, scale * error)


@dataclass(frozen=True, kw_only=True)
class DvlFreezes(Fault):
    """The DVL repeats one ping for ``length_s``, each ``every_s``."""

    length_s: float
    every_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose pings stand still again and again."""
        i = world.inputs
        since_s = worlds.seconds(world, i.dvl_stamps_ns) - self.start_s
        frozen = (since_s >= 0.0) & (np.mod(since_s, self.every_s) < self.length_s)
        rows = np.arange(len(frozen))
        last = np.maximum.accumulate(np.where(frozen, 0, rows))
        return worlds.add_dvl(world, scale * (i.dvl_v_m[last] - i.dvl_v_m))


@dataclass(frozen=True, kw_only=True)
class DvlLate(Fault):
    """Pings late by a time that differs from ping to ping, or that grows [s]."""

    DRAWS: ClassVar[bool] = True
    most_s: float
    ramp_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are of other times."""
        stamps = world.inputs.dvl_stamps_ns
        since_s = worlds.seconds(world, stamps) - self.start_s
        if self.ramp_s:
            late_s = self.most_s * np.clip(since_s / self.ramp_s, 0.0, 1.0)
        else:
            drawn = worlds.drawn(world, 'dvl_late').uniform(0.0, self.most_s, len(stamps))
            late_s = drawn * (since_s >= 0.0)
        then_ns = stamps - np.round(1e9 * late_s).astype(np.int64)
        then = world.truth.state(np.maximum(then_ns, world.truth.start_ns))
        now = world.truth.state(stamps)
        error = worlds.to_body(then.C_b_G, then.v_G) - worlds.to_body(now.C_b_G, now.v_G)
        return worlds.add_dvl(world, scale * error)


@dataclass(frozen=True, kw_only=True)
class DvlMixes(Fault):
    """Velocity through a matrix: error M v of instrument axes, as of a beam that is lost."""

    DRAWS: ClassVar[bool] = True
    matrix: tuple[tuple[float, float, float], ...]
    noise: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are mixed, with further white noise [m/s]."""
        i = world.inputs
        on = scale * self._on(worlds.seconds(world, i.dvl_stamps_ns))
        noise = worlds.drawn(world, 'dvl_mixes').standard_normal(i.dvl_v_m.shape)
        return worlds.add_dvl(
            world, on * (i.dvl_v_m @ np.array(self.matrix).T + self.noise * noise)
        )


@dataclass(frozen=True, kw_only=True)
class DvlFish(Fault):
    """For ``length_s`` each ``every_s`` pings are of something that moves at ``speed`` [m/s]."""

    DRAWS: ClassVar[bool] = True
    speed: float
    length_s: float
    every_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose pings are of fish or ice, of another direction each time."""
        stamps = world.inputs.dvl_stamps_ns
        since_s = worlds.seconds(world, stamps) - self.start_s
        on = (since_s >= 0.0) & (np.mod(since_s, self.every_s) < self.length_s)
        number = np.maximum(since_s // self.every_s, 0.0).astype(np.int64)
        angles = worlds.drawn(world, 'dvl_fish').uniform(0.0, 2.0 * np.pi, int(number.max()) + 1)
        a = angles[number]
        v_G = self.speed * on[:, None] * np.column_stack([np.cos(a), np.sin(a), 0.0 * a])
        return worlds.add_dvl(
            world, -scale * worlds.to_body(worlds.attitude_at(world, stamps), v_G)
        )


@dataclass(frozen=True, kw_only=True)
class DvlRounded(Fault):
    """Velocities rounded to ``step`` [m/s] on each axis."""

    step: float

    def applied(self, world: World, scale: float) -> World:
        """World with rounded velocities."""
        v = world.inputs.dvl_v_m
        on = self._on(worlds.seconds(world, world.inputs.dvl_stamps_ns))
        return worlds.add_dvl(world, scale * on * (self.step * np.round(v / self.step) - v))


@dataclass(frozen=True, kw_only=True)
class DepthGain(Fault):
    """Depth too large by a share, above its ``limit_m`` cut off, trailing by ``tau_s``."""

    scale: float = 0.0
    limit_m: float = math.inf
    tau_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose barometer is so."""
        i = world.inputs
        t = worlds.seconds(world, i.depth_stamps_ns)
        seen = np.minimum(i.depth, self.limit_m) * (1.0 + self.scale)
        if self.tau_s:
            kept = np.exp(-np.diff(t, prepend=t[0]) / self.tau_s)
            last = float(seen[0])
            for k, x in enumerate(seen.tolist()):
                last = x + float(kept[k]) * (last - x)
                seen[k] = last
        return worlds.add_depth(world, scale * self._on(t)[:, 0] * (seen - i.depth))


@dataclass(frozen=True, kw_only=True)
class DepthSpikes(Fault):
    """A share of depths that are too large by ``size_m``."""

    DRAWS: ClassVar[bool] = True
    share: float
    size_m: float

    def applied(self, world: World, scale: float) -> World:
        """World whose depth has spikes."""
        t = worlds.seconds(world, world.inputs.depth_stamps_ns)
        bad = worlds.drawn(world, 'depth_spikes').random(len(t)) < self.share
        return worlds.add_depth(world, scale * self.size_m * self._on(t)[:, 0] * bad)
