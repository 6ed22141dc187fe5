"""Content of a leader's packet as a readable message, the same from leader and follower."""

from __future__ import annotations

from polar_nav_core import earth
from polar_nav_core.link.packet import Broadcast
from polar_nav_msgs.msg import LeaderBroadcast

from .stamps import to_msg


def broadcast_to_msg(
    b: Broadcast, source: str, target: str, frame_id: str = 'earth'
) -> LeaderBroadcast:
    """polar_nav_msgs/LeaderBroadcast of a packet's content."""
    lat, lon, height = (float(v) for v in earth.geodetic_from_ecef(b.leader_r_e))
    msg = LeaderBroadcast()
    msg.header.stamp = to_msg(b.validity_ns)
    msg.header.frame_id = frame_id
    msg.version = b.version
    msg.source = source
    msg.target = target
    msg.sequence = b.sequence
    msg.return_time = to_msg(b.return_ns)
    msg.leader_r_e = b.leader_r_e
    msg.leader_latitude = lat
    msg.leader_longitude = lon
    msg.leader_height = height
    msg.leader_sigma_horizontal = b.leader_sigma_horizontal
    msg.leader_sigma_vertical = b.leader_sigma_vertical
    msg.leader_v_g = b.leader_v_G
    msg.leader_sigma_velocity = b.leader_sigma_velocity
    msg.leader_grid_heading = b.leader_grid_heading
    msg.leader_sigma_heading = b.leader_sigma_heading
    msg.r_lf_g = b.r_lf_G
    msg.r_lf_covariance_g = b.r_lf_covariance_G.reshape(9)
    msg.sound_speed = b.sound_speed
    return msg
