"""Publishers and subscriptions with a count of their messages, by which nodes keep pace."""

from __future__ import annotations

import time
from typing import Any, Protocol

import rclpy
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from .backlog import Drain

_POLL_S = 0.01


class CountedPublisher:
    """A publisher that counts its messages."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self.topic: str = publisher.topic_name
        self.count = 0

    def publish(self, message: Any) -> None:  # noqa: ANN401 - a message of the publisher's type, or its bytes
        """Publish a message or its serialized bytes."""
        self._publisher.publish(message)
        self.count += 1

    @property
    def matched(self) -> int:
        """Number of subscriptions matched with this publisher."""
        return int(self._publisher.get_subscription_count())

    def wait_for_subscription(self, timeout_s: float) -> bool:
        """Whether a subscription was matched, now or within so many seconds."""
        end = time.monotonic() + timeout_s
        while not self.matched and time.monotonic() < end:
            time.sleep(_POLL_S)
        return self.matched > 0

    def flush(self, timeout_s: float) -> bool:
        """Wait until every reader has acknowledged everything."""
        return bool(
            self._publisher.wait_for_all_acked(
                rclpy.duration.Duration(nanoseconds=int(timeout_s * 1e9))
            )
        )


class Input(Protocol):
    """A subscription that is counted."""

    topic: str

    @property
    def count(self) -> int:
        """Messages taken so far."""

    @property
    def matched(self) -> int:
        """Publishers that this subscription has found."""


class DrainedSubscription:
    """A drained subscription with its count."""

    def __init__(self, subscription: Subscription, drain: Drain) -> None:
        self.subscription = subscription
        self.drain = drain
        self.topic: str = subscription.topic_name

    @property
    def count(self) -> int:
        """Messages taken so far."""
        return self.drain.count

    @property
    def matched(self) -> int:
        """Publishers that it has found."""
        return int(self.subscription.get_publisher_count())
