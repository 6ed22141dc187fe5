"""What happened to the bytes of a packet that failed its CRC: which bits, in which fields."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from polar_nav_core.link import packet, station_packet
from polar_nav_core.link.packet import crc16


@dataclass(frozen=True)
class Damage:
    """Bytes as received against as sent.

    Attributes
    ----------
    computed, said : int
        CRC of the bytes as received, and the one that came with them.
    bits : int or None
        Bits that differ from what was sent; None where that was not recorded.
    places : tuple of int
        Bytes that differ.
    fields : tuple of str
        Fields that they belong to.
    received, sent : bytes
    """

    computed: int
    said: int
    bits: int | None
    places: tuple[int, ...]
    fields: tuple[str, ...]
    received: bytes
    sent: bytes | None


def damage_of(received: bytes, sent: bytes | None) -> Damage | None:
    """Damage of a packet; None for one whose CRC fits and that is as it was sent."""
    if len(received) < 3:
        return Damage(0, 0, None, (), (), received, sent)
    said = int(struct.unpack('<H', received[-2:])[0])
    computed = crc16(received[:-2])
    places: tuple[int, ...] = ()
    bits = None
    if sent is not None and len(sent) == len(received):
        places = tuple(i for i, (a, b) in enumerate(zip(sent, received, strict=True)) if a != b)
        bits = sum((sent[i] ^ received[i]).bit_count() for i in places)
    if computed == said and not places:
        return None
    names = field_of_byte(sent) if sent is not None and len(sent) == len(received) else []
    fields = tuple(dict.fromkeys(names[i] for i in places if i < len(names)))
    return Damage(computed, said, bits, places, fields, received, sent)


def field_of_byte(sent: bytes) -> list[str]:
    """Name of the packet field that each byte belongs to; none of a packet that is not known."""
    known = {(p.SIZE, p.VERSION): p.FIELDS for p in (packet, station_packet)}
    names: list[str] = []
    for f in known.get((len(sent), sent[0]), ()):
        names += [f.name] * (struct.calcsize('<' + f.code) * f.count)
    return [*names, 'crc', 'crc'] if names else []
