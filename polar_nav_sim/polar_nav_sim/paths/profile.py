"""Course and flight path angle as smooth functions of time, for paths made of legs.

Every change of angle follows the same step S(tau) = tau - sin(2 pi tau)/(2 pi), whose first two
derivatives vanish at both ends: acceleration and angular acceleration of the vehicle are
continuous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError

from ..specs import DiveSpec, LegsSpec, PathSpec, RacetrackSpec

Floats = NDArray[np.float64]

PEAK_RATE = 2.0
"""Largest slope of S: a change runs at most this much faster than its mean."""


def step(tau: Floats) -> Floats:
    """S(tau), 0 before 0 and 1 after 1."""
    t = np.clip(tau, 0.0, 1.0)
    return np.asarray(t - np.sin(2.0 * np.pi * t) / (2.0 * np.pi))


@dataclass(frozen=True)
class Change:
    """A change of one angle."""

    start_s: float
    duration_s: float
    amount: float
    """Angle after minus angle before [rad]."""


@dataclass(frozen=True)
class Profile:
    """Speed, and the changes of course and flight path angle."""

    speed: float
    course: tuple[Change, ...] = ()
    climb: tuple[Change, ...] = ()

    def at(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Evaluate at times since the start of the mission.

        Returns
        -------
        course, climb : ndarray, shape (n,)
            Course relative to the initial one, counter-clockwise; angle above the horizontal
            [rad].
        """
        return _sum(self.course, t_s), _sum(self.climb, t_s)


def _sum(changes: tuple[Change, ...], t_s: Floats) -> Floats:
    total = np.zeros_like(t_s)
    for c in changes:
        total += c.amount * step((t_s - c.start_s) / c.duration_s)
    return total


def profile_of(spec: PathSpec, until_s: float, where: str) -> Profile:
    """Profile of one kind of path, long enough to last until ``until_s``.

    Raises
    ------
    ConfigError
        When turns or dives do not fit into the stated geometry.
    """
    if isinstance(spec, LegsSpec):
        return _legs(spec, until_s, where)
    if isinstance(spec, DiveSpec):
        return _dives(spec, until_s, where)
    return Profile(spec.speed_mps)


def _mean_over_step(amount: float) -> tuple[float, float]:
    """Means of cos and sin of amount S(tau) over tau in [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    angle = amount * step(0.5 * (nodes + 1.0))
    return 0.5 * float(weights @ np.cos(angle)), 0.5 * float(weights @ np.sin(angle))


def _legs(spec: LegsSpec, until_s: float, where: str) -> Profile:
    quarter = 0.5 * math.pi
    turn_s = PEAK_RATE * quarter * spec.turn_radius_m / spec.speed_mps
    turn_m = _mean_over_step(quarter)[1] * turn_s * spec.speed_mps
    if spec.spacing_m < 2.0 * turn_m:
        raise ConfigError(
            f'{where}: parameter spacing_m: {spec.spacing_m} is less than the {2.0 * turn_m:.1f} m'
            f' that two quarter turns of turn_radius_m {spec.turn_radius_m} need'
        )
    leg_s = spec.leg_m / spec.speed_mps
    cross_s = (spec.spacing_m - 2.0 * turn_m) / spec.speed_mps
    side = 1.0 if spec.first_turn == 'left' else -1.0
    changes = []
    t = leg_s
    while t < until_s:
        changes.append(Change(t, turn_s, side * quarter))
        changes.append(Change(t + turn_s + cross_s, turn_s, side * quarter))
        t += 2.0 * turn_s + cross_s + leg_s
        if not isinstance(spec, RacetrackSpec):
            side = -side
    return Profile(spec.speed_mps, course=tuple(changes))


def _dives(spec: DiveSpec, until_s: float, where: str) -> Profile:
    angle = math.radians(spec.dive_angle_deg)
    transition_m = _mean_over_step(angle)[1] * spec.transition_s * spec.speed_mps
    steady_m = spec.dive_m - 2.0 * transition_m
    if steady_m < 0.0:
        raise ConfigError(
            f'{where}: parameter dive_m: {spec.dive_m} is less than the {2.0 * transition_m:.1f} m'
            f' that going to dive_angle_deg {spec.dive_angle_deg} and back takes'
        )
    steady_s = steady_m / (spec.speed_mps * math.sin(angle))
    changes = []
    t, sign = spec.level_s, -1.0
    while t < until_s:
        changes.append(Change(t, spec.transition_s, sign * angle))
        changes.append(Change(t + spec.transition_s + steady_s, spec.transition_s, -sign * angle))
        t += 2.0 * spec.transition_s + steady_s + spec.level_s
        sign = -sign
    return Profile(spec.speed_mps, climb=tuple(changes))
