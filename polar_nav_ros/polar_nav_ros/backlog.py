"""Inputs of a node that come faster than it takes them: how far it is behind, and what it lost.

Queues are bounded everywhere: that of a subscription by its depth, after which the middleware
drops the oldest message, and the turns in which one is emptied by a number of messages, so that
timers and signals have theirs. Clocks are read for diagnostics only.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

BEHIND_S = 1.0
"""A message that waited for longer shows that a node falls behind."""
FRESH_S = 0.005
"""What waits on other topics when a message has waited for less came after it, or with it."""
BETWEEN = 10
"""Messages of a long burst after which what waits on other topics is taken."""
_NS = 1_000_000_000


Informed = Callable[[Any, dict[str, Any]], None]


def informed(callback: Informed) -> Callable[..., None]:
    """Callback of a message and of what the middleware knows of it, for any executor.

    rclpy looks at the signature whether a callback wants both; then its executors that ask for
    messages pass two arguments, the one of events (as of 7.1.11) one pair.
    """

    def call(*given: Any) -> None:  # noqa: ANN401 - a message and a dict
        message, about = given if len(given) == 2 else given[0]
        callback(message, about)

    call.__signature__ = inspect.signature(callback)  # type: ignore[attr-defined]
    return call


class Handle(Protocol):
    """The part of rclpy's handle of a subscription that is used here."""

    def take_message(self, msg_type: type[Any], raw: bool, /) -> tuple[Any, Any] | None:
        """Return the next message with what the middleware knows of it; None if none waits."""


class Backlog:
    """How long messages wait for a node.

    Parameters
    ----------
    steady : callable
        Steady time [s].
    system : callable
        System time [ns], by which the middleware notes receptions.
    """

    def __init__(
        self,
        steady: Callable[[], float] = time.monotonic,
        system: Callable[[], int] = time.time_ns,
    ) -> None:
        self._steady, self._system = steady, system
        self._empty_s = steady()
        self._waited_s = 0.0

    def taken(self, received_ns: int) -> None:
        """Note a message by its time of reception [ns], 0 where that is not known."""
        if received_ns:
            self._waited_s = self.waited_s(received_ns)

    def waited_s(self, received_ns: int) -> float:
        """How long a message received then [ns] has waited [s]."""
        waited_s = (self._system() - received_ns) / _NS
        # The system's clock may have been set meanwhile; the steady one bounds that.
        return min(max(waited_s, 0.0), self._steady() - self._empty_s)

    def emptied(self) -> None:
        """Note that nothing waits on a subscription."""
        self._empty_s = self._steady()

    @property
    def behind_s(self) -> float:
        """How long the message taken last had waited [s]; 0 where that is no time."""
        return self._waited_s if self._waited_s > BEHIND_S else 0.0


class Drain:
    """Takes what waits on one subscription, some messages at a time.

    Parameters
    ----------
    most : int
        Messages taken in one turn.
    backlog : Backlog
    single : callable
        Whether the topic has one publisher, who numbers what it sends; asked where numbers leap.

    Attributes
    ----------
    count, lost : int
        Messages taken, and messages that the middleware has dropped before.
    """

    def __init__(self, most: int, backlog: Backlog, single: Callable[[], bool]) -> None:
        self._most = most
        self._backlog = backlog
        self._single = single
        self._number: int | None = None
        self._several = False
        self.count = 0
        self.lost = 0

    def is_fresh(self, about: Mapping[str, Any]) -> bool:
        """Whether a message has not waited, so that nothing came on other topics before it."""
        received_ns = int(about['received_timestamp'] or 0)
        return received_ns > 0 and self._backlog.waited_s(received_ns) < FRESH_S

    def note(self, about: Mapping[str, Any]) -> None:
        """Note one message."""
        self.count += 1
        self._backlog.taken(int(about['received_timestamp'] or 0))
        before, number = self._number, about['publication_sequence_number']
        self._number = number
        if not self._several and (before is None or number is None or number == before + 1):
            return
        was_several, self._several = self._several, not self._single()
        if self._several:
            self._number = None
        elif not was_several and number > before:  # less: the publisher was started again
            self.lost += number - before - 1

    def take(
        self,
        handle: Handle,
        msg_type: type[Any],
        callback: Callable[[Any], None],
        *,
        raw: bool,
        between: Callable[[], None] | None = None,
    ) -> None:
        """Take messages until none waits, or as many as one turn has.

        ``between`` is called within a long burst, for what waits on other subscriptions.
        """
        for number in range(self._most):
            if between is not None and number and number % BETWEEN == 0:
                between()
            taken = handle.take_message(msg_type, raw)
            if taken is None:
                self._backlog.emptied()
                return
            callback(taken[0])
            self.note(taken[1])
