"""Acoustic packets as modems carry them: bytes in a field of any message, with their times.

Modems hand over what they received in messages of their own. What matters of one is where the
bytes stand and when the last of them was in; the packet itself says everything else.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from polar_nav_core.errors import ConfigError
from polar_nav_core.link import packet, station_packet

from .layouts import PACKET, PACKETS, PAYLOAD_LIMITS, Paths
from .mapping import FixMapping, Stream
from .messages import get, ns_of

SIZES = {packet.VERSION: packet.SIZE, station_packet.VERSION: station_packet.SIZE}
"""Bytes of a packet by its first byte."""


class PacketRow(NamedTuple):
    """A packet that a modem received.

    Attributes
    ----------
    data : bytes
    source : str
        Who sent it, for receipts.
    sequence : int
        As the modem counts.
    transmit_ns, receive_ns : int
        First bit sent, 0 where nobody states it; packet complete [ns].
    """

    data: bytes
    source: str
    sequence: int
    transmit_ns: int
    receive_ns: int


def carries_packets(stream: Stream, kind: str = '') -> bool:
    """Whether a topic of fixes carries acoustic packets, by its type or the fields it names."""
    return (kind or stream.type) in PACKETS or 'payload' in stream.fields


def require_room(stream: Stream, kind: str, where: str) -> None:
    """Refuse a type of message that is too short for a leader's packet.

    Raises
    ------
    ConfigError
    """
    most = PAYLOAD_LIMITS.get(kind)
    if most is not None and most < packet.SIZE:
        raise ConfigError(f'{where}: {stream.topic}: {kind}: {too_long(most)}')


def too_long(most: int, size: int = packet.SIZE) -> str:
    """Sentence on a modem whose messages are shorter than a packet of that size."""
    fits = ''
    if station_packet.SIZE <= most < packet.SIZE:
        fits = f'; a packet of a station ({station_packet.SIZE} bytes, `mode: station`) fits'
    return (
        f'carries at most {most} bytes, a packet has {size}: fragments are not put together here, '
        f'because one that is lost takes all of the fix{fits}'
    )


def packet_of(
    message: Any,  # noqa: ANN401 - of any modem
    quantities: Mapping[str, Paths],
    mapping: FixMapping,
    receive_ns: int,
    number: int,
) -> PacketRow:
    """Packet in a message of a modem.

    Parameters
    ----------
    message : object
    quantities : mapping of str to paths
        Where they stand in it, of the role ``packet``.
    mapping : FixMapping
    receive_ns : int
        When it was received, by the host's clock [ns].
    number : int
        Of the message on its topic, where it does not state one itself.

    Raises
    ------
    ValueError, TypeError
        When the payload is not of bytes.
    """

    def of(name: str, usual: Any) -> Any:  # noqa: ANN401 - of the message
        return get(message, quantities[name][0]) if name in quantities else usual

    data = payload_of(of('payload', b''), mapping.encoding)
    if 'length' in quantities:
        data = data[: int(of('length', 0))]
    stream = mapping.position.stream
    if stream.type != PACKET and data:
        data = data[: SIZES.get(data[0], len(data))]  # modems fill up, some add an end of line
    transmit = of('transmit_time', None)
    return PacketRow(
        data=data,
        source=str(of('source', mapping.source)),
        sequence=int(of('sequence', number)),
        transmit_ns=0 if transmit is None else ns_of(transmit, 'transmit_time') + stream.offset_ns,
        receive_ns=receive_ns,
    )


def payload_of(value: Any, encoding: str) -> bytes:  # noqa: ANN401 - of the message
    """Bytes of a field: an array of bytes, or a text in an encoding.

    Raises
    ------
    ValueError, TypeError
        When it is neither.
    """
    if isinstance(value, str):
        if encoding == 'hex':
            return bytes.fromhex(value)
        if encoding == 'base64':
            return base64.b64decode(value, validate=True)
        raise ValueError(
            'the payload is a text, which cannot hold any byte: `encoding: hex` or `base64`'
        )
    if isinstance(value, bytes):
        return value
    if isinstance(value, list) and value and isinstance(value[0], bytes):
        return b''.join(value)  # `byte[]` in rclpy
    return np.asarray(value).astype(np.uint8).tobytes()


def encoded(data: bytes, encoding: str) -> str:
    """Return bytes as the text that `payload_of` reads."""
    return data.hex() if encoding == 'hex' else base64.b64encode(data).decode('ascii')
