"""Numbers of packets in a bag: sent to a vehicle, received, in flight at the end."""

from __future__ import annotations

import re
from typing import Any

from polar_nav_ros import topics

from ..bags import Bag
from ..scoring.delivery import Delivery, Packet, delivery

_IN_FLIGHT = 'in_flight_packets'
"""Value in the last diagnostics of the link, where there is one: `leader->follower#12@<ns>`."""
_STATED = re.compile(r'(?P<source>.*)->(?P<destination>.*)#(?P<number>\d+)@\d+')
_SHUTDOWN = 2  # Command.SHUTDOWN


def delivery_of(bag: Bag, follower: str) -> Delivery | None:
    """Delivery of packets to one vehicle; None if the bag has no modem of the sender."""
    senders = [
        t.name for t in bag.topics.values() if t.name.endswith(f'/{topics.TX}') and t.count > 0
    ]
    if not senders:
        return None
    sent = {
        _packet(m): _ns(m.transmit_time)
        for topic in senders
        for _, m in bag.read(topic)
        if m.destination == follower
    }
    received = [
        (_packet(m), _ns(m.receive_time))
        for m in _messages(bag, f'/{follower}/{topics.RX}')
        if m.destination == follower
    ]
    known = [*sent.values(), *(t for _, t in received)]
    ends = [
        _ns(m.header.stamp)
        for m in _messages(bag, f'/{follower}/{topics.COMMAND}')
        if m.kind == _SHUTDOWN
    ]
    return delivery(sent, received, max(ends or known or [0]), stated_in_flight(bag, follower))


def stated_in_flight(bag: Bag, follower: str) -> set[Packet] | None:
    """Packets in flight by the last status of the simulated link; None without a status."""
    found: set[Packet] | None = None
    for message in _messages(bag, topics.DIAGNOSTICS):
        for status in message.status:
            for value in status.values:
                if value.key == _IN_FLIGHT:
                    found = _parse(value.value, follower)
    return found


def _parse(text: str, follower: str) -> set[Packet]:
    matches = (_STATED.fullmatch(word) for word in text.split())
    return {
        (m['source'], int(m['number']))
        for m in matches
        if m is not None and m['destination'] == follower
    }


def _messages(bag: Bag, topic: str) -> list[Any]:
    if topic not in bag.topics or not bag.topics[topic].count:
        return []
    return [message for _, message in bag.read(topic)]


def _packet(message: Any) -> Packet:  # noqa: ANN401 - polar_nav_msgs/AcousticPacket
    return str(message.source), int(message.sequence)


def _ns(time: Any) -> int:  # noqa: ANN401 - builtin_interfaces/Time
    return int(time.sec) * 10**9 + int(time.nanosec)
