"""Messages to the leader's types and back; besides the node, only this knows both worlds."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import Odometry

from polar_nav_core import attitude
from polar_nav_msgs.msg import AcousticPacket, UsblFix
from polar_nav_ros.stamps import to_msg, to_ns

from .broadcast import ArrayMeasurement
from .states import LeaderState


def state_from_msg(msg: Odometry, position_sigma: float, attitude_sigma: float) -> LeaderState:
    """nav_msgs/Odometry in `earth` as a state; the 1-sigma values hold where it states none."""
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    v, w = msg.twist.twist.linear, msg.twist.twist.angular
    C_b_e = attitude.matrix_from_quaternion([q.x, q.y, q.z, q.w])
    covariance = np.array(msg.pose.covariance, dtype=np.float64).reshape(6, 6)
    P_r_e, P_phi_e = covariance[:3, :3], covariance[3:, 3:]
    if not P_r_e.any():
        P_r_e = position_sigma**2 * np.eye(3)
    if not P_phi_e.any():
        P_phi_e = attitude_sigma**2 * np.eye(3)
    return LeaderState(
        stamp_ns=to_ns(msg.header.stamp),
        r_e=np.array([p.x, p.y, p.z]),
        v_e=C_b_e @ np.array([v.x, v.y, v.z]),
        C_b_e=C_b_e,
        omega_eb_b=np.array([w.x, w.y, w.z]),
        P_r_e=P_r_e,
        P_phi_e=P_phi_e,
    )


def measurement_from_msg(msg: UsblFix) -> ArrayMeasurement:
    """polar_nav_msgs/UsblFix as a measurement of the array."""
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
