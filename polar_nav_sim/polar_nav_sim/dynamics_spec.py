"""Section ``vehicles.<name>.dynamics`` of a mission file: a vehicle with dynamics.

Defaults are those of the DVL-less paper (Drones 2025, 9(4), 299) where it has them: added mass and
drag; the rest (inertia, thrust, loops, current) is a choice of this project.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import param, vector

from .kernels import dynamics as kernels
from .section import Spec, parse

Floats = NDArray[np.float64]

GRAVITY = 9.81
"""Of the weight [m/s^2]; only its moment about the centre of buoyancy depends on it."""


@dataclass(frozen=True)
class BodySpec(Spec):
    """Inertia, drag and buoyancy; six numbers are surge, sway, heave, roll, pitch, yaw."""

    mass_kg: float = param(100.0, 'kg', 1.0, 1e5, 'Mass')
    inertia: tuple[float, ...] = vector(
        (2.0, 20.0, 20.0), 'kg m^2', 1e-3, 1e7, 'Moments of inertia about base_link'
    )
    added_mass: tuple[float, ...] = vector(
        (1.8, 76.5, 76.5, 0.05, 0.23, 0.23), 'kg, kg m^2', 0.0, 1e7, 'Added mass, positive'
    )
    drag_linear: tuple[float, ...] = vector(
        (25.0, 105.0, 105.0, 0.1, 5.5, 5.5), 'N s/m, N m s', 0.0, 1e6, 'Drag per speed'
    )
    drag_quadratic: tuple[float, ...] = vector(
        (19.0, 105.0, 105.0, 0.1, 5.5, 5.5), 'N s^2/m^2, N m s^2', 0.0, 1e6, 'Per speed squared'
    )
    net_buoyancy_n: float = param(5.0, 'N', -1e4, 1e4, 'Buoyancy minus weight')
    centre_of_mass_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -10.0, 10.0, 'From base_link, body axes'
    )
    centre_of_buoyancy_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.02), 'm', -10.0, 10.0, 'From base_link, body axes'
    )

    def body(self) -> kernels.Body:
        """Return the values in the form of the kernel."""
        r_g = np.array(self.centre_of_mass_b)
        x, y, z = (self.mass_kg * r_g).tolist()
        couple = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        inertia = np.diag(self.inertia)
        added = np.array(self.added_mass)
        rigid = np.block([[self.mass_kg * np.eye(3), -couple], [couple, inertia]])
        weight = self.mass_kg * GRAVITY
        return kernels.Body(
            inverse=np.ascontiguousarray(np.linalg.inv(rigid + np.diag(added))),
            mass=self.mass_kg,
            r_g=r_g,
            inertia=inertia,
            added=added,
            drag_linear=np.array(self.drag_linear),
            drag_quadratic=np.array(self.drag_quadratic),
            weight=weight,
            buoyancy=weight + self.net_buoyancy_n,
            r_b=np.array(self.centre_of_buoyancy_b),
        )


@dataclass(frozen=True)
class CurrentSpec(Spec):
    """Velocity of the water: constant, or its speed and direction swing as sines of time."""

    velocity_mps: tuple[float, ...] = vector(
        (0.4, 0.25), 'm/s', -10.0, 10.0, 'At the start: towards grid east, grid north'
    )
    rise_mps: float = param(0.0, 'm/s', -1.0, 1.0, 'Upwards, constant')
    change: float = param(0.0, '', -1.0, 1.0, 'Amplitude of the speed, as a share of it')
    turn_deg: float = param(0.0, 'deg', -180.0, 180.0, 'Amplitude of the direction, to port')
    period_s: float = param(1800.0, 's', 1.0, 1e6, 'Of both sines')

    def water(self) -> kernels.Water:
        """Return the values in the form of the kernel."""
        x, y = self.velocity_mps
        return kernels.Water(
            speed=math.hypot(x, y),
            direction=math.atan2(y, x),
            rise=self.rise_mps,
            change=self.change,
            turn=math.radians(self.turn_deg),
            period=self.period_s,
        )

    def at(self, t_s: Floats) -> Floats:
        """Velocity at times [m/s], reference axes, shape (n, 3)."""
        w = self.water()
        s = np.sin(2.0 * np.pi / w.period * t_s)
        speed, angle = w.speed * (1.0 + w.change * s), w.direction + w.turn * s
        return np.stack(
            [speed * np.cos(angle), speed * np.sin(angle), np.full_like(s, w.rise)], axis=-1
        )


_LAW = 'mean, then amplitude, rate [rad/s], phase [rad] of two sines of time'


@dataclass(frozen=True)
class LawSpec(Spec):
    """Heading and speed of a vehicle without commands; its depth is the vehicle's depth_m."""

    surge_n: tuple[float, ...] = vector(
        (52.0, 18.0, 0.05, 0.0, 14.0, 0.013, 0.0), 'N', -1e4, 1e4, f'Thrust ahead: {_LAW}'
    )
    heading_rad: tuple[float, ...] = vector(
        (0.3, 1.9, 0.011, 0.0, 0.45, 0.037, 0.0),
        'rad',
        -100.0,
        100.0,
        f'psi, counter-clockwise from grid east: {_LAW}',
    )
    speed_mps: float = param(
        0.0, 'm/s', 0.0, 20.0, 'Speed through the water to hold; 0: thrust by surge_n'
    )
    excitation: float = param(1.0, '', 0.0, 10.0, 'Factor of the amplitudes of surge_n')


@dataclass(frozen=True)
class LoopsSpec(Spec):
    """Gains and limits of the loops.

    Without at least the Munk moment's slope, (a33 - a11) u w per pitch, a pitch loop dives.
    """

    heading_gain: float = param(200.0, 'N m/rad', 0.0, 1e6, 'Heading')
    heading_damping: float = param(120.0, 'N m s', 0.0, 1e6, 'Yaw rate')
    pitch_gain: float = param(400.0, 'N m/rad', 0.0, 1e6, 'Pitch')
    pitch_damping: float = param(200.0, 'N m s', 0.0, 1e6, 'Pitch rate')
    depth_gain: float = param(30.0, 'N/m', 0.0, 1e6, 'Depth')
    depth_damping: float = param(150.0, 'N s/m', 0.0, 1e6, 'Vertical velocity')
    speed_gain: float = param(100.0, 'N s/m', 0.0, 1e6, 'Speed through the water')
    limits: tuple[float, ...] = vector(
        (150.0, 0.0, 100.0, 0.0, 100.0, 60.0), 'N, N m', 0.0, 1e6, 'Largest thrust, torque'
    )


@dataclass(frozen=True)
class DynamicsSpec:
    """A vehicle that moves by its own dynamics."""

    body: BodySpec = BodySpec()
    current: CurrentSpec = CurrentSpec()
    law: LawSpec = LawSpec()
    loops: LoopsSpec = LoopsSpec()

    def kernel_loops(
        self, depth: float, origin_depth: float, half_curvature: float
    ) -> kernels.Loops:
        """Return law and loops in the form of the kernel; depths [m], 1 / (2 R) [1/m]."""
        loops, surge = self.loops, np.array(self.law.surge_n)
        surge[[1, 4]] *= self.law.excitation
        return kernels.Loops(
            surge=surge,
            heading=np.array(self.law.heading_rad),
            depth=depth,
            speed=self.law.speed_mps if self.law.speed_mps > 0.0 else math.nan,
            gains=np.array(
                [
                    loops.heading_gain,
                    loops.heading_damping,
                    loops.pitch_gain,
                    loops.pitch_damping,
                    loops.depth_gain,
                    loops.depth_damping,
                    loops.speed_gain,
                ]
            ),
            limits=np.array(loops.limits),
            origin_depth=origin_depth,
            half_curvature=half_curvature,
        )


def dynamics_of(values: object, where: str) -> DynamicsSpec:
    """Dynamics of a vehicle from its mapping in a file.

    Raises
    ------
    ConfigError
        Naming the file, the section and the key.
    """
    if not isinstance(values, Mapping):
        raise ConfigError(f'{where}: expected body, current, law and loops, found {values!r}')
    kinds = {'body': BodySpec, 'current': CurrentSpec, 'law': LawSpec, 'loops': LoopsSpec}
    unknown = sorted(set(values) - {f.name for f in fields(DynamicsSpec)})
    if unknown:
        raise ConfigError(f'{where}: unknown {unknown[0]!r}; it has {", ".join(kinds)}')
    return DynamicsSpec(**{k: parse(kinds[k], v or {}, f'{where}.{k}') for k, v in values.items()})
