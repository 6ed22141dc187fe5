"""Reads the file of a modem bridge: which topics of a modem's driver carry the packets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from polar_nav_core.link import packet, station_packet
from polar_nav_core.user_files import parse_yaml, read_text

from .layouts import PAYLOAD_LIMITS
from .mapping import ENCODINGS, FixMapping, Stream
from .packets import too_long
from .section import Section
from .stream_section import stream_of

VERSION = 1
KINDS = {'leader': packet.SIZE, 'station': station_packet.SIZE}
"""Bytes of the packets of each kind."""


@dataclass(frozen=True)
class Transmit:
    """A topic on which a modem takes what it has to send.

    Attributes
    ----------
    stream : Stream
    encoding : str
        ``hex`` or ``base64`` where the payload is a text.
    most : int
        Bytes that one message carries.
    values : mapping of str to object
        Other fields of the message, by their paths.
    """

    stream: Stream
    encoding: str
    most: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class ModemFile:
    """Everything that a file of a modem bridge states.

    Attributes
    ----------
    place : str
        For sentences.
    kind : str
        Whose packets these are, one of `KINDS`.
    receive : FixMapping or None
        Topic of what the modem received.
    transmit : Transmit or None
    """

    place: str
    kind: str
    receive: FixMapping | None
    transmit: Transmit | None


def load(path: Path) -> ModemFile:
    """Read a file of a modem bridge.

    Raises
    ------
    ConfigError
        Naming file, key, value and what would be right; also where the packets are longer than
        what the modem carries in one message.
    """
    top = Section(str(path), parse_yaml(read_text(path), str(path)))
    top.number('version', float(VERSION), VERSION, VERSION, '')
    kind = top.choice('packets', tuple(KINDS), 'leader')
    inward, outward = top.section('receive'), top.section('transmit')
    if inward is None and outward is None:
        raise top.fail('receive', 'is missing, and so is transmit: nothing to carry')
    found = ModemFile(
        place=str(path),
        kind=kind,
        receive=None if inward is None else _receive(inward, KINDS[kind]),
        transmit=None if outward is None else _transmit(outward, KINDS[kind]),
    )
    top.done()
    return found


def _receive(s: Section, size: int) -> FixMapping:
    stream = stream_of(s)
    _room(s, stream, size)
    mapping = FixMapping.of_packets(stream, s.text('source', 'modem'), _encoding(s))
    s.done()
    return mapping


def _transmit(s: Section, size: int) -> Transmit:
    stream = replace(stream_of(s), stamp='log')  # no stamp is read
    out = Transmit(stream, _encoding(s), _room(s, stream, size), s.texts('values'))
    s.done()
    return out


def _encoding(s: Section) -> str:
    encoding = s.choice('encoding', ENCODINGS) if 'encoding' in s else ''
    s.raw('encoding')
    return encoding


def _room(s: Section, stream: Stream, size: int) -> int:
    """Bytes that a message carries, at least those of a packet."""
    most = int(s.number('max_payload_bytes', 1e6, 1.0, 1e6, 'bytes'))
    most = min(most, PAYLOAD_LIMITS.get(stream.type, most))
    if most < size:
        raise s.fail('max_payload_bytes', f'{stream.topic} {too_long(most, size)}')
    return most
