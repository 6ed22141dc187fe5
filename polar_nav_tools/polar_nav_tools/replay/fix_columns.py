"""Acoustic packets of a bag, and receipts of messages that were no events, read as columns."""

from __future__ import annotations

import numpy as np

from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_follower.measurements.fix import Packet
from polar_nav_msgs.msg import AcousticPacket, FixReceipt
from polar_nav_ros.navigation_outputs import receipt_from_msg
from polar_nav_ros.stamps import to_ns

from ..bags.columns import read_columns, time_fields
from ..bags.columns import stamps as stamps_of
from ..bags.errors import BagError
from ..bags.reader import Bag
from .life import never_an_event
from .recorded import decoded

_PACKET_FIELDS = (
    *time_fields('transmit_time'),
    *time_fields('receive_time'),
    'data',
    'sequence',
    'source',
    # Not needed: whether they are texts decides whether this is a message.
    'destination',
    'header.frame_id',
)


def packets_of(bag: Bag, topic: str, messages: list[bytes]) -> list[Packet]:
    """Packets of messages, read as columns if their data have one length, else one by one."""
    if not messages:
        return []
    described = bag.definition(topic)
    try:
        c = read_columns(messages, described.type, described.text, _PACKET_FIELDS)
    except BagError:
        found = (decoded(bag, topic, data, AcousticPacket) for data in messages)
        return [
            Packet(
                bytes(m.data),
                m.source,
                m.sequence,
                to_ns(m.transmit_time),
                to_ns(m.receive_time),
            )
            for m in found
        ]
    times = (stamps_of(c, f'{end}_time').tolist() for end in ('transmit', 'receive'))
    data = (row.tobytes() for row in c['data'])
    columns = (data, c['source'].tolist(), c['sequence'].tolist(), *times)
    return [Packet(*values) for values in zip(*columns, strict=True)]


def refusals_of(bag: Bag, topic: str, messages: list[bytes]) -> list[Receipt]:
    """Receipts of messages that were no events (`never_an_event`); few are decoded whole."""
    if not messages:
        return []
    described = bag.definition(topic)
    verdicts = read_columns(messages, described.type, described.text, ['verdict'])['verdict']
    late = np.flatnonzero((verdicts == Verdict.TOO_LATE) | (verdicts == Verdict.FROM_FUTURE))
    receipts = (decoded(bag, topic, messages[i], FixReceipt) for i in late)
    return [receipt_from_msg(r) for r in receipts if never_an_event(r)]
