"""Story of one fix as numbers: times, legs of its way, content, verdict, effect."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polar_nav_core.errors import ConfigError

from ..series.vehicle import ReceiptRecord
from .content import Content
from .damage import Damage, damage_of
from .effects import (
    Around,
    Belief,
    Change,
    Other,
    belief_at_validity,
    change_by,
    others_under_way,
    time_around,
)
from .legs import Leg, expected_time, legs_of
from .records import FixRecords, Heard, Measured, Packet

LOST, IN_WATER, ARRIVED = 'lost', 'in the water', 'arrived'
NOT_SENT, WAITING = 'not sent', 'waiting in the leader'
_SOON = 0.5
"""A packet that should have come this long before the end of the recording is lost [s]."""


class UnknownFixError(ConfigError):
    """No fix of the bag has this sequence number."""


@dataclass(frozen=True)
class Copy:
    """One received packet of the fix: its receipts, and the damage of its bytes."""

    packet: Packet
    receipts: tuple[ReceiptRecord, ...]
    damage: Damage | None
    legs: tuple[Leg, ...]

    @property
    def final(self) -> ReceiptRecord | None:
        """Receipt of the last revision, or None."""
        return self.receipts[-1] if self.receipts else None

    @property
    def verdict(self) -> str:
        """Verdict as one word."""
        return self.final.verdict_text if self.final is not None else 'no receipt'


@dataclass(frozen=True)
class Story:
    """Story of one fix.

    Attributes
    ----------
    sequence, source, vehicle, configuration : int, str, str, str
    replayed : bool
        Whether receipts and estimates come from a replay.
    fate : str
        ARRIVED, LOST, IN_WATER, WAITING or NOT_SENT.
    measured : Measured or None
    sent : tuple of Packet
    copies : tuple of Copy
        Received packets, in order.
    main : int
        Index of the copy that decided, -1 without one.
    broadcast : Content or None
        Content of the packet.
    legs : tuple of Leg
        From the ping to the use; the known ones if the packet never arrived.
    """

    sequence: int
    source: str
    vehicle: str
    configuration: str
    replayed: bool
    fate: str
    zero_ns: int
    end_ns: int
    measured: Measured | None
    sent: tuple[Packet, ...]
    copies: tuple[Copy, ...]
    main: int
    broadcast: Content | None
    legs: tuple[Leg, ...]
    expected_ns: int | None
    belief: Belief | None
    change: Change | None
    others: tuple[Other, ...]
    loose: tuple[ReceiptRecord, ...]
    sent_recorded: bool
    has_truth: bool
    around: Around = field(repr=False)

    @property
    def copy(self) -> Copy | None:
        """The copy with the deciding receipt, or None."""
        return self.copies[self.main] if self.main >= 0 else None

    @property
    def validity_ns(self) -> int | None:
        """Time of validity t3 [ns], or None."""
        if self.broadcast is not None:
            return self.broadcast.validity_ns
        return self.measured.validity_ns if self.measured is not None else None


def story_of(records: FixRecords, sequence: int, source: str | None = None) -> Story:
    """Story of a fix, gathered from the records of its follower.

    Parameters
    ----------
    records : FixRecords
        Records of the follower.
    sequence : int
        Number of the fix: of the leader's interrogation, as in the receipts.
    source : str, optional
        Its leader, when there are several.

    Raises
    ------
    UnknownFixError
        If the bag has no such fix; the text lists those in the bag.
    """
    source = _source_of(records, sequence, source)
    measured = next(
        (m for m in records.measured if (m.source, m.sequence) == (source, sequence)), None
    )
    sent = tuple(p for p in records.sent if (p.source, p.sequence) == (source, sequence))
    heard = [
        h for h in records.heard if (h.packet.source, h.packet.sequence) == (source, sequence)
    ]
    broadcasts = [h.packet.broadcast for h in heard] + [p.broadcast for p in sent]
    broadcast = next((b for b in broadcasts if b is not None), None)
    copies = tuple(_copy(h, sent, measured, broadcast) for h in heard)
    main = _deciding(copies)
    expected_ns = expected_time(sent, broadcast, records)
    if copies:
        fate = ARRIVED
    elif not sent:
        fate = WAITING if _waits(records, measured) else NOT_SENT
    else:
        late = expected_ns is not None and expected_ns > records.end_ns - round(_SOON * 1e9)
        fate = IN_WATER if late else LOST
    legs = copies[main].legs if copies else legs_of(measured, broadcast, sent[0] if sent else None)
    used = copies[main].final if copies else None
    story_span = [x for leg in legs for x in (leg.start_ns, leg.stop_ns)]
    if expected_ns is not None:
        story_span.append(expected_ns)
    way = [x for leg in legs if leg.counted for x in (leg.start_ns, leg.stop_ns)]
    way += [expected_ns] if expected_ns is not None and not copies else []
    return Story(
        sequence=sequence,
        source=source,
        vehicle=records.vehicle,
        configuration=records.configuration,
        replayed=records.replayed,
        fate=fate,
        zero_ns=records.start_ns,
        end_ns=records.end_ns,
        measured=measured,
        sent=sent,
        copies=copies,
        main=main,
        broadcast=broadcast,
        legs=legs,
        expected_ns=expected_ns,
        belief=belief_at_validity(records, measured, broadcast),
        change=change_by(records, used, sequence),
        others=others_under_way(records, source, sequence, way),
        loose=tuple(r for r in records.loose if (r.source, r.sequence) == (source, sequence)),
        sent_recorded=records.sent_recorded,
        has_truth=records.truth is not None,
        around=time_around(records, story_span, sequence),
    )


def ranges(numbers: set[int]) -> str:
    """Text of numbers: ``0 to 12, 14``."""
    parts: list[list[int]] = []
    for n in sorted(numbers):
        if parts and n == parts[-1][1] + 1:
            parts[-1][1] = n
        else:
            parts.append([n, n])
    shown = [f'{a} to {b}' if b > a else f'{a}' for a, b in parts]
    if len(shown) > 12:
        shown = [*shown[:6], f'... ({len(numbers)} in all)', *shown[-3:]]
    return ', '.join(shown)


def _source_of(records: FixRecords, sequence: int, source: str | None) -> str:
    sources = records.sources()
    if source is not None and source not in sources:
        raise UnknownFixError(
            f'no fix from {source!r} in this bag; they come from {", ".join(sorted(sources))}'
        )
    having = sorted(s for s in sources if source in (None, s) and sequence in records.sequences(s))
    if len(having) == 1:
        return having[0]
    if having:
        raise UnknownFixError(
            f'fix {sequence} came from {" and ".join(having)}: name one with --source'
        )
    found = records.sequences(source)
    if not found:
        raise UnknownFixError(f'this bag holds no fix of {records.vehicle}')
    why = ''
    if sequence in records.elsewhere:
        why = f'; interrogation {sequence} asked another vehicle'
    elif records.measured and min(found) < sequence < max(found):
        why = f'; the array recorded no reply to interrogation {sequence}'
    raise UnknownFixError(
        f'no fix {sequence} of {records.vehicle}: the bag holds {ranges(found)}{why}'
    )


def _waits(records: FixRecords, measured: Measured | None) -> bool:
    """Whether the recording ended before the leader would have sent it, as it sent other fixes."""
    if measured is None:
        return False
    returned = {(m.source, m.sequence): m.return_ns for m in records.measured}
    took = [
        p.transmit_ns - returned[p.source, p.sequence]
        for p in records.sent
        if (p.source, p.sequence) in returned
    ]
    usual_ns = round(float(np.median(took))) if took else 0
    return measured.return_ns + usual_ns >= records.end_ns


def _deciding(copies: tuple[Copy, ...]) -> int:
    """Index of the copy that was used or judged, else of the first one."""
    for wanted in ('FUSED', 'GATED'):
        for i, c in enumerate(copies):
            if c.verdict == wanted:
                return i
    return 0 if copies else -1


def _copy(
    heard: Heard, sent: tuple[Packet, ...], measured: Measured | None, broadcast: Content | None
) -> Copy:
    original = next((p for p in sent if p.order == heard.packet.order), None)
    damage = damage_of(heard.packet.data, None if original is None else original.data)
    legs = legs_of(measured, broadcast, original, heard.packet)
    return Copy(heard.packet, heard.receipts, damage, legs)
