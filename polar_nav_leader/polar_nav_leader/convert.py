"""Conversion between messages and the leader's types."""

from __future__ import annotations

import math

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix, NavSatStatus

from polar_nav_core import attitude, earth
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_msgs.msg import AcousticPacket, UsblFix
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_msg, to_ns

from .broadcast import ArrayMeasurement
from .params import LeaderParams
from .states import LeaderState

_KNOWN = (
    NavSatFix.COVARIANCE_TYPE_APPROXIMATED,
    NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN,
    NavSatFix.COVARIANCE_TYPE_KNOWN,
)


def state_from_msg(msg: Odometry, params: LeaderParams) -> LeaderState:
    """State of a nav_msgs/Odometry in `earth`; parameters replace a 1-sigma that is not stated."""
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    v, w = msg.twist.twist.linear, msg.twist.twist.angular
    C_b_e = attitude.matrix_from_quaternion([q.x, q.y, q.z, q.w])
    covariance = np.array(msg.pose.covariance, dtype=np.float64).reshape(6, 6)
    P_r_e, P_phi_e = covariance[:3, :3], covariance[3:, 3:]
    P_v_b = np.array(msg.twist.covariance, dtype=np.float64).reshape(6, 6)[:3, :3]
    if not P_r_e.any():
        P_r_e = params.position_sigma**2 * np.eye(3)
    if not P_phi_e.any():
        P_phi_e = math.radians(params.attitude_sigma_deg) ** 2 * np.eye(3)
    if not P_v_b.any():
        P_v_b = params.velocity_sigma**2 * np.eye(3)
    return LeaderState(
        stamp_ns=to_ns(msg.header.stamp),
        r_e=np.array([p.x, p.y, p.z]),
        v_e=C_b_e @ np.array([v.x, v.y, v.z]),
        C_b_e=C_b_e,
        omega_eb_b=np.array([w.x, w.y, w.z]),
        P_r_e=P_r_e,
        P_phi_e=P_phi_e,
        P_v_e=C_b_e @ P_v_b @ C_b_e.T,
    )


def absolute_fix_from_msg(msg: NavSatFix, number: int) -> Fix:
    """Fix of a sensor_msgs/NavSatFix, valid at its reception.

    Without a stated covariance it is refused: its accuracy is unknown. Its axes are east,
    north, up at the latitude and longitude in the message, so they are defined at a pole, too.
    """
    stamp_ns = to_ns(msg.header.stamp)
    lat, lon = math.radians(msg.latitude), math.radians(msg.longitude)
    reason = ''
    if msg.status.status == NavSatStatus.STATUS_NO_FIX:
        reason = 'status is STATUS_NO_FIX: the receiver has no position'
    elif msg.position_covariance_type not in _KNOWN:
        reason = (
            f'position_covariance_type is {msg.position_covariance_type}: a fix of unknown '
            'accuracy is not used'
        )
    elif not all(math.isfinite(x) for x in (msg.latitude, msg.longitude, msg.altitude)):
        reason = 'latitude, longitude or altitude is not finite'
    elif abs(msg.latitude) > 90.0:
        reason = f'latitude is {msg.latitude} deg'
    r_e, covariance_e = np.full(3, np.nan), np.full((3, 3), np.nan)
    if not reason:
        r_e = earth.ecef_from_geodetic(lat, lon, msg.altitude)
        C_g_e = earth.ecef_to_enu(lat, lon).T
        covariance_g = np.array(msg.position_covariance, dtype=np.float64).reshape(3, 3)
        covariance_e = C_g_e @ covariance_g @ C_g_e.T
    return Fix(
        validity_ns=stamp_ns,
        transmit_ns=stamp_ns,
        receive_ns=stamp_ns,
        source='absolute',
        sequence=number,
        order=number,
        arrival=number,
        r_e=r_e,
        covariance_e=covariance_e,
        refusal=Verdict.NOT_FINITE if reason else None,
        reason=reason,
        topic=topics.ABSOLUTE,
    )


def measurement_from_msg(msg: UsblFix) -> ArrayMeasurement:
    """Reading of the array of a polar_nav_msgs/UsblFix."""
    return ArrayMeasurement(
        target=msg.target,
        sequence=msg.sequence,
        ping_ns=to_ns(msg.ping_time),
        validity_ns=to_ns(msg.header.stamp),
        return_ns=to_ns(msg.return_time),
        turn_around=msg.turn_around,
        round_trip=msg.round_trip,
        range_variance=msg.range_variance,
        direction_a=np.array([msg.direction.x, msg.direction.y, msg.direction.z]),
        cosine_covariance=np.array(msg.direction_cosine_covariance, dtype=np.float64).reshape(
            2, 2
        ),
        sound_speed=msg.sound_speed,
        target_depth=msg.target_depth,
        target_depth_variance=msg.target_depth_variance,
    )


def packet_to_msg(
    data: bytes, source: str, target: str, sequence: int, transmit_ns: int, bit_rate: float
) -> AcousticPacket:
    """polar_nav_msgs/AcousticPacket for the modem; receive_time is zero until it is received."""
    msg = AcousticPacket()
    msg.header.stamp = to_msg(transmit_ns)
    msg.source = source
    msg.destination = target
    msg.sequence = sequence
    msg.transmit_time = to_msg(transmit_ns)
    msg.bit_rate = bit_rate
    msg.data = data
    return msg
