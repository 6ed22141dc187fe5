"""Faults of one IMU: its axes, its stamps, its samples; what they have in common: faults.py."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_sim.sensors.imu import DPH

from ..world import World
from . import worlds
from .faults import UG, Fault


@dataclass(frozen=True, kw_only=True)
class ImuSkew(Fault):
    """Axes of gyros and accelerometers that are not at right angles [deg]."""

    deg: float

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU measures along skew axes."""
        i = world.inputs
        a = scale * math.radians(self.deg)
        M = a * np.array([[0.0, 1.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])
        on = self._on(worlds.seconds(world, i.imu_stamps_ns))
        return worlds.add_imu(world, on * (i.omega_ib_b @ M.T), on * (i.f_b @ M.T))


@dataclass(frozen=True, kw_only=True)
class ImuWarms(Fault):
    """Biases of all axes that settle to another value with a time constant [s]."""

    gyro_dph: float
    accel_ug: float
    tau_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU takes on another temperature."""
        since_s = worlds.seconds(world, world.inputs.imu_stamps_ns) - self.start_s
        grown = scale * (1.0 - np.exp(-np.maximum(since_s, 0.0) / self.tau_s))
        share = grown[:, None] * np.array([1.0, -1.0, 1.0])
        return worlds.add_imu(world, self.gyro_dph * DPH * share, self.accel_ug * UG * share)


@dataclass(frozen=True, kw_only=True)
class ImuStamps(Fault):
    """Stamps that are late [s], scatter (1-sigma) [s] or are rounded down to a tick [s]."""

    DRAWS: ClassVar[bool] = True
    late_s: float = 0.0
    jitter_s: float = 0.0
    tick_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose samples have these stamps, in their order."""
        i = world.inputs
        stamps = i.imu_stamps_ns
        since_s = worlds.seconds(world, stamps)
        rest_s = np.mod(since_s, self.tick_s) if self.tick_s else 0.0
        # A jitter beyond four tenths of an interval would turn the order round.
        most_s = 0.4 / world.spec.imu_rate_hz
        noise = worlds.drawn(world, 'imu_stamps').standard_normal(len(stamps))
        jitter_s = np.clip(self.jitter_s * noise, -most_s, most_s)
        moved_s = scale * (since_s >= self.start_s) * (self.late_s + jitter_s - rest_s)
        later = stamps + np.round(1e9 * moved_s).astype(np.int64)
        return replace(world, inputs=replace(i, imu_stamps_ns=later))


@dataclass(frozen=True, kw_only=True)
class ImuBursts(Fault):
    """Samples missing for ``length_s`` each ``every_s``, on average."""

    DRAWS: ClassVar[bool] = True
    every_s: float
    length_s: float

    def applied(self, world: World, scale: float) -> World:
        """World without these samples; a part of a gap is none."""
        if scale < 1.0:
            return world
        i = world.inputs
        t = worlds.seconds(world, i.imu_stamps_ns)
        rng = worlds.drawn(world, 'imu_bursts')
        number = round((float(t[-1]) - self.start_s) / self.every_s)
        gone = np.zeros(len(t), dtype=bool)
        for begin_s in rng.uniform(self.start_s, float(t[-1]) - self.length_s, number):
            gone |= (t >= begin_s) & (t < begin_s + self.length_s)
        kept = replace(
            i,
            imu_stamps_ns=i.imu_stamps_ns[~gone],
            omega_ib_b=i.omega_ib_b[~gone],
            f_b=i.f_b[~gone],
        )
        return replace(world, inputs=kept)


@dataclass(frozen=True, kw_only=True)
class ImuAxisStuck(Fault):
    """One axis of the gyros or of the accelerometers repeats its last value."""

    axis: int
    gyro: bool

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU has the dead axis, while the others go on."""
        i = world.inputs
        on = self._on(worlds.seconds(world, i.imu_stamps_ns))[:, 0]
        values = (i.omega_ib_b if self.gyro else i.f_b)[:, self.axis]
        error = np.zeros((len(on), 3))
        last = values[max(0, int(np.argmax(on)) - 1)]
        error[:, self.axis] = scale * on * (last - values)
        return worlds.add_imu(world, error if self.gyro else 0.0, 0.0 if self.gyro else error)


@dataclass(frozen=True, kw_only=True)
class ImuSpikes(Fault):
    """Single samples off by a rate [rad/s] and a force [m/s^2], each ``every_s`` on average."""

    DRAWS: ClassVar[bool] = True
    every_s: float
    rate: float
    force: float

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU has spikes to all sides."""
        i = world.inputs
        rng, n = worlds.drawn(world, 'imu_spikes'), len(i.imu_stamps_ns)
        hit = rng.random(n) < 1.0 / (self.every_s * world.spec.imu_rate_hz)
        on = scale * self._on(worlds.seconds(world, i.imu_stamps_ns)) * hit[:, None]
        side = rng.choice((-1.0, 1.0), size=(2, n, 3))
        return worlds.add_imu(world, on * self.rate * side[0], on * self.force * side[1])


@dataclass(frozen=True, kw_only=True)
class ImuKick(Fault):
    """A turn about an axis of the body by an angle [deg] that is measured and never was.

    Or one that was and is not measured, as by gyros that saturate in a collision. Longer than a
    sample: a single one that leaps is refused.
    """

    deg: float
    axis: int
    length_s: float = 0.1

    def applied(self, world: World, scale: float) -> World:
        """World whose gyros have the turn too much."""
        since_s = worlds.seconds(world, world.inputs.imu_stamps_ns) - self.start_s
        hit = (since_s > 0.0) & (since_s <= self.length_s)
        error = np.zeros((len(hit), 3))
        error[:, self.axis] = scale * math.radians(self.deg) / self.length_s * hit
        return worlds.add_imu(world, error)


@dataclass(frozen=True, kw_only=True)
class ImuAxesMistaken(Fault):
    """The IMU's axes are taken for others: signs of x, y, z."""

    signs: tuple[float, float, float]

    def applied(self, world: World, scale: float) -> World:
        """World whose rates and forces have these signs."""
        i = world.inputs
        change: Array = scale * (np.array(self.signs) - 1.0)
        on = self._on(worlds.seconds(world, i.imu_stamps_ns))
        return worlds.add_imu(world, on * i.omega_ib_b * change, on * i.f_b * change)


@dataclass(frozen=True, kw_only=True)
class StartSwapped(Fault):
    """Initial latitude and longitude in each other's place."""

    def applied(self, world: World, scale: float) -> World:
        """World that starts there, or a share of the way to it."""
        lat, lon = 'initial_latitude_deg', 'initial_longitude_deg'
        off = scale * (world.initial[lon] - world.initial[lat])
        changed = {lat: world.initial[lat] + off, lon: world.initial[lon] - off}
        return replace(world, initial={**world.initial, **changed})
