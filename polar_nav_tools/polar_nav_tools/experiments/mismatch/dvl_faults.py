"""Faults of DVL and depth in an inertial vehicle's world; what they have in common: faults.py."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core.engine.events import Array
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
