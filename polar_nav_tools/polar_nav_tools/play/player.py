"""Publishers of the topics of a bag: serialized messages as recorded, not decoded."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from importlib import import_module
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from polar_nav_core.errors import PolarNavError
from polar_nav_ros.topics import CLOCK, TYPES

from .offers import Offer
from .order import Message
from .tracks import Track

_CDR = (b'\x00\x00', b'\x00\x01')
_HEAD = 4
_POLL_S = 0.02
_SETTLED_NS, _LONGEST_SETTLING_NS = 500_000_000, 3_000_000_000
_S = 1_000_000_000


class PublisherError(PolarNavError):
    """The middleware refuses a publisher."""


class Player:
    """Publishers of some tracks on a node.

    Parameters
    ----------
    node : Node
    tracks : iterable of Track
        Their types can be imported.
    clock : bool
        Publish /clock, too.

    Attributes
    ----------
    refused : dict of str to str
        Reason by name in the bag, for tracks that the middleware refused.
    published, unusable : dict of str to int
        Messages by name in the bag; unusable ones are not CDR and were not published.
    """

    def __init__(self, node: Node, tracks: Iterable[Track], *, clock: bool = False) -> None:
        self._node = node
        self._publishers: dict[str, Publisher] = {}
        self.refused: dict[str, str] = {}
        for track in tracks:
            try:
                self._publishers[track.name] = _publisher(node, track)
            except PublisherError as error:
                self.refused[track.name] = str(error)
        self.published = dict.fromkeys(self._publishers, 0)
        self.unusable: dict[str, int] = {}
        self._clock: Publisher | None = None
        if clock:
            self._clock = _publisher(node, Track(CLOCK, CLOCK, TYPES[CLOCK], Offer()))

    def publish(self, message: Message) -> None:
        """Publish one message, on /clock if that is its topic and there is a clock."""
        if message.topic == CLOCK and self._clock is not None:
            self._clock.publish(message.data)
            return
        publisher = self._publishers.get(message.topic)
        if publisher is None:
            return
        if len(message.data) < _HEAD or message.data[:2] not in _CDR:
            self.unusable[message.topic] = self.unusable.get(message.topic, 0) + 1
            return
        publisher.publish(message.data)
        self.published[message.topic] += 1

    def matched(self) -> dict[str, int]:
        """Return the number of matched subscriptions by name in the bag."""
        return {name: int(p.get_subscription_count()) for name, p in self._publishers.items()}

    def listeners(self) -> set[str]:
        """Return what has a subscription matched: topics by name in the bag, and full node names.

        A node counts with its first subscription to a played topic.
        """
        found = {name for name, count in self.matched().items() if count}
        for name in list(found):
            topic = self._publishers[name].topic_name
            for about in self._node.get_subscriptions_info_by_topic(topic):
                found.add(f'{about.node_namespace.rstrip("/")}/{about.node_name}')
        return found

    def flush(self, timeout_s: float) -> None:
        """Wait until reliable subscribers have acknowledged all, for so long at most."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(nanoseconds=int(timeout_s * _S)))


def _publisher(node: Node, track: Track) -> Publisher:
    try:
        kind = message_class(track.type)
        return node.create_publisher(kind, track.published, profile_of(track.offer))
    except Exception as error:  # of rclpy and of generated code, of many kinds
        raise PublisherError(f'{type(error).__name__}: {error}') from error


def message_class(type_name: str) -> type[Any]:
    """Return the Python class of an installed message type."""
    package, _, name = type_name.split('/')
    return getattr(import_module(f'{package}.msg'), name)  # type: ignore[no-any-return]


def profile_of(offer: Offer) -> QoSProfile:
    """Return the profile of rclpy that makes an offer."""
    given: dict[str, Any] = {
        'deadline': offer.deadline_ns,
        'lifespan': offer.lifespan_ns,
        'liveliness_lease_duration': offer.lease_ns,
    }
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if offer.keep_all else HistoryPolicy.KEEP_LAST,
        depth=offer.depth,
        reliability=(
            ReliabilityPolicy.RELIABLE if offer.reliable else ReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if offer.latched else DurabilityPolicy.VOLATILE
        ),
        liveliness=(
            LivelinessPolicy.MANUAL_BY_TOPIC
            if offer.manual_liveliness
            else LivelinessPolicy.AUTOMATIC
        ),
        **{name: Duration(nanoseconds=ns) for name, ns in given.items() if ns is not None},
    )


def wait_for_listeners(
    listeners: Callable[[], Collection[str]],
    matched: Callable[[], object],
    wanted: Collection[str] | None,
    timeout_s: float,
    *,
    now_ns: Callable[[], int],
    pause: Callable[[float], None],
    stopped: Callable[[], bool],
) -> list[str]:
    """Return the topics and nodes that were not there in time; empty if all is well.

    Discovery finds subscriptions one after the other: after those that are wanted it waits, for up
    to three seconds, until none has come for half a second.

    Parameters
    ----------
    listeners : callable
        Returns topics that have a subscription, and nodes that have one.
    matched : callable
        Returns the numbers of subscriptions, to be compared with those of before.
    wanted : collection of str or None
        Topics or nodes to wait for; empty: any; None: nobody is waited for.
    timeout_s : float
        Longest wait for those.
    now_ns, pause, stopped : callable
        As of `pace.publish_all`.
    """
    limit_ns = now_ns() + int(timeout_s * _S)
    while wanted is not None and not stopped():
        found = set(listeners())
        missing = sorted(set(wanted) - found) if wanted else ([] if found else ['any topic'])
        if not missing:
            break
        if now_ns() >= limit_ns:
            return missing
        pause(_POLL_S)
    end_ns = now_ns() + _LONGEST_SETTLING_NS
    last, since_ns = matched(), now_ns()
    while now_ns() < min(end_ns, since_ns + _SETTLED_NS) and not stopped():
        pause(_POLL_S)
        found_now = matched()
        if found_now != last:
            last, since_ns = found_now, now_ns()
    return []
