"""Quality of service of all topics, and what parameters ``qos_overrides.*`` state of it."""

from __future__ import annotations

from collections.abc import Collection

from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from polar_nav_core.errors import ConfigError

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
_PREFIX = 'qos_overrides.'
_WORDS = {
    'reliability': ('reliable', 'best_effort'),
    'history': ('keep_last', 'keep_all'),
}


def check_overrides(node: Node) -> None:
    """Refuse policies for subscriptions that rclpy would take for an error of the program.

    Raises
    ------
    ConfigError
        For another policy than reliability, depth and history, or a value that it cannot have.
    """
    for name, stated in node._parameter_overrides.items():
        topic, end, policy = name.removeprefix(_PREFIX).rpartition('.subscription.')
        if not name.startswith(_PREFIX) or not end or topic == '/parameter_events':
            continue
        value = stated.value
        if policy == 'depth':
            if type(value) is int and value > 0:
                continue
            expected = 'a whole number above 0'
        elif policy in _WORDS:
            if value in _WORDS[policy]:
                continue
            expected = ' or '.join(_WORDS[policy])
        else:
            raise ConfigError(
                f'parameter {name}: {policy} cannot be overridden, but reliability, depth, history'
            )
        raise ConfigError(f'parameter {name}: {value!r} is refused: {expected}')


def unused_overrides(node: Node, topics: Collection[str]) -> list[str]:
    """Names of parameters for subscriptions to topics, by their full names, that are not there."""
    found = []
    for name in node._parameter_overrides:
        topic, end, _ = name.removeprefix(_PREFIX).rpartition('.subscription.')
        if name.startswith(_PREFIX) and end and topic not in (*topics, '/parameter_events'):
            found.append(name)
    return found


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
