"""One follower behind its topics: a navigation session whose fixes come in acoustic packets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from polar_nav_core.engine.events import Fix
from polar_nav_core.packet import Broadcast
from polar_nav_ros.broadcasts import broadcast_to_msg
from polar_nav_ros.navigation_session import (
    COMMAND,
    DEPTH,
    DVL,
    IMU,
    RECEIPT,
    STATE,
    NavigationSession,
    Published,
)

from . import convert
from .params import FollowerParams

__all__ = [
    'COMMAND',
    'DECODED',
    'DEPTH',
    'DVL',
    'IMU',
    'INPUTS',
    'PACKET',
    'RECEIPT',
    'STATE',
    'Published',
    'Session',
]

PACKET = 'acomms/rx'
DECODED = 'acomms/decoded'

INPUTS = (IMU, DVL, DEPTH, PACKET, COMMAND)


class Session(NavigationSession[FollowerParams]):
    """A follower with its topics.

    Parameters
    ----------
    params : FollowerParams
        Everything that can be chosen.
    vehicle : str
        Name of the vehicle, for frame ids.
    """

    def __init__(self, params: FollowerParams, vehicle: str) -> None:
        super().__init__(params, vehicle, {PACKET: self._fix_from_msg}, frame_id=params.frame_id)
        self._decoded: list[Published] = []

    def take(self, topic: str, message: Any) -> Iterator[Published]:  # noqa: ANN401
        """Take one message live; yields what is to be published."""
        event = self.event_of(topic, message)
        yield from self.decoded()
        yield from self._to_messages(self.reorder.add(event))

    def decoded(self) -> Iterator[Published]:
        """Contents of the packets read since the last call, for people."""
        yield from self._decoded
        self._decoded.clear()

    def _fix_from_msg(self, message: Any, number: int) -> Fix:  # noqa: ANN401
        fix, broadcast = convert.fix_from_msg(message, number, self.params)
        if broadcast is not None:
            message = self._broadcast_to_msg(broadcast, fix)
            self._decoded.append(Published.of(DECODED, message))
        return fix

    def _broadcast_to_msg(self, broadcast: Broadcast, fix: Fix) -> Any:  # noqa: ANN401
        target = self.vehicle if broadcast.target == self.params.own_id else str(broadcast.target)
        return broadcast_to_msg(broadcast, fix.source, target, self.params.frame_id)
