"""Parameters of the outputs of a live node: prediction to now, local frames, transforms.

None of them changes an estimate: what they shape is no part of a replay.
"""

from __future__ import annotations

from dataclasses import dataclass

from .local_frame import AXES
from .params import NodeParams, choice, flag, param, text


@dataclass(frozen=True)
class OutputParams(NodeParams):
    """Outputs of a live vehicle beside its estimates."""

    now_every: int = param(
        1, '', 0, 1000, 'IMU samples per message of odometry/now, odometry/local and /tf; 0: none'
    )
    now_acceleration: float = param(
        0.1, 'm/s^2', 1e-4, 100.0, 'Most acceleration that corrections add to odometry/now'
    )
    now_turn_acceleration: float = param(
        0.05, 'rad/s^2', 1e-5, 100.0, 'Most angular acceleration that corrections add to it'
    )
    now_blend_s: float = param(
        2.0, 's', 0.1, 30.0, 'Time over which a correction goes into it, where these limits allow'
    )
    now_jump: float = param(
        5.0, 'm', 0.0, 1e6, 'Larger corrections jump, and count in odometry/reset_counter'
    )
    now_jump_angle_deg: float = param(
        20.0, 'deg', 0.0, 180.0, 'The same for corrections of attitude'
    )
    map_axes: str = choice(
        'grid',
        AXES,
        'Axes of the local map frame, at its origin: grid east and north, or true east and north, '
        'which are refused within 1 km of a pole',
    )
    origin_file: str = text(
        '', 'YAML file with origin and axes of the map frame; empty: the first state, map_axes'
    )
    map_frame: str = text('', 'Name of the map frame; empty: <vehicle>/map')
    odom_frame: str = text('', 'Name of the odom frame; empty: <vehicle>/odom')
    base_frame: str = text('', 'Name of the body frame in /tf; empty: <vehicle>/base_link')
    publish_tf: bool = flag(True, 'Publish /tf and /tf_static')
