"""The acoustic channel: time of arrival and received bits of each packet, or its loss.

    receive_time = transmit_time + bits / bit_rate + travel + detection + random part

Everything random about a packet comes from its own stream, named by source, destination and
sequence: two runs at different pace, or with packets published in another order, have the same
result.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, param

from .poses import NotKept, NotYet, Poses
from .randomness import stream
from .section import Spec
from .sound_speed import SoundSpeed
from .trajectory import NS
from .travel import arrival_ns

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelSpec(Spec):
    """Delays, losses and errors of packets on the way."""

    bit_rate: float = param(
        1000.0, 'bit/s', 1.0, 1e6, 'Used where a packet does not state its own bit rate'
    )
    detection_delay_s: float = param(0.1, 's', 0.0, 60.0, 'Fixed: synchronization and decoding')
    random_delay: str = choice(
        'uniform', ('uniform', 'exponential'), 'Distribution of the random delay'
    )
    random_delay_mean_s: float = param(0.0, 's', 0.0, 60.0, 'Its mean; 0: none')
    random_delay_max_s: float = param(10.0, 's', 0.0, 600.0, 'It is never longer')
    loss_probability: float = param(0.0, '', 0.0, 1.0, 'Probability that a packet never arrives')
    bit_error_rate: float = param(0.0, '', 0.0, 0.5, 'Probability that a bit arrives flipped')
    max_range_m: float = param(20000.0, 'm', 1.0, 1e6, 'A packet from farther away is lost')

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            self.random_delay == 'uniform'
            and 2.0 * self.random_delay_mean_s > self.random_delay_max_s
        ):
            raise ConfigError(
                f'parameter random_delay_mean_s: {self.random_delay_mean_s} is more than half of'
                f' random_delay_max_s {self.random_delay_max_s}, which a uniform delay reaches'
            )


@dataclass(frozen=True)
class Packet:
    """A packet as a modem sends it."""

    source: str
    destination: str
    sequence: int
    transmit_ns: int
    bit_rate: float
    data: bytes


@dataclass(frozen=True, order=True)
class Arrival:
    """A packet at its receiver; ordered by time, then by source and destination."""

    receive_ns: int
    source: str
    destination: str
    sequence: int
    packet: Packet = field(compare=False)
    data: bytes = field(compare=False)
    bits_flipped: int = field(compare=False)


@dataclass(frozen=True)
class Fate:
    """All random properties of one packet: loss, delay, flipped bits."""

    lost: bool
    delay_s: float
    data: bytes
    bits_flipped: int


@dataclass(frozen=True)
class _Way:
    """A packet under way, which cannot arrive before ``needed_ns``."""

    packet: Packet
    fate: Fate
    needed_ns: int


class Channel:
    """Acoustic channel between all vehicles, with the packets under way.

    Parameters
    ----------
    spec : ChannelSpec
        Delays, losses, errors.
    water : SoundSpeed
        Sound speed.
    run_seed : int
        Seed of the run.
    poses : mapping of str to Poses
        Poses of each vehicle.
    """

    def __init__(
        self, spec: ChannelSpec, water: SoundSpeed, run_seed: int, poses: dict[str, Poses]
    ) -> None:
        self._spec = spec
        self._water = water
        self._seed = run_seed
        self._poses = poses
        self._travelling: list[_Way] = []
        self._arriving: list[Arrival] = []
        self.counts = {
            'sent': 0,
            'delivered': 0,
            'lost': 0,
            'out_of_range': 0,
            'before_truth': 0,
            'bits_flipped': 0,
        }
        self.last_delay_s = float('nan')

    @property
    def in_flight(self) -> list[Packet]:
        """Packets under way, neither arrived nor lost, in order of sending."""
        packets = [way.packet for way in self._travelling] + [a.packet for a in self._arriving]
        return sorted(packets, key=lambda p: (p.transmit_ns, p.source, p.destination, p.sequence))

    def send(self, packet: Packet) -> None:
        """Send a packet.

        Raises
        ------
        ValueError
            For an unknown vehicle.
        """
        for name in (packet.source, packet.destination):
            if name not in self._poses:
                raise ValueError(f'packet {packet.sequence}: no vehicle {name!r} in this channel')
        self.counts['sent'] += 1
        fate = self.fate(packet)
        if fate.lost:
            self.counts['lost'] += 1
        else:
            self._travelling.append(_Way(packet, fate, packet.transmit_ns))

    def fate(self, packet: Packet) -> Fate:
        """Random properties of a packet; always the same for the same packet."""
        s = self._spec
        name = f'acoustics/{packet.source}/{packet.destination}/{packet.sequence}'
        rng = stream(self._seed, name)
        lost = bool(rng.random() < s.loss_probability)
        if s.random_delay == 'uniform':
            delay_s = 2.0 * s.random_delay_mean_s * rng.random()
        else:
            delay_s = min(s.random_delay_mean_s * rng.standard_exponential(), s.random_delay_max_s)
        bits = np.unpackbits(np.frombuffer(packet.data, np.uint8))
        flips = rng.random(bits.size) < s.bit_error_rate
        data = np.packbits(bits ^ flips).tobytes()
        return Fate(lost, float(delay_s), data, int(np.count_nonzero(flips)))

    def arrived(self, now_ns: int) -> list[Arrival]:
        """Packets that arrive until ``now_ns``, in the order of time, source, destination.

        Parameters
        ----------
        now_ns : int
            A time that the poses of all vehicles have reached.
        """
        waiting = []
        for way in self._travelling:
            if now_ns < way.needed_ns:
                waiting.append(way)
                continue
            try:
                arrival = self._arrival(way.packet, way.fate)
            except NotYet as early:
                waiting.append(_Way(way.packet, way.fate, early.needed_ns))
                continue
            except NotKept:
                # A node that starts while others run hears packets older than its first truth.
                self.counts['before_truth'] += 1
                continue
            if arrival is None:
                self.counts['out_of_range'] += 1
            else:
                heapq.heappush(self._arriving, arrival)
        self._travelling = waiting
        out = []
        while self._arriving and self._arriving[0].receive_ns <= now_ns:
            arrival = heapq.heappop(self._arriving)
            self.counts['delivered'] += 1
            self.counts['bits_flipped'] += arrival.bits_flipped
            self.last_delay_s = (arrival.receive_ns - arrival.packet.transmit_ns) / NS
            out.append(arrival)
        return out

    def _arrival(self, packet: Packet, fate: Fate) -> Arrival | None:
        """Arrival of a packet; None if it is sent from too far away."""
        destination = self._poses[packet.destination]
        from_e, from_depth = self._poses[packet.source].pose(packet.transmit_ns).point(_NO_ARM)
        first_bit_ns = arrival_ns(
            self._water, packet.transmit_ns, from_e, from_depth, destination, _NO_ARM
        )
        to_e = destination.pose(first_bit_ns).r_e
        if float(np.linalg.norm(to_e - from_e)) > self._spec.max_range_m:
            return None
        bit_rate = packet.bit_rate if packet.bit_rate > 0.0 else self._spec.bit_rate
        rest_s = 8 * len(packet.data) / bit_rate + self._spec.detection_delay_s + fate.delay_s
        return Arrival(
            first_bit_ns + round(rest_s * NS),
            packet.source,
            packet.destination,
            packet.sequence,
            packet,
            fate.data,
            fate.bits_flipped,
        )


_NO_ARM = np.zeros(3)
