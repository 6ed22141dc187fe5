"""Damage of a packet that failed its CRC: the flipped bits and their fields."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from polar_nav_core.link import packet, station_packet
from polar_nav_core.link.packet import crc16


@dataclass(frozen=True)
class Damage:
    """Damage of a packet: its received bytes compared with the sent ones.

    Attributes
    ----------
    computed, stated : int
        CRC of the bytes as received, and the CRC in the packet.
    bits : int or None
        Number of flipped bits; None if the sent bytes are not recorded.
    differing : tuple of int
        Indices of the bytes that differ.
    fields : tuple of str
        Names of the fields with these bytes.
    received, sent : bytes
    """

    computed: int
    stated: int
    bits: int | None
    differing: tuple[int, ...]
    fields: tuple[str, ...]
    received: bytes
    sent: bytes | None


def damage_of(received: bytes, sent: bytes | None) -> Damage | None:
    """Damage of a packet; None if its CRC is right and its bytes are as sent."""
    if len(received) < 3:
        return Damage(0, 0, None, (), (), received, sent)
    stated = int(struct.unpack('<H', received[-2:])[0])
    computed = crc16(received[:-2])
    differing: tuple[int, ...] = ()
    bits = None
    if sent is not None and len(sent) == len(received):
        differing = tuple(i for i, (a, b) in enumerate(zip(sent, received, strict=True)) if a != b)
        bits = sum((sent[i] ^ received[i]).bit_count() for i in differing)
    if computed == stated and not differing:
        return None
    names = field_of_byte(sent) if sent is not None and len(sent) == len(received) else []
    fields = tuple(dict.fromkeys(names[i] for i in differing if i < len(names)))
    return Damage(computed, stated, bits, differing, fields, received, sent)


def field_of_byte(sent: bytes) -> list[str]:
    """Packet field of each byte; empty for an unknown format."""
    known = {(p.SIZE, p.VERSION): p.FIELDS for p in (packet, station_packet)}
    names: list[str] = []
    for f in known.get((len(sent), sent[0]), ()):
        names += [f.name] * (struct.calcsize('<' + f.code) * f.count)
    return [*names, 'crc', 'crc'] if names else []
