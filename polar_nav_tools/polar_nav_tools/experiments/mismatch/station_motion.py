"""Faults of station mode that move the vehicle: what drives it, holds it, or carries it away.

Its true motion is displaced: velocity through the water follows the plane surge-sway model with
the simulation's own mass and drag (`water_velocity`), position is its integral, and every fix is
measured anew from there. Attitude and acoustic delays stay those of the undisturbed run (30 m are
20 ms of sound).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_sim.offline_station import StationRun

from ..station.world import StationWorld
from .station_faults import StationFault, polar_of, time_s, with_fixes, wrapped

_STEP = 10
"""Samples of 10 ms per step of the surge-sway model."""


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
        grown = _grown(self, run)
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
        grown = _grown(self, run)
        unit = run.current[:, :2] / np.linalg.norm(run.current[:, :2], axis=1)[:, None]
        across = np.column_stack([-unit[:, 1], unit[:, 0]])
        return displaced(world, scale * self.speed_mps * grown[:, None] * across, current=True)


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
    valid_s = np.array([time_s(world, f.validity_ns) for f in world.inputs.fixes])
    d_fix = np.column_stack([np.interp(valid_s, run.t_s, moved[:, i]) for i in range(3)])
    true = run.fixes.true_position.copy()
    fixes = tuple(
        replace(f, polar=_seen_from(polar_of(f), true[k], true[k] + d_fix[k]))
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
    return with_fixes(replace(world, run=changed), fixes)


def _seen_from(p: PolarFix, before: Array, now: Array) -> PolarFix:
    """Measurement from a position with the errors drawn at another one."""
    a, b = before - p.station, now - p.station
    turn = math.atan2(b[1], b[0]) - math.atan2(a[1], a[0])
    longer = float(np.linalg.norm(b) - np.linalg.norm(a))
    return replace(p, range=p.range + longer, bearing=wrapped(p.bearing + turn))


def _grown(fault: DragGrows | CurrentBegins, run: StationRun) -> Array:
    """Share of a fault that has come by each sample (n,), 0 to 1."""
    return np.asarray(np.clip((run.t_s - fault.start_s) / fault.ramp_s, 0.0, 1.0))
