"""Messages of local sensors and commands to the engine's events: the same for every vehicle."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Quaternion, WrenchStamped
from sensor_msgs.msg import Imu

from polar_nav_core import attitude
from polar_nav_core.engine.events import (
    Array,
    Command,
    CommandKind,
    ControlSample,
    DepthSample,
    DvlPing,
    ImuSample,
    InitialState,
)
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_msgs.msg import Depth, Dvl
from polar_nav_msgs.msg import InitialState as InitialStateMsg

from .stamps import to_ns
from .topics import AHRS

UNIT = 1e-3
"""Departure of a quaternion's length from 1 that rounding to float32 and more explains."""


def imu_from_msg(msg: Imu, number: int) -> ImuSample:
    """sensor_msgs/Imu as an event; orientation is not used."""
    w, f = msg.angular_velocity, msg.linear_acceleration
    return ImuSample(
        to_ns(msg.header.stamp), number, np.array([w.x, w.y, w.z]), np.array([f.x, f.y, f.z])
    )


def ahrs_from_msg(msg: Imu, number: int) -> ImuSample:
    """sensor_msgs/Imu of an AHRS as an event: `orientation` is that of base_link in grid axes.

    A message that says that it has no attitude (``orientation_covariance[0]`` is -1, REP-145)
    gives none; a quaternion that is no rotation gives one that is not finite.
    """
    w, f = msg.angular_velocity, msg.linear_acceleration
    none = msg.orientation_covariance[0] == -1.0
    return ImuSample(
        to_ns(msg.header.stamp),
        number,
        np.array([w.x, w.y, w.z]),
        np.array([f.x, f.y, f.z]),
        None if none else _rotation(msg.orientation),
        AHRS,
    )


def control_from_msg(msg: WrenchStamped, number: int) -> ControlSample:
    """geometry_msgs/WrenchStamped as an event: what the thrusters give, body axes."""
    force, torque = msg.wrench.force, msg.wrench.torque
    return ControlSample(
        to_ns(msg.header.stamp),
        number,
        np.array([force.x, force.y, force.z]),
        np.array([torque.x, torque.y, torque.z]),
    )


def dvl_from_msg(msg: Dvl, number: int, default_sigma: float) -> DvlPing:
    """polar_nav_msgs/Dvl as an event.

    Pings without bottom lock are marked, an unknown covariance gets the default.
    """
    v_m = np.array([msg.velocity.x, msg.velocity.y, msg.velocity.z])
    covariance = np.array(msg.velocity_covar, dtype=np.float64).reshape(3, 3)
    enough_beams = msg.num_good_beams >= 3
    valid = (
        msg.velocity_mode == Dvl.DVL_MODE_BOTTOM and enough_beams and bool(np.isfinite(v_m).all())
    )
    if covariance[0, 0] == -1.0:
        covariance = default_sigma**2 * np.eye(3)
    return DvlPing(to_ns(msg.header.stamp), number, valid, v_m, covariance)


def depth_from_msg(msg: Depth, number: int, default_sigma: float) -> DepthSample:
    """polar_nav_msgs/Depth as an event."""
    variance = default_sigma**2 if msg.variance == -1.0 else msg.variance
    return DepthSample(to_ns(msg.header.stamp), number, msg.depth, variance)


def command_from_msg(msg: CommandMsg, _number: int) -> Command:
    """polar_nav_msgs/Command as an event."""
    kind = CommandKind(msg.kind)
    starts = kind in (CommandKind.RESET, CommandKind.SET_INITIAL_STATE)
    initial = initial_from_msg(msg.initial_state) if starts else None
    return Command(to_ns(msg.header.stamp), msg.sequence, kind, initial)


def _rotation(q: Quaternion) -> Array:
    """C_b_G of a quaternion; NaN for one that is no rotation."""
    if not abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) <= UNIT:
        return np.full((3, 3), np.nan)
    return attitude.matrix_from_quaternion([q.x, q.y, q.z, q.w])


def initial_from_msg(msg: InitialStateMsg) -> InitialState | None:
    """polar_nav_msgs/InitialState; None for one without uncertainty, which stands for none."""
    if msg.sigma_position_horizontal <= 0.0:
        return None
    return InitialState(
        latitude=msg.latitude,
        longitude=msg.longitude,
        height=msg.height,
        v_G=(float(msg.v_g[0]), float(msg.v_g[1]), float(msg.v_g[2])),
        roll=msg.roll,
        pitch=msg.pitch,
        grid_heading=msg.grid_heading,
        sigma_position_horizontal=msg.sigma_position_horizontal,
        sigma_position_vertical=msg.sigma_position_vertical,
        sigma_velocity=msg.sigma_velocity,
        sigma_tilt=msg.sigma_tilt,
        sigma_heading=msg.sigma_heading,
    )


def initial_to_msg(s: InitialState) -> InitialStateMsg:
    """polar_nav_msgs/InitialState of an initial state."""
    return InitialStateMsg(
        latitude=s.latitude,
        longitude=s.longitude,
        height=s.height,
        v_g=np.array(s.v_G),
        roll=s.roll,
        pitch=s.pitch,
        grid_heading=s.grid_heading,
        sigma_position_horizontal=s.sigma_position_horizontal,
        sigma_position_vertical=s.sigma_position_vertical,
        sigma_velocity=s.sigma_velocity,
        sigma_tilt=s.sigma_tilt,
        sigma_heading=s.sigma_heading,
    )


def initial_problem(s: InitialState) -> str:
    """Why an initial state cannot be used, in a sentence; empty when it can."""
    sigmas = {
        'sigma_position_horizontal': s.sigma_position_horizontal,
        'sigma_position_vertical': s.sigma_position_vertical,
        'sigma_velocity': s.sigma_velocity,
        'sigma_tilt': s.sigma_tilt,
        'sigma_heading': s.sigma_heading,
    }
    values = [
        s.latitude,
        s.longitude,
        s.height,
        *s.v_G,
        s.roll,
        s.pitch,
        s.grid_heading,
        *sigmas.values(),
    ]
    if not all(math.isfinite(v) for v in values):
        return 'a value of the initial state is not finite'
    for name, value in sigmas.items():
        if value <= 0.0:
            return f'{name} is {value}: it must be positive'
    if abs(s.latitude) > 0.5 * math.pi:
        return f'latitude is {s.latitude} rad: it must lie in [-pi/2, pi/2]'
    return ''
