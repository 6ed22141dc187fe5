"""Conversion of messages of local sensors to events of the engine, for every vehicle.

Each rule stands here once for one message (live, replay by message) and, right beside it, for
columns of many messages (replay by arrays, identification). Both forms give the same bits.
"""

from __future__ import annotations

import math
import struct
from typing import Any, Literal, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import Imu

from polar_nav_core import attitude
from polar_nav_core.arrays import Array
from polar_nav_core.dvl import corrected, sound_speed_factors
from polar_nav_core.engine.events import (
    LEAST_BEAMS,
    Command,
    CommandKind,
    ControlSample,
    DepthSample,
    DvlPing,
    ImuSample,
    InitialState,
)
from polar_nav_core.engine.saved import unpack
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_msgs.msg import Depth, Dvl
from polar_nav_msgs.msg import InitialState as InitialStateMsg
from polar_nav_msgs.msg import Restore as RestoreMsg

from .stamps import stamp_ns_of_cdr, to_ns
from .topics import AHRS, RESTORE

_UNIT = 1e-3
"""Departure of a quaternion's length from 1 that rounding to float32 and more explains."""
_UNKNOWN = -1.0
"""First element of a covariance that its sender does not know (REP-145 and our messages)."""


class ImuRow(NamedTuple):
    """Of a sensor_msgs/Imu what `imu_from_msg` reads: rate and specific force, body axes.

    A node takes the bytes of its IMU, and reads these where they stand: to make the whole message
    takes longer than to use it.
    """

    stamp_ns: int
    omega_ib_b: tuple[float, float, float]
    f_b: tuple[float, float, float]

    @classmethod
    def of(cls, data: bytes) -> ImuRow:
        """Row of a serialized message.

        Raises
        ------
        ValueError
            For bytes that are none.
        """
        try:
            order = _ORDER[data[1]]
            at = _FRAME + int.from_bytes(data[_LENGTH : _LENGTH + 4], order.name)
            at += -(at - _ENCODING) % 8 + _ORIENTATION
            x, y, z, a, b, c = order.rates.unpack_from(data, at)
            return cls(stamp_ns_of_cdr(data), (x, y, z), (a, b, c))
        except (struct.error, LookupError) as error:
            raise ValueError(f'{len(data)} bytes that are no sensor_msgs/Imu') from error


class _ByteOrder(NamedTuple):
    name: Literal['little', 'big']
    rates: struct.Struct


_ORDER = {
    0: _ByteOrder('big', struct.Struct('>3d72x3d72x')),
    1: _ByteOrder('little', struct.Struct('<3d72x3d72x')),
}
_ENCODING, _LENGTH, _FRAME = 4, 12, 16
"""Where the message begins, the length of its frame's name, and that name."""
_ORIENTATION = 8 * (4 + 9)


def imu_from_msg(msg: Imu | ImuRow, number: int) -> ImuSample:
    """sensor_msgs/Imu as an event; orientation is not used."""
    if isinstance(msg, ImuRow):
        return ImuSample(msg.stamp_ns, number, np.array(msg.omega_ib_b), np.array(msg.f_b))
    w, f = msg.angular_velocity, msg.linear_acceleration
    return ImuSample(
        to_ns(msg.header.stamp), number, np.array([w.x, w.y, w.z]), np.array([f.x, f.y, f.z])
    )


def ahrs_from_msg(msg: Imu, number: int) -> ImuSample:
    """sensor_msgs/Imu of an AHRS as an event: `orientation` is that of base_link in grid axes.

    A message without attitude (``orientation_covariance[0]`` is -1, REP-145) leaves it out; a
    quaternion that is no rotation becomes one that is not finite.
    """
    w, f = msg.angular_velocity, msg.linear_acceleration
    q = msg.orientation
    known = msg.orientation_covariance[0] != _UNKNOWN
    return ImuSample(
        to_ns(msg.header.stamp),
        number,
        np.array([w.x, w.y, w.z]),
        np.array([f.x, f.y, f.z]),
        _rotation(q.x, q.y, q.z, q.w) if known else None,
        AHRS,
    )


def attitudes(xyzw: Array, covariance_0: Array) -> Array:
    """C_b_G of many messages of an AHRS. (n, 4), (n,) -> (n, 3, 3).

    NaN where `ahrs_from_msg` has no attitude, or one that is not finite.

    Parameters
    ----------
    xyzw : ndarray, shape (n, 4)
        ``orientation``.
    covariance_0 : ndarray, shape (n,)
        ``orientation_covariance[0]``.
    """
    C_b_G = _rotations(xyzw)
    C_b_G[covariance_0 == _UNKNOWN] = np.nan
    return C_b_G


def _rotation(x: float, y: float, z: float, w: float) -> Array:
    """`_rotations` of one quaternion. -> (3, 3)."""
    if not abs(math.sqrt(x * x + y * y + z * z + w * w) - 1.0) <= _UNIT:
        return np.full((3, 3), np.nan)
    return attitude.matrix_from_quaternion((x, y, z, w))


def _rotations(xyzw: Array) -> Array:
    """C_b_G of quaternions; NaN for one that is no rotation. (n, 4) -> (n, 3, 3)."""
    with np.errstate(over='ignore', invalid='ignore'):
        length = np.sqrt(np.sum(xyzw * xyzw, axis=1))
        good = np.abs(length - 1.0) <= _UNIT
    out = np.full((len(xyzw), 3, 3), np.nan)
    if good.any():
        out[good] = attitude.matrix_from_quaternion(xyzw[good])
    return out


def control_from_msg(msg: WrenchStamped, number: int) -> ControlSample:
    """geometry_msgs/WrenchStamped as an event: thrust, body axes [N], [N m]."""
    force, torque = msg.wrench.force, msg.wrench.torque
    return ControlSample(
        to_ns(msg.header.stamp),
        number,
        np.array([force.x, force.y, force.z]),
        np.array([torque.x, torque.y, torque.z]),
    )


def dvl_from_msg(
    msg: Dvl, number: int, default_sigma: float, water_sound_speed: float = 0.0
) -> DvlPing:
    """polar_nav_msgs/Dvl as an event.

    Pings without bottom lock are marked, an unknown covariance gets the default. Velocity and
    covariance are corrected for the sound speed of the water [m/s], 0: unknown.
    """
    v_m = np.array([msg.velocity.x, msg.velocity.y, msg.velocity.z])
    covariance = np.array(msg.velocity_covar, dtype=np.float64).reshape(3, 3)
    unknown = covariance[0, 0] == _UNKNOWN
    phased = msg.dvl_type == Dvl.DVL_TYPE_PHASED_ARRAY
    factors = sound_speed_factors(msg.sound_speed, water_sound_speed, phased)
    v_m, covariance = corrected(v_m, covariance, factors)
    enough_beams = msg.num_good_beams >= LEAST_BEAMS
    valid = (
        msg.velocity_mode == Dvl.DVL_MODE_BOTTOM and enough_beams and bool(np.isfinite(v_m).all())
    )
    if unknown:
        covariance = default_sigma**2 * np.eye(3)
    return DvlPing(to_ns(msg.header.stamp), number, valid, v_m, covariance)


def dvl_pings(
    v_m: Array,
    covariance: Array,
    mode: NDArray[Any],
    good_beams: NDArray[Any],
    default_sigma: float,
    factors: Array,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Velocities, covariances and validity of n pings, equal to `dvl_from_msg`.

    Parameters
    ----------
    v_m : ndarray, shape (n, 3)
        ``velocity`` [m/s], instrument axes.
    covariance : ndarray, shape (n, 9)
        ``velocity_covar``.
    mode, good_beams : ndarray of int, shape (n,)
        ``velocity_mode``, ``num_good_beams``.
    default_sigma : float
        For an unknown covariance [m/s].
    factors : ndarray, shape (n, 3)
        Of `sound_speed_factors`.

    Returns
    -------
    v_m : ndarray, shape (n, 3)
    covariance_m : ndarray, shape (n, 3, 3)
    valid : ndarray of bool, shape (n,)
    """
    covariance_m = covariance.reshape(-1, 3, 3)
    unknown = covariance_m[:, 0, 0] == _UNKNOWN
    v_m, covariance_m = corrected(v_m, covariance_m, factors)
    if unknown.any():
        covariance_m = covariance_m.copy()
        covariance_m[unknown] = default_sigma**2 * np.eye(3)
    bottom = (mode == Dvl.DVL_MODE_BOTTOM) & (good_beams >= LEAST_BEAMS)
    return v_m, covariance_m, bottom & np.isfinite(v_m).all(axis=1)


def depth_from_msg(msg: Depth, number: int, default_sigma: float) -> DepthSample:
    """polar_nav_msgs/Depth as an event."""
    variance = default_sigma**2 if msg.variance == _UNKNOWN else msg.variance
    return DepthSample(to_ns(msg.header.stamp), number, msg.depth, variance)


def depth_variances(variance: Array, default_sigma: float) -> Array:
    """Variances [m^2] (n,) of n depths, equal to `depth_from_msg`."""
    return np.where(variance == _UNKNOWN, default_sigma**2, variance)


def command_from_msg(msg: CommandMsg, number: int) -> Command:
    """polar_nav_msgs/Command as an event."""
    kind = CommandKind(msg.kind)
    if kind is CommandKind.RESTORE:
        raise ValueError('a command of kind RESTORE has no state')
    starts = kind in (CommandKind.RESET, CommandKind.SET_INITIAL_STATE)
    initial = initial_from_msg(msg.initial_state) if starts else None
    sensor = ''
    if kind in (CommandKind.SENSOR_OFF, CommandKind.SENSOR_ON):
        if len(msg.taken_topics) != 1:
            raise ValueError(f'a command of kind {kind.name} names one topic')
        sensor = str(msg.taken_topics[0])
    stamp_ns = to_ns(msg.header.stamp)
    return Command(stamp_ns, msg.sequence, kind, initial, arrival=number, sensor=sensor)


def restore_from_msg(msg: RestoreMsg, number: int) -> Command:
    """polar_nav_msgs/Restore as an event; it comes before the commands of its stamp.

    Raises
    ------
    SavedStateError
        For bytes that are no saved state.
    """
    saved = unpack(bytes(msg.data))
    stamp_ns = to_ns(msg.header.stamp)
    return Command(stamp_ns, -1, CommandKind.RESTORE, saved, RESTORE, number)


def initial_from_msg(msg: InitialStateMsg) -> InitialState | None:
    """Initial state of a polar_nav_msgs/InitialState; None for a message without uncertainty."""
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
