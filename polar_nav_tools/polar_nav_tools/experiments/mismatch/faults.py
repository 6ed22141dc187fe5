"""Faults of an inertial vehicle's world: one dataclass each, applied to the sensor streams.

``applied(world, scale)`` is the world with ``scale`` times the fault, so that 1 is the fault as
stated, 0 the same world without it, and small numbers its linear effect (visible.py). Errors that
are drawn come from the world's seed and grow with ``scale`` as they are. ``known`` holds engine
parameters that state a fault which no filter can remove from its inputs, ``for_all`` those set in
every filter; sizes are those of the row (rows.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import exp
from polar_nav_sim.sensors.imu import DPH, G0

from ..world import World
from . import worlds

MGAL = 1e-5
"""[m/s^2]."""
UG = 1e-6 * G0
"""[m/s^2]."""
EARTH_RADIUS = 6.4e6
"""Of the meridian near a pole [m]."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """No fault; base of all faults.

    Attributes
    ----------
    start_s : float
        When it begins, since the start of the run [s].
    known : mapping
        Engine parameters that state the fault, for the filter that knows it; empty if the fault
        is removed from that filter's inputs.
    for_all : mapping
        Engine parameters that belong to the fault and are set in every filter.
    obvious : bool
        Whether it is visible without any filter, as missing messages are.
    """

    DRAWS: ClassVar[bool] = False
    """Whether the seed of a world draws its shape."""
    start_s: float = 0.0
    known: Mapping[str, Any] = field(default_factory=dict)
    for_all: Mapping[str, Any] = field(default_factory=dict)
    obvious: bool = False

    def applied(self, world: World, scale: float) -> World:
        """World with ``scale`` times the fault."""
        del scale
        return world

    def is_drawn(self) -> bool:
        """Whether it has another shape at each seed, which is visible at another time."""
        return self.DRAWS

    def _on(self, time_s: Array) -> Array:
        """1 from the fault's start on, shape (n, 1)."""
        return np.asarray(time_s >= self.start_s, dtype=np.float64)[:, None]


@dataclass(frozen=True, kw_only=True)
class ImuStep(Fault):
    """Gyro and accelerometer bias on all axes, at once or as a ramp over ``ramp_s``."""

    gyro_dph: float = 0.0
    accel_ug: float = 0.0
    ramp_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU has the bias."""
        since_s = worlds.seconds(world, world.inputs.imu_stamps_ns) - self.start_s
        grown = (since_s >= 0.0).astype(np.float64)
        if self.ramp_s:
            grown = np.clip(since_s / self.ramp_s, 0.0, 1.0)
        share = scale * grown[:, None] * np.ones(3)
        return worlds.add_imu(world, self.gyro_dph * DPH * share, self.accel_ug * UG * share)


@dataclass(frozen=True, kw_only=True)
class GravitySwell(Fault):
    """Gravity anomaly as a sine of time, and the deflection of the vertical that goes with it.

    Outside of its masses a sine of gravity disturbance has a horizontal part of the same size
    along the track, a quarter of a period apart (a potential that decays upwards).
    """

    mgal: float
    period_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose accelerometers feel the swell."""
        stamps = world.inputs.imu_stamps_ns
        angle = 2.0 * np.pi / self.period_s * (worlds.seconds(world, stamps) - self.start_s)
        v_G = world.truth.state(int(stamps[0])).v_G
        ahead_G = np.array([v_G[0], v_G[1], 0.0]) / math.hypot(v_G[0], v_G[1])
        up_G = np.array([0.0, 0.0, 1.0])
        # From zero at the start: the alignment has removed any earlier deflection.
        swell_G = np.sin(angle)[:, None] * up_G + (np.cos(angle)[:, None] - 1.0) * ahead_G
        on = self._on(worlds.seconds(world, stamps))
        d_f_b = worlds.to_body(worlds.attitude_at(world, stamps), on * swell_G)
        return worlds.add_imu(world, d_f_b=scale * self.mgal * MGAL * d_f_b)


@dataclass(frozen=True, kw_only=True)
class ImuGain(Fault):
    """Scale factors [ppm], one misalignment of all axes [arcsec], g-dependence [deg/h/g]."""

    gyro_ppm: float = 0.0
    accel_ppm: float = 0.0
    misalignment_arcsec: float = 0.0
    g_dependence_dph: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU has these gains."""
        i = world.inputs
        angle = math.radians(self.misalignment_arcsec / 3600.0)
        skew = angle * np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
        on = scale * self._on(worlds.seconds(world, i.imu_stamps_ns))
        d_omega_b = 1e-6 * self.gyro_ppm * i.omega_ib_b + i.omega_ib_b @ skew.T
        d_omega_b = d_omega_b + self.g_dependence_dph * DPH / G0 * i.f_b
        return worlds.add_imu(world, on * d_omega_b, on * 1e-6 * self.accel_ppm * i.f_b)


@dataclass(frozen=True, kw_only=True)
class ImuNoise(Fault):
    """Further white noise of the IMU, as by vibration or by an IMU below the stated class."""

    DRAWS: ClassVar[bool] = True
    gyro_density: float
    accel_density: float

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU has the noise, [rad/s/sqrt(Hz)] and [m/s^2/sqrt(Hz)]."""
        n = len(world.inputs.imu_stamps_ns)
        noise = worlds.drawn(world, 'imu').standard_normal((2, n, 3))
        on = scale * self._on(worlds.seconds(world, world.inputs.imu_stamps_ns))
        root = math.sqrt(world.spec.imu_rate_hz)
        return worlds.add_imu(
            world,
            on * self.gyro_density * root * noise[0],
            on * self.accel_density * root * noise[1],
        )


@dataclass(frozen=True, kw_only=True)
class ImuBlow(Fault):
    """A blow [g] for a time [s] that the IMU feels and the vehicle does not follow."""

    g: float
    length_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose accelerometers feel the blow."""
        since_s = worlds.seconds(world, world.inputs.imu_stamps_ns) - self.start_s
        hit = ((since_s >= 0.0) & (since_s < self.length_s))[:, None]
        return worlds.add_imu(world, d_f_b=scale * self.g * G0 * hit * np.array([1.0, 0.3, 0.2]))


@dataclass(frozen=True, kw_only=True)
class ImuTurned(Fault):
    """The IMU turns in its mount by an angle about an axis of the body [deg]."""

    deg: float
    axis: tuple[float, float, float]

    def applied(self, world: World, scale: float) -> World:
        """World whose IMU measures in turned axes."""
        i = world.inputs
        C = exp(math.radians(scale * self.deg) * np.array(self.axis)) - np.eye(3)
        on = self._on(worlds.seconds(world, i.imu_stamps_ns))
        return worlds.add_imu(world, on * (i.omega_ib_b @ C.T), on * (i.f_b @ C.T))


@dataclass(frozen=True, kw_only=True)
class StartOff(Fault):
    """Initial position off to the north [m], with its sigma as it was."""

    north_m: float

    def applied(self, world: World, scale: float) -> World:
        """World that starts in the wrong place."""
        name = 'initial_latitude_deg'
        latitude_deg = world.initial[name] + math.degrees(scale * self.north_m / EARTH_RADIUS)
        return replace(world, initial={**world.initial, name: latitude_deg})


@dataclass(frozen=True, kw_only=True)
class HeadingStart(Fault):
    """Initial heading off, with the sigma set in every filter."""

    error_deg: float

    def applied(self, world: World, scale: float) -> World:
        """World that starts with the wrong heading."""
        name = 'initial_grid_heading_deg'
        heading_deg = (world.initial[name] + scale * self.error_deg + 180.0) % 360.0 - 180.0
        return replace(world, initial={**world.initial, name: heading_deg})


@dataclass(frozen=True, kw_only=True)
class FixOffset(Fault):
    """Fixes off by a constant along grid east [m], or by an offset that grows [m/s]."""

    offset_m: float = 0.0
    drift_mps: float = 0.0
    length_s: float = math.inf

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes are off."""
        since_s = worlds.seconds(world, worlds.validities(world)) - self.start_s
        on = (since_s >= 0.0) & (since_s < self.length_s)
        size = scale * on * (self.offset_m + self.drift_mps * since_s)
        return worlds.move_fixes(world, size[:, None] * np.array([1.0, 0.0, 0.0]))


@dataclass(frozen=True, kw_only=True)
class LeaderFrame(Fault):
    """Ranges too long by a share and the array turned [deg], seen from a leader abeam.

    A leader in formation keeps its distance; one that stays is left behind.
    """

    scale: float = 0.0
    turn_deg: float = 0.0
    distance_m: float = 1000.0
    formation: bool = True

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes are off by the leader's range scale and array turn."""
        leader_G = self.distance_m * worlds.abeam_G(world)
        line_G = np.tile(-leader_G, (len(world.inputs.fixes), 1))
        if not self.formation:
            line_G = line_G + worlds.from_start_G(world, worlds.truth_of_fixes(world).r_e)
        a = math.radians(self.turn_deg)
        across_G = np.column_stack([-line_G[:, 1], line_G[:, 0], np.zeros(len(line_G))])
        on = scale * self._on(worlds.seconds(world, worlds.validities(world)))
        flat_G = line_G * np.array([1.0, 1.0, 0.0])
        seen = worlds.see_fixes_along(world, line_G)
        return worlds.move_fixes(seen, on * (self.scale * flat_G + a * across_G))


@dataclass(frozen=True, kw_only=True)
class LeaderOwn(Fault):
    """A leader that navigates: its error is common to all fixes, its sigma right for each one."""

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes carry the leader's error; the stated covariance holds its sigma."""
        duration_s = world.spec.duration_s
        d = _drift(duration_s, world.seed)
        t = worlds.seconds(world, worlds.validities(world))
        port_G = worlds.abeam_G(world)
        ahead_G = np.array([port_G[1], -port_G[0], 0.0])
        axes = ((d.along, d.sigma_along, ahead_G), (d.cross, d.sigma_cross, port_G))
        moved = sum(np.interp(t, d.time_s, e)[:, None] * axis for e, _, axis in axes)
        variance = sum(
            np.interp(t, d.time_s, s)[:, None, None] ** 2 * np.outer(axis, axis)
            for _, s, axis in axes
        )
        return worlds.move_fixes(world, scale * np.asarray(moved), np.asarray(variance))


@lru_cache(maxsize=4)
def _drift(duration_s: float, seed: int) -> Any:  # noqa: ANN401 - of leader_alone, imported late
    from polar_nav_tools.experiments import leader_alone

    return leader_alone.run(duration_s, seed)


@dataclass(frozen=True, kw_only=True)
class FixClock(Fault):
    """Validity stated late by a constant [s] and a rate [ppm]."""

    offset_s: float = 0.0
    rate_ppm: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes state other times."""
        since_s = worlds.seconds(world, worlds.validities(world)) - self.start_s
        late_s = (since_s >= 0.0) * (self.offset_s + 1e-6 * self.rate_ppm * since_s)
        return worlds.restamp_fixes(world, [round(scale * x * 1e9) for x in late_s])


@dataclass(frozen=True, kw_only=True)
class FixLever(Fault):
    """Transponder ahead of where it is stated to be [m], body axes."""

    lever_b: tuple[float, float, float]

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes are of another place of the vehicle."""
        C_b_G = worlds.truth_of_fixes(world).C_b_G
        on = scale * self._on(worlds.seconds(world, worlds.validities(world)))
        return worlds.move_fixes(world, on * (C_b_G @ np.array(self.lever_b)))


@dataclass(frozen=True, kw_only=True)
class FixOutliers(Fault):
    """A share of fixes off by ``low_m`` to ``high_m`` in any horizontal direction."""

    DRAWS: ClassVar[bool] = True
    share: float
    low_m: float = 10.0
    high_m: float = 30.0

    def applied(self, world: World, scale: float) -> World:
        """World with outliers."""
        rng, n = worlds.drawn(world, 'outliers'), len(world.inputs.fixes)
        bad = rng.random(n) < self.share
        angle, size = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(self.low_m, self.high_m, n)
        error_G = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
        on = self._on(worlds.seconds(world, worlds.validities(world)))
        return worlds.move_fixes(world, scale * on * (bad * size)[:, None] * error_G)


@dataclass(frozen=True, kw_only=True)
class FixOneSided(Fault):
    """A share of fixes off by the same vector for a time, as by one echo [m], [s]."""

    DRAWS: ClassVar[bool] = True
    share: float
    offset_m: float
    length_s: float

    def applied(self, world: World, scale: float) -> World:
        """World with one-sided outliers."""
        t = worlds.seconds(world, worlds.validities(world)) - self.start_s
        bad = worlds.drawn(world, 'one_sided').random(len(t)) < self.share
        on = bad & (t >= 0.0) & (t < self.length_s)
        return worlds.move_fixes(
            world, scale * self.offset_m * on[:, None] * np.array([0.6, 0.8, 0.0])
        )


@dataclass(frozen=True, kw_only=True)
class FixTails(Fault):
    """Further horizontal errors of fixes with heavy tails: Student's t, 2.5 degrees, scale [m]."""

    DRAWS: ClassVar[bool] = True
    sigma: float

    def applied(self, world: World, scale: float) -> World:
        """World with these errors."""
        t = worlds.seconds(world, worlds.validities(world))
        error = worlds.drawn(world, 'tails').standard_t(2.5, (len(t), 3))
        return worlds.move_fixes(
            world, scale * self.sigma * self._on(t) * error * np.array([1.0, 1.0, 0.0])
        )


@dataclass(frozen=True, kw_only=True)
class FixColoured(Fault):
    """Further errors of fixes, unstated: Gauss-Markov, or white for ``tau_s`` 0; horizontal."""

    DRAWS: ClassVar[bool] = True
    sigma: float
    tau_s: float = 0.0

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes have these errors; in the order of their validity."""
        stamps = worlds.validities(world)
        t, rng = worlds.seconds(world, stamps), worlds.drawn(world, 'fix_noise')
        noise = rng.standard_normal((len(t), 2))
        error, last, last_s = np.zeros((len(t), 3)), np.zeros(2), -math.inf
        for k in np.argsort(stamps, kind='stable'):
            kept = math.exp(-(t[k] - last_s) / self.tau_s) if self.tau_s else 0.0
            last = kept * last + math.sqrt(1.0 - kept * kept) * noise[k]
            last_s = t[k]
            error[k, :2] = self.sigma * last
        return worlds.move_fixes(world, scale * self._on(t) * error)


@dataclass(frozen=True, kw_only=True)
class FixOut(Fault):
    """No fix for a time [s]."""

    length_s: float = math.inf

    def applied(self, world: World, scale: float) -> World:
        """World without these fixes; a part of an outage is none."""
        if scale < 1.0:
            return world
        first_ns = world.truth.start_ns + round(self.start_s * 1e9)

        def kept(validity_ns: int) -> bool:
            return not 0 <= (validity_ns - first_ns) * 1e-9 < self.length_s

        return worlds.keep_fixes(world, lambda f: kept(f.validity_ns))
