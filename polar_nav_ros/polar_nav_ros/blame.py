"""A node that knows whether one of its callbacks failed: it may not be alone in its process."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

T = TypeVar('T')


class BlamedNode(Node):  # type: ignore[misc]
    """A node of rclpy that is marked when a callback of a subscription, timer or service raises.

    Attributes
    ----------
    failed : bool
        Whether one has.
    """

    failed = False

    def blamed(self, callback: Callable[..., T]) -> Callable[..., T]:
        """Callback whose exceptions mark this node as failed."""

        @wraps(callback)
        def call(*given: Any) -> T:  # noqa: ANN401 - what the callback takes
            try:
                return callback(*given)
            except Exception:
                self.failed = True
                raise

        return call

    def create_subscription(self, *args: Any, **kwargs: Any) -> Subscription:  # noqa: ANN401 - as rclpy's
        """Subscription as rclpy's, which blames this node."""
        return super().create_subscription(*self._with_blame(2, args), **kwargs)

    def create_timer(self, *args: Any, **kwargs: Any) -> Timer:  # noqa: ANN401 - as rclpy's
        """Timer as rclpy's, which blames this node."""
        return super().create_timer(*self._with_blame(1, args), **kwargs)

    def create_service(self, *args: Any, **kwargs: Any) -> Service:  # noqa: ANN401 - as rclpy's
        """Service as rclpy's, which blames this node."""
        return super().create_service(*self._with_blame(2, args), **kwargs)

    def _with_blame(self, position: int, args: tuple[Any, ...]) -> list[Any]:
        """Arguments with the callback at a position among them blamed, if it is there."""
        return [self.blamed(a) if k == position else a for k, a in enumerate(args)]
