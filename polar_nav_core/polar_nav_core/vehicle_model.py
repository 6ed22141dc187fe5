"""Reduced dynamic model of a vehicle in moving water, and its drag in other words.

The equations stand in kernels.vehicle_model; docs/derivations/vehicle_model.md derives them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Array
from .kernels.vehicle import model as kernels


@dataclass(frozen=True)
class VehicleModel:
    """Inertia and drag of three translations.

    Attributes
    ----------
    inertia : (3,) array
        Mass plus added mass: surge, sway, heave [kg].
    drag_linear, drag_quadratic : (3,) arrays
        d1 [N s/m], d2 [N s^2/m^2].
    net_buoyancy : float
        Buoyancy minus weight [N]: positive lifts.
    """

    inertia: Array
    drag_linear: Array
    drag_quadratic: Array
    net_buoyancy: float

    @classmethod
    def of(
        cls,
        mass: float,
        added_mass: Sequence[float],
        drag_linear: Sequence[float],
        drag_quadratic: Sequence[float],
        net_buoyancy: float,
    ) -> VehicleModel:
        """Make the model of a mass [kg] and positive added masses [kg]."""
        return cls(
            mass + np.asarray(added_mass, dtype=np.float64),
            np.array(drag_linear, dtype=np.float64),
            np.array(drag_quadratic, dtype=np.float64),
            float(net_buoyancy),
        )

    def acceleration(self, v_r_b: Array, omega_b: Array, C_b_G: Array, force_b: Array) -> Array:
        """v_r' in body axes [m/s^2], shape (3,); C_b_G (3, 3), its last row is the vertical."""
        a_b = np.empty(3)
        kernels.relative_acceleration(
            a_b,
            v_r_b,
            omega_b,
            np.ascontiguousarray(C_b_G[2]),
            force_b,
            self.inertia,
            self.drag_linear,
            self.drag_quadratic,
            self.net_buoyancy,
        )
        return a_b

    def total_drag(self, speed: float) -> float:
        """Surge drag at a speed [N]."""
        return float((self.drag_linear[0] + self.drag_quadratic[0] * speed) * speed)

    def logarithmic_drag(self, speed: float) -> tuple[float, float]:
        """Surge drag at a speed as (ln Dt, f): total Dt, and its quadratic share f."""
        total = self.total_drag(speed)
        return math.log(total), float(self.drag_quadratic[0]) * speed * speed / total


def steady_speed(force: float, drag_linear: float, drag_quadratic: float) -> float:
    """Surge speed at which drag equals thrust [m/s], stable as d2 goes to 0.

    v = 2 tau / (d1 + sqrt(d1^2 + 4 d2 |tau|)).
    """
    root = math.sqrt(drag_linear * drag_linear + 4.0 * drag_quadratic * abs(force))
    return 2.0 * force / (drag_linear + root)
