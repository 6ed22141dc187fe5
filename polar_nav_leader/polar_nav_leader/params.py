"""Parameters of the leader node."""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_core.params import NodeParams, flag, param, text, vector


@dataclass(frozen=True)
class LeaderParams(NodeParams):
    """Parameters of leader_node."""

    own_id: int = param(1, '', 0, 255, 'Number of this vehicle in its packets')
    follower: str = text('follower', 'Name of the follower that fixes are sent to')
    follower_id: int = param(2, '', 0, 255, 'Number of that follower in the packets')
    array_lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'USBL array from base_link, body axes'
    )
    array_rpy_deg: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'deg', -360.0, 360.0, 'Mounting of the array: roll, pitch, yaw'
    )
    formation: bool = flag(
        True, 'Take the follower to move as the leader does while its transponder turns around'
    )
    sea_surface_height: float = param(
        0.0, 'm', -200.0, 200.0, 'Of the sea surface above the ellipsoid'
    )
    processing_delay_s: float = param(
        0.3, 's', 0.0, 60.0, 'From the reply at the array (t4) to the first bit sent (t5)'
    )
    bit_rate: float = param(9600.0, 'bit/s', 1.0, 1e7, 'Of the acoustic modem')
    position_sigma: float = param(
        0.0, 'm', 0.0, 1e4, '1-sigma per axis where the odometry states none'
    )
    attitude_sigma_deg: float = param(
        0.0, 'deg', 0.0, 90.0, '1-sigma per axis where the odometry states none'
    )
    history_s: float = param(30.0, 's', 1.0, 600.0, 'Stored odometry; longer than a round trip')
