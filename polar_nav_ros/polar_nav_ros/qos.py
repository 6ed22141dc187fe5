"""Quality of service of all topics, and what parameters ``qos_overrides.*`` state of it."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

QUEUE_DEPTH = 2000
"""Deeper than the longest window of the lockstep pace has messages on any topic."""

DATA_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=QUEUE_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
BEST_EFFORT = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=QUEUE_DEPTH,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
RECORD_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=600,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""For what a replay cannot do without: a recorder that finds it late gets a minute of it."""
_QUEUE = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)


def overridden(node: Node, topic: str, policy: str = 'reliability') -> bool:
    """Whether a node was started with a QoS policy for a subscription, by its full name."""
    return f'qos_overrides.{topic}.subscription.{policy}' in node._parameter_overrides


def overriding(node: Node, topic: str, *, reliable: bool) -> QoSOverridingOptions | None:
    """Policies that a node was started with for a subscription; None for none.

    One that takes the place of a reliable one (not ``reliable``) is best effort in any case.
    """
    name = node.resolve_topic_name(topic)
    policies = [*_QUEUE, QoSPolicyKind.RELIABILITY] if reliable else _QUEUE
    given = [p for p in policies if overridden(node, name, p.name.lower())]
    return QoSOverridingOptions(given) if given else None
