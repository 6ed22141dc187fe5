"""acoustic_link_node: ``<v>/acomms/tx`` -> ``<v>/acomms/rx``, late, damaged or lost.

It reads the truth of all vehicles for the travel times and publishes a packet when that truth has
reached its receive time: no timers, so the result does not depend on pace.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.warm import forgo_blas, warm_places
from polar_nav_msgs.msg import AcousticPacket, VehicleTruth
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode
from polar_nav_ros.process import run
from polar_nav_ros.stamps import stamp_ns_of_cdr, to_msg

from ..acoustics import Channel, Packet
from ..convert import packet_from_msg
from ..params import AcousticLinkParams
from ..poses import TruthHistory
from ..sound_speed import SoundSpeed
from ..trajectory import NS

_HORIZON_NS = 60 * NS
"""Latest publication of a packet after its transmit time [s]; later ones are refused."""


class AcousticLinkNode(PolarNode[AcousticLinkParams]):
    """Node of the acoustic channel between the modems."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('acoustic_link_node', AcousticLinkParams, **kwargs)
        warm_places()
        p = self.params
        if len(p.vehicles) < 2:
            raise ConfigError(f'parameter vehicles: {list(p.vehicles)} are fewer than two')
        self._histories = {v: TruthHistory(_HORIZON_NS) for v in p.vehicles}
        self._channel = Channel(p, SoundSpeed.from_spec(p), p.seed, dict(self._histories))
        self._messages: dict[tuple[str, str, int], AcousticPacket] = {}
        self._refused = 0
        self._ended = False
        self._rx = {v: self.advertise(AcousticPacket, f'{v}/acomms/rx') for v in p.vehicles}
        for v in p.vehicles:
            self.subscribe(VehicleTruth, f'{v}/truth', partial(self._on_truth, v), raw=True)
            self.subscribe(AcousticPacket, f'{v}/acomms/tx', partial(self._on_packet, v))

    def diagnose(self) -> Diagnosis:
        """Fates of packets; at the end, those that are still under way, by name."""
        in_flight = self._channel.in_flight
        values = {
            **self.taken_counts(),
            **self.published_counts(),
            **self._channel.counts,
            'refused': self._refused,
            'in_flight': len(in_flight),
            'last_delay_s': self._channel.last_delay_s,
            'random_stream': 'acoustics/<source>/<destination>/<sequence>',
        }
        if self._ended:
            values['in_flight_packets'] = ' '.join(
                f'{p.source}->{p.destination}#{p.sequence}@{p.transmit_ns}' for p in in_flight
            )
            return Diagnosis(
                message=f'ended with {len(in_flight)} packets in flight', values=values
            )
        if self._refused:
            return Diagnosis(Level.WARN, f'{self._refused} packets refused', values)
        return Diagnosis(values=values)

    def close(self) -> None:
        """Log the packets that are still under way at the end of the run."""
        self._ended = True
        diagnosis = self.diagnose()
        self.get_logger().info(f'{diagnosis.message}: {self._channel.counts}')
        self._publish_diagnosis()

    def _on_truth(self, vehicle: str, data: bytes) -> None:
        if self._histories[vehicle].add(stamp_ns_of_cdr(data), data):
            self._deliver()

    def _on_packet(self, vehicle: str, msg: AcousticPacket) -> None:
        packet = packet_from_msg(msg)
        key = (packet.source, packet.destination, packet.sequence)
        why = self._problem(vehicle, packet)
        if why:
            self._refused += 1
            self.get_logger().warning(
                f'{vehicle}/acomms/tx: packet {packet.sequence} refused: {why}'
            )
            return
        self._messages[key] = msg
        self._channel.send(packet)
        self._deliver()

    def _problem(self, vehicle: str, packet: Packet) -> str:
        """Reason why a packet cannot be sent; empty if it can."""
        if packet.source != vehicle:
            return f'its source is {packet.source!r}'
        if packet.destination not in self._rx or packet.destination == vehicle:
            return f'destination {packet.destination!r} is no other vehicle of this link'
        if (packet.source, packet.destination, packet.sequence) in self._messages:
            return 'a packet of this number is still under way'
        oldest_ns = max(h.oldest_ns for h in self._histories.values())
        if packet.transmit_ns < oldest_ns:
            return f'transmit time {packet.transmit_ns} lies before the kept truth ({oldest_ns})'
        return ''

    def _deliver(self) -> None:
        now_ns = min(h.newest_ns for h in self._histories.values())
        for a in self._channel.arrived(now_ns):
            msg = self._messages.pop((a.source, a.destination, a.sequence))
            msg.receive_time = to_msg(a.receive_ns)
            msg.data = a.data
            self._rx[a.destination].publish(msg)
        if len(self._messages) > len(self._channel.in_flight):  # lost, out of range
            left = {(p.source, p.destination, p.sequence) for p in self._channel.in_flight}
            self._messages = {key: msg for key, msg in self._messages.items() if key in left}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    forgo_blas()
    return run(AcousticLinkNode, args)
