"""Transforms of /tf and /tf_static, with the quality of service that tf2 listens with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Transform, TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from polar_nav_core import attitude
from polar_nav_core.arrays import Array

from .topics import TF, TF_STATIC

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

HAS_TF = TFMessage is not None
NO_TF = 'tf2_msgs is not installed (ros-jazzy-tf2-msgs): /tf and /tf_static are not published'
C_NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Takes components in x north, y east, z down to x east, y north, z up; and back."""
C_FRD_FLU = np.diag([1.0, -1.0, -1.0])
"""Takes components in x forward, y right, z down to x forward, y left, z up; and back."""


def _qos(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


def transform(parent: str, child: str, r: Array, C: Array) -> TransformStamped:
    """geometry_msgs/TransformStamped of a frame's pose in its parent, that always held.

    Parameters
    ----------
    parent, child : str
        Frames.
    r : (3,) array
        Origin of the child, parent axes [m].
    C : (3, 3) array
        Takes components in the child to components in the parent.
    """
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    place(message.transform, r, C)
    return message


def place(pose: Transform, r: Array, C: Array) -> None:
    """Fill a geometry_msgs/Transform; `r` and `C` as in `transform`."""
    t, q = pose.translation, pose.rotation
    t.x, t.y, t.z = r.tolist()
    q.x, q.y, q.z, q.w = attitude.quaternion_from_matrix(C).tolist()


class Broadcaster:
    """Publishes transforms; static ones all in one message, as the newest is what is kept.

    Parameters
    ----------
    node : Node
    """

    def __init__(self, node: Node) -> None:
        self._moving = node.create_publisher(TFMessage, TF, _qos(100, DurabilityPolicy.VOLATILE))
        durable = DurabilityPolicy.TRANSIENT_LOCAL
        self._static = node.create_publisher(TFMessage, TF_STATIC, _qos(1, durable))
        self._message = TFMessage()
        self._fixed: dict[str, TransformStamped] = {}

    @property
    def heard(self) -> bool:
        """Whether anybody subscribes to the transforms that move."""
        return bool(self._moving.get_subscription_count() > 0)

    def send(self, transforms: Sequence[Any]) -> None:
        """Publish transforms that move."""
        self._message.transforms = list(transforms)
        self._moving.publish(self._message)

    def fix(self, transforms: Sequence[Any]) -> None:
        """Publish transforms that stay, with those before."""
        self._fixed |= {t.child_frame_id: t for t in transforms}
        self._static.publish(TFMessage(transforms=list(self._fixed.values())))
