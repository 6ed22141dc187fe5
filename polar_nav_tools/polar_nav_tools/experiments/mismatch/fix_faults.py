"""More faults of position fixes in an inertial vehicle's world; the others: faults.py."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.grid import ecef_to_grid

from ..world import World
from . import worlds
from .faults import Fault

_EAST = np.array([1.0, 0.0, 0.0])
_SIDE = np.array([0.6, 0.8, 0.0])


@dataclass(frozen=True, kw_only=True)
class FixSwitches(Fault):
    """Fixes that jump to another solution and back: ``offset_m`` off in each second half."""

    offset_m: float
    period_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes have two solutions."""
        t = worlds.seconds(world, worlds.validities(world)) - self.start_s
        other = (t >= 0.0) & (np.mod(t, self.period_s) < 0.5 * self.period_s)
        return worlds.move_fixes(world, scale * self.offset_m * other[:, None] * _SIDE)


@dataclass(frozen=True, kw_only=True)
class FixWaves(Fault):
    """Fixes that swing about the truth by ``amplitude_m`` with a period, on a circle."""

    amplitude_m: float
    period_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes swing."""
        t = worlds.seconds(world, worlds.validities(world)) - self.start_s
        angle = 2.0 * np.pi / self.period_s * np.maximum(t, 0.0)
        error_G = np.column_stack([np.sin(angle), 1.0 - np.cos(angle), np.zeros(len(t))])
        return worlds.move_fixes(world, scale * self.amplitude_m * error_G)


@dataclass(frozen=True, kw_only=True)
class FixWalks(Fault):
    """Fixes whose common error walks, by ``density`` per axis [m/sqrt(s)]."""

    DRAWS: ClassVar[bool] = True
    density: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes wander off."""
        t = worlds.seconds(world, worlds.validities(world)) - self.start_s
        order = np.argsort(t, kind='stable')
        steps = np.diff(np.maximum(t[order], 0.0), prepend=0.0)
        noise = worlds.drawn(world, 'fix_walk').standard_normal((len(t), 2))
        walk = np.zeros((len(t), 3))
        walk[order, :2] = np.cumsum(np.sqrt(steps)[:, None] * noise, axis=0)
        return worlds.move_fixes(world, scale * self.density * walk)


@dataclass(frozen=True, kw_only=True)
class FixMirrored(Fault):
    """Left and right confused by an array ``distance_m`` away, for a time or a share of fixes."""

    DRAWS: ClassVar[bool] = True
    distance_m: float
    length_s: float = math.inf
    share: float = 1.0

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes lie on the leader's other side."""
        t = worlds.seconds(world, worlds.validities(world)) - self.start_s
        on = (t >= 0.0) & (t < self.length_s)
        on &= worlds.drawn(world, 'fix_mirrored').random(len(t)) < self.share
        off_G = 2.0 * self.distance_m * worlds.abeam_G(world)
        return worlds.move_fixes(world, scale * on[:, None] * off_G)


@dataclass(frozen=True, kw_only=True)
class FixTimes(Fault):
    """Validity stated late by a time that differs from fix to fix, up to ``most_s``."""

    DRAWS: ClassVar[bool] = True
    most_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes state other times."""
        t = worlds.seconds(world, worlds.validities(world))
        late_s = worlds.drawn(world, 'fix_times').uniform(0.0, self.most_s, len(t))
        late_s *= t >= self.start_s
        return worlds.restamp_fixes(world, [round(scale * x * 1e9) for x in late_s])


@dataclass(frozen=True, kw_only=True)
class FixRounded(Fault):
    """Horizontal positions rounded to ``step_m`` on each grid axis."""

    step_m: float

    def applied(self, world: World, scale: float) -> World:
        """World with rounded positions."""
        r_e = np.array([f.r_e for f in world.inputs.fixes])
        place_G = worlds.from_start_G(world, r_e)
        error_G = self.step_m * np.round(place_G / self.step_m) - place_G
        on = scale * self._on(worlds.seconds(world, worlds.validities(world)))
        return worlds.move_fixes(world, on * error_G * np.array([1.0, 1.0, 0.0]))


@dataclass(frozen=True, kw_only=True)
class FixTwoSenders(Fault):
    """Every second fix is of another sender, whose positions are ``offset_m`` off."""

    offset_m: float

    def applied(self, world: World, scale: float) -> World:
        """World with two senders."""
        fixes = world.inputs.fixes
        second = np.array([f.sequence % 2 == 1 for f in fixes], dtype=np.float64)
        on = self._on(worlds.seconds(world, worlds.validities(world)))
        moved = worlds.move_fixes(world, scale * self.offset_m * on * second[:, None] * _EAST)
        named = (
            replace(f, source=f'{f.source}_2') if s and b else f
            for f, s, b in zip(moved.inputs.fixes, second, on[:, 0], strict=True)
        )
        return world.with_fixes(tuple(named))


@dataclass(frozen=True, kw_only=True)
class FixOffOnCourse(Fault):
    """Fixes ``offset_m`` off while the vehicle sails away from where it started."""

    offset_m: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes depend on the course, as with an array in a ship's shadow."""
        v_G = worlds.truth_of_fixes(world).v_G
        ahead = np.array(worlds.abeam_G(world))[[1, 0, 2]] * np.array([1.0, -1.0, 0.0])
        on = self._on(worlds.seconds(world, worlds.validities(world)))
        shadow = ((v_G @ ahead) > 0.0)[:, None]
        return worlds.move_fixes(world, scale * self.offset_m * on * shadow * _SIDE)


@dataclass(frozen=True, kw_only=True)
class FixSmoothed(Fault):
    """Positions of a box that filters them by first order, ``tau_s``."""

    tau_s: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes trail behind."""
        stamps = worlds.validities(world)
        t = worlds.seconds(world, stamps)
        r_e = np.array([f.r_e for f in world.inputs.fixes])
        place_G = worlds.from_start_G(world, r_e)
        smooth_G, last_s = np.array(place_G), -math.inf
        last_G: Array = np.zeros(3)
        for k in np.argsort(stamps, kind='stable'):
            kept = math.exp(-(t[k] - last_s) / self.tau_s)
            last_G = place_G[k] + kept * (last_G - place_G[k])
            last_s, smooth_G[k] = t[k], last_G
        first_G = np.asarray(ecef_to_grid(world.truth.state(world.truth.start_ns).r_e))
        moved = (smooth_G - place_G) @ first_G  # ECEF
        here_G = np.einsum('nij,nj->ni', worlds.truth_of_fixes(world).C_e_G, moved)
        on = scale * self._on(t)
        return worlds.move_fixes(world, on * here_G)


@dataclass(frozen=True, kw_only=True)
class FixHeight(Fault):
    """Fixes too high [m]."""

    up_m: float

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes are too high."""
        on = scale * self._on(worlds.seconds(world, worlds.validities(world)))
        return worlds.move_fixes(world, on * self.up_m * np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, kw_only=True)
class FrameDrifts(Fault):
    """Seen from a leader abeam: ranges that grow to a share, an array that turns [deg/h]."""

    scale: float = 0.0
    ramp_s: float = 1.0
    turn_dph: float = 0.0
    distance_m: float = 1000.0

    def applied(self, world: World, scale: float) -> World:
        """World whose fixes go by the leader's frame."""
        t = np.maximum(worlds.seconds(world, worlds.validities(world)) - self.start_s, 0.0)
        line_G = np.tile(-self.distance_m * worlds.abeam_G(world), (len(t), 1))
        across_G = np.column_stack([-line_G[:, 1], line_G[:, 0], np.zeros(len(t))])
        grown = self.scale * np.clip(t / self.ramp_s, 0.0, 1.0)
        angle = math.radians(self.turn_dph) / 3600.0 * t
        seen = worlds.see_fixes_along(world, line_G)
        moved = grown[:, None] * line_G + angle[:, None] * across_G
        return worlds.move_fixes(seen, scale * moved)


@dataclass(frozen=True, kw_only=True)
class Both(Fault):
    """Two faults at once; it begins with the earlier one."""

    one: Fault
    other: Fault

    def applied(self, world: World, scale: float) -> World:
        """World with both."""
        return self.other.applied(self.one.applied(world, scale), scale)

    def is_drawn(self) -> bool:
        """Whether one of them has another shape at each seed."""
        return self.one.is_drawn() or self.other.is_drawn()


def both(one: Fault, other: Fault) -> Both:
    """Both faults, with the beginning of the earlier one."""
    return Both(one=one, other=other, start_s=min(one.start_s, other.start_s))
