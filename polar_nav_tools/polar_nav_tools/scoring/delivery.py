"""Delivery of sent packets: received, lost, or in flight at the end.

The follower cannot know of a packet that never came, so its receipts never say IN_FLIGHT. Who has
the sender's modem (`acomms/tx`), the receiver's (`acomms/rx`) and the end of the run can.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import TypeAlias

from .json_values import record
from .tables import Column, Table

Packet: TypeAlias = tuple[str, int]
"""Source and the number that its modem gave."""


@dataclass(frozen=True)
class Delivery:
    """Numbers of packets for one vehicle; sent = received + lost + in_flight.

    Attributes
    ----------
    sent, received, lost, in_flight : int
        `received`: of those sent, each once.
    repeated : int
        Packets that came in once more.
    unsent : int
        Packets that came in without having been sent: the record of what was sent has gaps.
    stated : bool
        The link itself said which packets were in flight. Otherwise those count that could still
        have come, had they taken as long as the slowest one, so that some may really be lost.
    """

    sent: int
    received: int
    lost: int
    in_flight: int
    repeated: int
    unsent: int
    stated: bool

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record(asdict(self))


def delivery(
    sent: Mapping[Packet, int],
    received: Collection[tuple[Packet, int]],
    end_ns: int,
    in_flight: Collection[Packet] | None = None,
) -> Delivery:
    """Delivery of all packets that were sent.

    Parameters
    ----------
    sent : mapping of Packet to int
        Transmit times [ns] of the packets for one vehicle.
    received : collection of (Packet, int)
        Packets that it received, and when [ns]; repeated ones again.
    end_ns : int
        End of the run: what arrives later does not count.
    in_flight : collection of Packet, optional
        As the link stated at its end.
    """
    came = {packet for packet, _ in received}
    missing = {packet: t for packet, t in sent.items() if packet not in came}
    if in_flight is None:
        longest_ns = max((t - sent[p] for p, t in received if p in sent), default=0)
        flying = sum(1 for t in missing.values() if t + longest_ns > end_ns)
    else:
        flying = sum(1 for packet in missing if packet in in_flight)
    return Delivery(
        sent=len(sent),
        received=len(sent) - len(missing),
        lost=len(missing) - flying,
        in_flight=flying,
        repeated=len(received) - len(came),
        unsent=len(came - set(sent)),
        stated=in_flight is not None,
    )


def delivery_table(d: Delivery) -> Table:
    """Table of the delivery in one row."""
    how = 'as the link stated' if d.stated else 'could still have come; some may be lost'
    columns = (
        Column('sent', 'sent'),
        Column('received', 'received'),
        Column('lost', 'lost'),
        Column('in_flight', 'in flight', doc=f'at the end of the run: {how}'),
        Column('repeated', 'repeated', doc='came in once more'),
    )
    row = d.to_dict()
    return Table('Packets sent to the follower', columns, ({c.key: row[c.key] for c in columns},))
