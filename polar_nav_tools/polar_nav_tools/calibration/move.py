"""Parameters and inputs of a run as if a constant had been stated otherwise.

Each function returns both with ``value`` added to what was stated; neither is changed in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import euler_from_matrix, exp, matrix_from_euler
from polar_nav_core.engine.events import Fix
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


CALM_S = 15.0
"""The speed that a scale is of is a mean over so much before and after a ping [s]."""
_SWING_NS = 4 * 10**9
SLOW = 0.1
"""Share of the largest mean square of an axis's speed below which it shows no scale."""


def calm_velocity(params: EngineParams, inputs: Inputs) -> Array:
    """Velocity (d, 3) at each DVL ping without its noise, zero along axes of little motion.

    The mean of the pings about it, with what the gyros show of swinging and of the lever arm. In
    place of the ping itself, whose noise would pass for speed: least squares on it pull a scale
    towards -1, the more the slower the vehicle moves along an axis (across the track it hardly
    does).
    """
    valid = inputs.dvl_valid & np.isfinite(inputs.dvl_v_m).all(axis=1)
    omega, swing = (a[valid] for a in _turning(params, inputs))
    lever = np.cross(omega, params.dvl_lever_b) @ _mounting(params)
    v, stamps = inputs.dvl_v_m[valid] - lever, inputs.dvl_stamps_ns[valid]
    mean = _mean_of_others(v, stamps)
    square = np.sum(mean**2, axis=0)
    mean[:, square < SLOW * square.max()] = 0.0
    out = np.zeros_like(inputs.dvl_v_m)
    # A vehicle that swings about its course goes on along it.
    out[valid] = mean + np.cross(mean, swing) + lever
    return out


def _mean_of_others(v: Array, stamps_ns: NDArray[np.int64]) -> Array:
    """Mean (n, 3) of the values within `CALM_S` of each, without the value itself."""
    order = np.argsort(stamps_ns, kind='stable')
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(v[order], axis=0)])
    width = round(CALM_S * 1e9)
    first = np.searchsorted(stamps_ns[order], stamps_ns - width, 'left')
    last = np.searchsorted(stamps_ns[order], stamps_ns + width, 'right')
    others = np.maximum(last - first - 1, 1)[:, None]
    return np.asarray((sums[last] - sums[first] - v) / others)


def _mounting(params: EngineParams) -> Array:
    """C_m_b of the DVL as stated."""
    roll, pitch, yaw = (math.radians(a) for a in params.dvl_rpy_deg)
    return np.asarray(matrix_from_euler(yaw, pitch, roll))


def _turning(params: EngineParams, inputs: Inputs) -> tuple[Array, Array]:
    """Rates of turn at each DVL ping, body axes, and angles off the mean of 8 s, its own axes.

    No angles within 4 s of the ends: a steady turn is no swinging.
    """
    t, at = inputs.imu_stamps_ns, inputs.dvl_stamps_ns
    if len(t) < 2:
        return np.zeros((len(at), 3)), np.zeros((len(at), 3))
    s = 1e-9 * (t - t[0])
    rate, angle, ahead, behind = (np.empty((len(at), 3)) for _ in range(4))
    for k in range(3):
        rate[:, k] = np.interp(at, t, inputs.omega_ib_b[:, k])
        turned = np.cumsum(np.append(0.0, inputs.omega_ib_b[1:, k] * np.diff(s)))
        area = np.cumsum(np.append(0.0, 0.5 * (turned[1:] + turned[:-1]) * np.diff(s)))
        angle[:, k] = np.interp(at, t, turned)
        ahead[:, k] = np.interp(at + _SWING_NS, t, area)
        behind[:, k] = np.interp(at - _SWING_NS, t, area)
    off = angle - (ahead - behind) / (2e-9 * _SWING_NS)
    off[(at < t[0] + _SWING_NS) | (at > t[-1] - _SWING_NS)] = 0.0
    return rate, off @ _mounting(params)


def dvl_scale(params: EngineParams, inputs: Inputs, value: float) -> tuple[EngineParams, Inputs]:
    """Pings that show too much by a share; their noise, and what else is in them, stays."""
    v_m = inputs.dvl_v_m - value / (1.0 + value) * calm_velocity(params, inputs)
    return params, replace(inputs, dvl_v_m=v_m)


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
