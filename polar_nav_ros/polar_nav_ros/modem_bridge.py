"""modem_bridge: packets between this project's topics and those of a modem's driver.

| topic | type | stamp |
| --- | --- | --- |
| in acomms/tx | polar_nav_msgs/AcousticPacket | first bit |
| in `receive` of the file | of the modem's driver | packet complete |
| out acomms/rx | polar_nav_msgs/AcousticPacket | transmission, zero where nobody states it |
| out `transmit` of the file | of the modem's driver | first bit |

Which topics, types and fields those are stands in a file (docs/modems.md). A packet is passed on
when it comes: when to send is the leader's matter, and the modem's medium access.
"""

from __future__ import annotations

import sys
from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import NodeParams, text
from polar_nav_msgs.msg import AcousticPacket

from .adapters import modem_file
from .adapters.mapping import FixMapping
from .adapters.messages import Fields, get, stamp_ns_of
from .adapters.packets import encoded, packet_of, too_long
from .adapters.rows import places_of
from .adapters.sensor_clock import SensorClock
from .diagnostics import Diagnosis, Level
from .node import PolarNode
from .process import run
from .source_ports import class_of
from .stamps import to_msg
from .topics import RX, TX


@dataclass(frozen=True)
class BridgeParams(NodeParams):
    """Parameters of modem_bridge."""

    modem: str = text('', 'File that names the topics of the modem (docs/modems.md)')


class ModemBridge(PolarNode[BridgeParams]):
    """Node between acomms/tx and acomms/rx of a vehicle and the driver of its modem."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('modem_bridge', BridgeParams, **kwargs)
        if not self.params.modem:
            raise ConfigError('parameter modem is missing: the file of the modem')
        file = modem_file.load(Path(self.params.modem).expanduser())
        self.counts: Counter[str] = Counter()
        if file.receive is not None:
            self._receive(file, file.receive)
        if file.transmit is not None:
            outgoing = Outgoing(file.transmit, class_of(file.transmit.stream, file.place))
            self._transmit(file.transmit, outgoing)

    def diagnose(self) -> Diagnosis:
        """Numbers of packets each way, and of those that could not be passed on."""
        values = {**self.taken_counts(), **self.published_counts(), **self.counts}
        refused = {name: n for name, n in self.counts.items() if n}
        if not refused:
            return Diagnosis(values=values)
        said = '; '.join(f'{n} packets {name}' for name, n in sorted(refused.items()))
        return Diagnosis(Level.WARN, said, values)

    def _receive(self, file: modem_file.ModemFile, mapping: FixMapping) -> None:
        stream = mapping.position.stream
        kind = class_of(stream, file.place)
        places = places_of(stream, 'packet', stream.type, Fields(kind()), file.place)
        clock = SensorClock() if stream.clock == 'sensor' else None
        heard = self.advertise(AcousticPacket, RX)
        counted = Counter[str]()

        def take(data: bytes) -> None:
            arrival_ns = self.get_clock().now().nanoseconds
            number = counted['taken']
            counted['taken'] += 1
            try:
                message = deserialize_message(data, kind)
                stamp_ns = stamp_ns_of(message, places.stamp, arrival_ns)
                if clock is not None:
                    stamp_ns = clock.host_ns(stamp_ns, arrival_ns)
                receive_ns = stamp_ns + stream.offset_ns
                row = packet_of(message, places.quantities, mapping, receive_ns, number)
                packet = self._packet(*row)
            except (RuntimeError, ValueError, TypeError, IndexError, MemoryError, AssertionError):
                self.counts['received that hold no bytes'] += 1
                return
            if packet.data:
                heard.publish(packet)

        self.subscribe(kind, stream.topic, take, raw=True)

    def _packet(
        self, data: bytes, source: str, sequence: int, transmit_ns: int, receive_ns: int
    ) -> AcousticPacket:
        packet = AcousticPacket(
            source=source,
            destination=self.vehicle,
            sequence=sequence,
            transmit_time=to_msg(transmit_ns),
            receive_time=to_msg(receive_ns),
            data=array('B', data),
        )
        packet.header.stamp = packet.transmit_time
        return packet

    def _transmit(self, transmit: modem_file.Transmit, outgoing: Outgoing) -> None:
        sent = self.advertise(outgoing.kind, transmit.stream.topic)

        def take(packet: AcousticPacket) -> None:
            data = bytes(packet.data)
            if len(data) > transmit.most:
                self.counts['too long to send'] += 1
                why = too_long(transmit.most, len(data))
                self.get_logger().error(f'{transmit.stream.topic} {why}', once=True)
                return
            sent.publish(outgoing.message(data, packet.transmit_time))

        self.subscribe(AcousticPacket, TX, take)


class Outgoing:
    """Messages for a modem's driver with the bytes of packets.

    Parameters
    ----------
    transmit : Transmit
    kind : type
        Class of the messages.

    Raises
    ------
    ConfigError
        When a field that the file names is not there, or cannot hold what it has to.
    """

    def __init__(self, transmit: modem_file.Transmit, kind: type[Any]) -> None:
        self.kind = kind
        self._transmit = transmit
        stream = transmit.stream
        self._fields = Fields(kind())
        self._places = places_of(stream, 'transmit', stream.type, self._fields, 'transmit')
        if isinstance(get(kind(), self._places.quantities['payload'][0]), str) and not (
            transmit.encoding
        ):
            raise ConfigError(
                f'{stream.topic}: the payload of {stream.type} is a text, which cannot hold any '
                'byte: `encoding: hex` or `base64`'
            )
        try:
            self.message(b'', None)
        except (AttributeError, AssertionError, TypeError, ValueError) as error:
            raise ConfigError(f'{stream.topic}: values: {stream.type}: {error}') from error

    def message(self, data: bytes, stamp: Any) -> Any:  # noqa: ANN401 - of the modem
        """Message with the bytes of a packet, with the stamp of its first bit."""
        message = self.kind()
        for path, value in self._transmit.values.items():
            usual = get(message, path)
            if not isinstance(usual, bool | int | float | str):
                raise TypeError(f'{path} is no number and no text')
            _put(message, path, type(usual)(value))
        quantities = self._places.quantities
        _put_bytes(message, quantities['payload'][0], data, self._transmit.encoding)
        if 'length' in quantities:
            _put(message, quantities['length'][0], len(data))
        if stamp is not None and 'header.stamp.sec' in self._fields:
            message.header.stamp = stamp
        return message


def _put(message: Any, path: str, value: Any) -> None:  # noqa: ANN401 - of any message
    """Set a field by its path."""
    front, _, name = path.rpartition('.')
    setattr(get(message, front) if front else message, name, value)


def _put_bytes(message: Any, path: str, data: bytes, encoding: str) -> None:  # noqa: ANN401
    """Set a field to bytes, as its type holds them."""
    usual = get(message, path)
    value: Any
    if isinstance(usual, str):
        value = encoded(data, encoding)
    elif isinstance(usual, np.ndarray):  # of a fixed size
        if len(data) > len(usual):
            raise ValueError(f'{path} holds {len(usual)} bytes')
        value = np.zeros(len(usual), dtype=usual.dtype)
        value[: len(data)] = np.frombuffer(data, dtype=np.uint8).astype(usual.dtype)
    elif isinstance(usual, array):
        value = array(usual.typecode, np.frombuffer(data, dtype=np.uint8).tolist())
    else:  # `byte[]`
        value = [bytes([one]) for one in data]
    _put(message, path, value)


def main(args: Sequence[str] | None = None) -> int:
    """Exit status of the node."""
    return run(ModemBridge, args)


if __name__ == '__main__':
    sys.exit(main())
