"""Legs of a fix's way: durations that add up to its age."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .content import Content, distance_of
from .records import FixRecords, Measured, Packet


@dataclass(frozen=True)
class Leg:
    """One part of the way of a fix [ns]; `counted` if it is part of the age."""

    name: str
    start_ns: int
    stop_ns: int
    how: str
    counted: bool = True

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return (self.stop_ns - self.start_ns) * 1e-9


def legs_of(
    measured: Measured | None,
    broadcast: Content | None,
    sent: Packet | None = None,
    heard: Packet | None = None,
) -> tuple[Leg, ...]:
    """Known legs of the way of a fix; the counted ones add up to its age exactly."""
    legs = []
    if measured is not None:
        m = measured
        how = f'{m.range_m:.0f} m at {m.sound_speed:.0f} m/s'
        legs += [
            Leg('ping to transponder', m.ping_ns, m.heard_ns, how, counted=False),
            Leg('turn-around', m.heard_ns, m.validity_ns, 'in the transponder', counted=False),
        ]
    packet = heard or sent
    validity_ns = return_ns = None
    if broadcast is not None:
        validity_ns, return_ns = broadcast.validity_ns, broadcast.return_ns
    elif measured is not None:
        validity_ns, return_ns = measured.validity_ns, measured.return_ns
    if validity_ns is not None and return_ns is not None:
        legs.append(Leg('reply to the array', validity_ns, return_ns, 'through the water'))
        if packet is not None:
            how = f'in the {packet.source}'
            legs.append(Leg('processing', return_ns, packet.transmit_ns, how))
    if heard is not None:
        legs += _packet_legs(heard, broadcast)
    return tuple(legs)


def _packet_legs(heard: Packet, broadcast: Content | None) -> list[Leg]:
    """Legs of the transmission: bits, travel time, and the rest of its duration."""
    start, stop = heard.transmit_ns, heard.receive_ns
    travel = _travel_ns(broadcast)
    if travel is None or not heard.bit_rate > 0.0:
        return [Leg('transmission', start, stop, 'bits, way and detection')]
    bits = round(heard.bits_s * 1e9)
    b = broadcast
    distance = distance_of(b) if b is not None else float('nan')
    speed = b.sound_speed if b is not None else float('nan')
    cut = [start, start + bits, start + bits + travel, stop]
    return [
        Leg('bits', cut[0], cut[1], f'{8 * len(heard.data)} bit at {heard.bit_rate:g} bit/s'),
        Leg('packet to follower', cut[1], cut[2], f'about {distance:.0f} m at {speed:.0f} m/s'),
        Leg('detection and the rest', cut[2], cut[3], 'detection, decoding, random delay'),
    ]


def _travel_ns(broadcast: Content | None) -> int | None:
    if broadcast is None or not broadcast.sound_speed > 0.0:
        return None
    return round(distance_of(broadcast) / broadcast.sound_speed * 1e9)


def expected_time(
    sent: tuple[Packet, ...], broadcast: Content | None, records: FixRecords
) -> int | None:
    """Expected stamp [ns] of the last try's reception, with other packets' detection time."""
    travel = _travel_ns(broadcast)
    if not sent or travel is None or not sent[-1].bit_rate > 0.0:
        return None
    rests = [
        leg.seconds
        for h in records.heard[:50]
        for leg in _packet_legs(h.packet, h.packet.broadcast)[2:]
    ]
    rest = float(np.median(rests)) if rests else 0.0
    return sent[-1].transmit_ns + round(sent[-1].bits_s * 1e9) + travel + round(rest * 1e9)
