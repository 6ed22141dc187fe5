"""Parameters and inputs of a run as if a constant had been stated otherwise.

Each function returns both with ``value`` added to what was stated; neither is changed in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from polar_nav_core.attitude import euler_from_matrix, exp, matrix_from_euler
from polar_nav_core.engine.events import Array, Fix
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.grid import ecef_to_grid

Move = Callable[[EngineParams, Inputs, float], tuple[EngineParams, Inputs]]


def _fixes(inputs: Inputs, change: Callable[[Fix], Fix]) -> Inputs:
    return replace(inputs, fixes=tuple(map(change, inputs.fixes)))


def delay(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Fixes that were valid so much [s] before their stated validity."""
    shift = round(value * 1e9)
    return params, _fixes(inputs, lambda f: replace(f, validity_ns=f.validity_ns - shift))


def clock_drift(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Fixes of a clock that runs fast by a share, from the first IMU sample on."""
    start_ns = int(inputs.imu_stamps_ns[0])

    def moved(f: Fix) -> Fix:
        return replace(f, validity_ns=f.validity_ns - round(value * (f.validity_ns - start_ns)))

    return params, _fixes(inputs, moved)


def range_scale(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Fixes whose stated ranges are too long by a share."""
    share = value / (1.0 + value)

    def moved(f: Fix) -> Fix:
        d = share * f.relative_e
        return replace(f, r_e=f.r_e - d, relative_e=f.relative_e - d)

    return params, _fixes(inputs, moved)


def array_yaw(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Fixes of an array that is turned by so much more [rad], counter-clockwise from above."""
    turn_G = exp(np.array([0.0, 0.0, value])) - np.eye(3)

    def moved(f: Fix) -> Fix:
        if not f.relative_e.any():
            return f
        C_e_G = np.asarray(ecef_to_grid(f.r_e - f.relative_e))
        d = C_e_G.T @ turn_G @ C_e_G @ f.relative_e
        heading = math.remainder(f.array_heading - value, 2.0 * math.pi)
        return replace(f, r_e=f.r_e + d, relative_e=f.relative_e + d, array_heading=heading)

    return params, _fixes(inputs, moved)


def turned(rpy_deg: tuple[float, ...], axis: int, angle: float) -> tuple[float, ...]:
    """Roll, pitch and yaw [deg] of a mounting that is turned by an angle [rad] about body axes."""
    roll, pitch, yaw = (math.radians(a) for a in rpy_deg)
    by = np.zeros(3)
    by[axis] = angle
    C = exp(by) @ matrix_from_euler(yaw, pitch, roll)
    return rpy_of(C)


def rpy_of(C_s_b: Array) -> tuple[float, ...]:
    """Roll, pitch and yaw [deg] of a mounting, as parameters and mapping files state it."""
    yaw, pitch, roll = euler_from_matrix(C_s_b)
    return tuple(math.degrees(float(a)) for a in (roll, pitch, yaw))


def dvl_turn(axis: int) -> Move:
    """Turn of the DVL's mounting about a body axis [rad]."""

    def move(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
        return replace(params, dvl_rpy_deg=turned(params.dvl_rpy_deg, axis, value)), inputs

    return move


def lever(name: str, axis: int) -> Move:
    """Lever arm of a sensor along a body axis [m]."""

    def move(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
        arm = list(getattr(params, name))
        arm[axis] += value
        changes: dict[str, Any] = {name: tuple(arm)}
        return replace(params, **changes), inputs

    return move


def dvl_latency(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Pings that are so much older than their stamps [s]."""
    stamps = inputs.dvl_stamps_ns - round(value * 1e9)
    return params, replace(inputs, dvl_stamps_ns=stamps)


def sea_surface(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Depths that count from a surface so much higher [m]."""
    return replace(params, sea_surface_height=params.sea_surface_height + value), inputs


def heading(harmonic: Callable[[Array], Array]) -> Move:
    """Headings with an error of so much times a function of the heading [rad]."""

    def move(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
        h = inputs.headings
        right = np.remainder(h - value * harmonic(h) + np.pi, 2.0 * np.pi) - np.pi
        return params, replace(inputs, headings=right)

    return move
