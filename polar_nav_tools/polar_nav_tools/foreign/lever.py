"""Parameters of a recording whose IMU is not at base_link, as a filter at the IMU needs them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.lever import params_at_imu, state_at
from polar_nav_follower.params import FollowerParams

from .load import Loaded


def at_the_imu(loaded: Loaded) -> FollowerParams:
    """Parameters, lever arms and initial state among them, from the point that the IMU is at.

    For what drives a filter itself; the engine moves them by its ``imu_lever_b``.
    """
    lever_b = np.asarray(loaded.mapping.imu.lever_b)
    if not lever_b.any() or not len(loaded.inputs.imu_stamps_ns):
        return loaded.params
    return from_imu(loaded.params, lever_b, loaded.inputs.omega_ib_b[0])


def from_imu(params: FollowerParams, lever_b: Array, omega_ib_b: Array) -> FollowerParams:
    """Parameters as a filter needs them that navigates the IMU's point.

    Parameters
    ----------
    params : FollowerParams
        Lever arms and initial state from base_link.
    lever_b : (3,) array
        IMU from base_link [m].
    omega_ib_b : (3,) array
        Rate at the start [rad/s].

    Raises
    ------
    ConfigError
        As `params_at_imu`.
    """
    moved = params_at_imu(params, lever_b)
    initial = params.initial_state()
    if initial is None:
        return moved
    there = state_at(initial, lever_b, omega_ib_b)
    return replace(
        moved,
        initial_latitude_deg=math.degrees(there.latitude),
        initial_longitude_deg=math.degrees(there.longitude),
        initial_height=there.height,
        initial_v_G=there.v_G,
    )
