"""One follower behind its topics: messages in, messages out; driven by the node or by a replay.

Both drivers use this class with the same engine, so that they publish the same bytes. The node
calls :meth:`take` as messages come; a replay collects :meth:`event_of` of the whole bag, sorts,
and calls :meth:`process`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Event, Fix, Output, Receipt
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.packet import Broadcast

from . import convert
from .params import FollowerParams

IMU = 'imu/data_raw'
DVL = 'dvl/data'
DEPTH = 'depth/data'
PACKET = 'acomms/rx'
COMMAND = 'nav/command'
STATE = 'nav/state'
RECEIPT = 'nav/receipt'
DECODED = 'acomms/decoded'

INPUTS = (IMU, DVL, DEPTH, PACKET, COMMAND)


class Published(NamedTuple):
    """A message to publish: its topic, and its bytes, which depend on its content only."""

    topic: str
    message: Any
    data: bytes


class Session:
    """A follower with its topics.

    Parameters
    ----------
    params : FollowerParams
        Everything that can be chosen.
    vehicle : str
        Name of the vehicle, for frame ids.
    """

    def __init__(self, params: FollowerParams, vehicle: str) -> None:
        self.params = params
        self.vehicle = vehicle
        self.engine = Engine(params)
        self.reorder = Reorder(self.engine, params.reorder_window_s)
        self.taken: Counter[str] = Counter()
        self._decoded: list[Published] = []
        self._readers: dict[str, Callable[[Any, int], Event]] = {
            IMU: convert.imu_from_msg,
            DVL: lambda m, n: convert.dvl_from_msg(m, n, self.params.dvl_sigma),
            DEPTH: lambda m, n: convert.depth_from_msg(m, n, self.params.depth_sigma),
            PACKET: self._fix_from_msg,
            COMMAND: convert.command_from_msg,
        }

    def event_of(self, topic: str, message: Any) -> Event:  # noqa: ANN401 - the topic's message type
        """Event of a message; counts it, which numbers the messages of each topic."""
        number = self.taken[topic]
        self.taken[topic] += 1
        return self._readers[topic](message, number)

    def take(self, topic: str, message: Any) -> Iterator[Published]:  # noqa: ANN401
        """Take one message live; yields what is to be published."""
        event = self.event_of(topic, message)
        yield from self.decoded()
        yield from self._to_messages(self.reorder.add(event))

    def process(self, event: Event) -> Iterator[Published]:
        """Take the next event of the total order (replay)."""
        yield from self._to_messages(self.engine.process(event))

    def advance(self, stamp_ns: int) -> Iterator[Published]:
        """No event before this stamp comes any more (replay)."""
        yield from self._to_messages(self.engine.advance(stamp_ns))

    def refuse(self, receipt: Receipt) -> Published:
        """Repeat the receipt of a message that a live run refused (replay)."""
        self.engine.verdicts[receipt.verdict] += 1
        return _published(RECEIPT, convert.receipt_to_msg(receipt))

    def flush(self) -> Iterator[Published]:
        """Process what waits: the end of the run, live or replayed."""
        yield from self._to_messages(self.reorder.flush())

    def decoded(self) -> Iterator[Published]:
        """Contents of the packets read since the last call, for people."""
        yield from self._decoded
        self._decoded.clear()

    def _fix_from_msg(self, message: Any, number: int) -> Fix:  # noqa: ANN401
        fix, broadcast = convert.fix_from_msg(message, number, self.params)
        if broadcast is not None:
            self._decoded.append(_published(DECODED, self._broadcast_to_msg(broadcast, fix)))
        return fix

    def _broadcast_to_msg(self, broadcast: Broadcast, fix: Fix) -> Any:  # noqa: ANN401
        target = self.vehicle if broadcast.target == self.params.own_id else str(broadcast.target)
        return convert.broadcast_to_msg(broadcast, fix.source, target, self.params.frame_id)

    def _to_messages(self, outputs: Iterable[Output]) -> Iterator[Published]:
        for output in outputs:
            if isinstance(output, Receipt):
                yield _published(RECEIPT, convert.receipt_to_msg(output))
            else:
                yield _published(STATE, convert.nav_to_msg(output, self.params, self.vehicle))


def _published(topic: str, message: Any) -> Published:  # noqa: ANN401
    return Published(topic, message, convert.to_bytes(message))
