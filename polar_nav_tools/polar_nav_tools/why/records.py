"""Records of the fixes of one follower in a bag: readings, packets, receipts, joined per fix.

A fix has three numbers: that of its interrogation (`usbl/fix`, also in the packet's bytes, where
it wraps), the modem's number of the packet, and the index of the message on its topic. A packet
with damaged bytes has lost the first; the packet sent under the same modem number still has it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from polar_nav_follower.params import FollowerParams
from polar_nav_ros.topics import RECEIPT, RX, STATE, STATION, TRUTH, TX, USBL

from ..bags import Bag
from ..bags.arrays import (
    load_estimates,
    load_receipts,
    load_truth,
)
from ..series.vehicle import EstimateSeries, ReceiptRecord, TruthSeries
from .content import LEAST_WRAP, Content, PacketError, read_content, wrap_of

_WRAP = 65536
_SAME_NS = 1_000_000_000


@dataclass(frozen=True)
class Measured:
    """One reading of a leader's array (UsblFix) or of a station (StationFix); ns, SI units."""

    source: str
    sequence: int
    ping_ns: int
    heard_ns: int  # t2
    validity_ns: int  # t3
    return_ns: int  # t4
    range_m: float
    sound_speed: float


@dataclass(frozen=True)
class Packet:
    """One packet of a modem; `receive_ns` is 0 for a sent one."""

    source: str
    order: int  # as the modem counts
    transmit_ns: int
    receive_ns: int
    bit_rate: float
    data: bytes
    broadcast: Content | None
    problem: str  # reason for missing content
    sequence: int = -1  # of the fix; -1: not known

    @property
    def bits_s(self) -> float:
        """Duration [s] of its bits; NaN without a stated bit rate."""
        return 8 * len(self.data) / self.bit_rate if self.bit_rate > 0.0 else float('nan')


@dataclass(frozen=True)
class Heard:
    """A packet received by the follower, with its receipts, oldest revision first."""

    packet: Packet
    receipts: tuple[ReceiptRecord, ...] = ()

    @property
    def final(self) -> ReceiptRecord | None:
        """Receipt of the last revision, or None."""
        return self.receipts[-1] if self.receipts else None


@dataclass(frozen=True)
class FixRecords:
    """Records of a follower's fixes in a bag.

    Attributes
    ----------
    vehicle : str
        The follower.
    configuration : str
        Configuration of the estimates and receipts.
    replayed : bool
        Whether estimates and receipts come from a replay, not from the recording.
    measured, sent, heard : tuples
        In the order of their times.
    loose : tuple of ReceiptRecord
        Receipts of packets that never arrived (IN_FLIGHT), or are not in the bag.
    estimates, truth : EstimateSeries, TruthSeries or None
    transponder_lever_b : tuple of float
        Transponder from base_link [m]; the default if the bag does not state it.
    start_ns, end_ns : int
        First and last stamp of the run.
    sent_recorded : bool
        Whether the bag has the packets that the leaders sent.
    """

    vehicle: str
    configuration: str
    replayed: bool
    measured: tuple[Measured, ...]
    sent: tuple[Packet, ...]
    heard: tuple[Heard, ...]
    loose: tuple[ReceiptRecord, ...]
    estimates: EstimateSeries
    truth: TruthSeries | None
    transponder_lever_b: tuple[float, ...]
    start_ns: int
    end_ns: int
    sent_recorded: bool = True
    elsewhere: frozenset[int] = field(default_factory=frozenset)  # measured of other followers

    def sequences(self, source: str | None = None) -> set[int]:
        """Sequence numbers of all fixes in the bag."""
        chosen = [m for m in self.measured if source in (None, m.source)]
        packets = [*self.sent, *(h.packet for h in self.heard)]
        found = {m.sequence for m in chosen}
        return found | {p.sequence for p in packets if source in (None, p.source)}

    def sources(self) -> set[str]:
        """Leaders or stations of the fixes."""
        packets = [*self.sent, *(h.packet for h in self.heard)]
        return {m.source for m in self.measured} | {p.source for p in packets}


def load_records(
    bag: Bag, vehicle: str, configuration: str | None = None, *, params: Mapping[str, Any]
) -> FixRecords:
    """Records of a follower's fixes; replayed if receipts are missing or by a `configuration`.

    Parameters
    ----------
    bag : Bag
        Recorded run.
    vehicle : str
        The follower.
    configuration : str, optional
        Replay with this one.
    params : mapping
        Parameters of the recorded follower; empty if the bag does not state them.
    """
    measured = sorted(_measured(bag), key=lambda m: (m[0].ping_ns, m[0].source))
    own = tuple(m for m, target in measured if target == vehicle)
    sent = _sent(bag, vehicle, own)
    known = {(p.source, p.order): p.sequence for p in sent}
    packets = _numbered(_packets(bag, f'/{vehicle}/{RX}', vehicle), own, known)
    recorded = all(_count(bag, f'/{vehicle}/{topic}') for topic in (STATE, RECEIPT))
    replayed = configuration is not None or not recorded
    if replayed:
        from ..replay.by_message import replay

        run = replay(bag, configuration=configuration, vehicle=vehicle).as_run()
        estimates, receipts = run.estimates, run.receipts
        lever_b = run.params.transponder_lever_b
    else:
        estimates, receipts = load_estimates(bag, vehicle), load_receipts(bag, vehicle)
        lever_b = params.get('transponder_lever_b', FollowerParams().transponder_lever_b)
    truth = load_truth(bag, vehicle) if _count(bag, f'/{vehicle}/{TRUTH}') else None
    heard, loose = _joined(packets, receipts)
    stamps = [estimates.stamp_ns, *([truth.stamp_ns] if truth is not None else [])]
    ends = [int(s[k]) for s in stamps if len(s) for k in (0, -1)]
    ends += [h.packet.receive_ns for h in heard] or [p.transmit_ns for p in sent]
    return FixRecords(
        vehicle=vehicle,
        configuration=estimates.configuration,
        replayed=replayed,
        measured=own,
        sent=tuple(sent),
        heard=tuple(heard),
        loose=tuple(loose),
        estimates=estimates,
        truth=truth,
        transponder_lever_b=tuple(float(v) for v in lever_b),
        start_ns=min(ends, default=0),
        end_ns=max(ends, default=0),
        sent_recorded=any(t.count for t in _topics(bag, TX)),
        elsewhere=frozenset(m.sequence for m, target in measured if target != vehicle),
    )


def _count(bag: Bag, topic: str) -> int:
    return bag.topics[topic].count if topic in bag.topics else 0


def _topics(bag: Bag, name: str) -> Iterator[Any]:
    for topic in bag.topics.values():
        if topic.name.strip('/').partition('/')[2] == name:
            yield topic


def _ns(stamp: Any) -> int:  # noqa: ANN401 - a time of a message, of any generated class
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _measured(bag: Bag) -> Iterator[tuple[Measured, str]]:
    for topic in _topics(bag, USBL):
        for _, m in bag.read(topic.name):
            validity_ns = _ns(m.header.stamp)
            reading = Measured(
                source=str(m.source),
                sequence=int(m.sequence),
                ping_ns=_ns(m.ping_time),
                heard_ns=validity_ns - round(float(m.turn_around) * 1e9),
                validity_ns=validity_ns,
                return_ns=_ns(m.return_time),
                range_m=float(m.range),
                sound_speed=float(m.sound_speed),
            )
            yield reading, str(m.target)
    for topic in _topics(bag, STATION):
        for _, m in bag.read(topic.name):
            validity_ns, return_ns = _ns(m.header.stamp), _ns(m.return_time)
            reading = Measured(
                source=str(m.source),
                sequence=int(m.sequence),
                ping_ns=_ns(m.ping_time),
                heard_ns=validity_ns,  # the turn-around is not recorded
                validity_ns=validity_ns,
                return_ns=return_ns,
                range_m=float(m.range),
                sound_speed=float(m.sound_speed),
            )
            yield reading, str(m.target)


def _packets(bag: Bag, topic: str, vehicle: str) -> list[Packet]:
    """Packets for the follower on a topic, in recorded order."""
    if not _count(bag, topic):
        return []
    found = []
    for _, m in bag.read(topic):
        if m.destination != vehicle and not topic.startswith(f'/{vehicle}/'):
            continue
        data = bytes(bytearray(m.data))
        transmit_ns, receive_ns = _ns(m.transmit_time), _ns(m.receive_time)
        broadcast, problem = None, ''
        try:
            broadcast = read_content(data, receive_ns or transmit_ns)
        except PacketError as error:
            problem = str(error)
        found.append(
            Packet(
                source=str(m.source),
                order=int(m.sequence),
                transmit_ns=transmit_ns,
                receive_ns=receive_ns,
                bit_rate=float(m.bit_rate),
                data=data,
                broadcast=broadcast,
                problem=problem,
            )
        )
    return found


def _sent(bag: Bag, vehicle: str, measured: Sequence[Measured]) -> list[Packet]:
    packets = [p for t in _topics(bag, TX) for p in _packets(bag, t.name, vehicle)]
    packets.sort(key=lambda p: (p.transmit_ns, p.source, p.order))
    return _numbered(packets, measured, {})


def _numbered(
    packets: Sequence[Packet], measured: Sequence[Measured], known: Mapping[tuple[str, int], int]
) -> list[Packet]:
    """Packets completed with the sequence numbers of their fixes.

    By what was sent under the same modem number; else by the reading of that validity; else
    by unwrapping the number in the bytes; else the modem's number, as the receipt has it.
    """
    readings: dict[tuple[str, int], list[Measured]] = {}
    for m in measured:
        readings.setdefault((m.source, m.sequence % LEAST_WRAP), []).append(m)
    last: dict[str, int] = {}
    out = []
    for p in packets:
        sequence = known.get((p.source, p.order))
        if sequence is None and p.broadcast is not None:
            number = p.broadcast.sequence
            sequence = _read(p.broadcast, readings.get((p.source, number % LEAST_WRAP), []))
            if sequence is None:
                sequence = _unwrapped(number, last.get(p.source), wrap_of(p.broadcast))
        if sequence is None:
            sequence = p.order
        else:
            last[p.source] = sequence
        out.append(replace(p, sequence=sequence))
    return out


def _read(broadcast: Content, readings: Sequence[Measured]) -> int | None:
    """Sequence number of a broadcast's reading, by t3, which the leader rounds."""
    near = [m for m in readings if abs(m.validity_ns - broadcast.validity_ns) < _SAME_NS]
    return near[0].sequence if near else None


def _unwrapped(number: int, near: int | None, wrap: int) -> int:
    if near is None:
        return number
    step = (number - near + wrap // 2) % wrap - wrap // 2
    return max(near + step, number)


def _joined(
    packets: Sequence[Packet], receipts: Sequence[ReceiptRecord]
) -> tuple[list[Heard], list[ReceiptRecord]]:
    """Received packets, each with its receipts.

    A first receipt belongs to the first packet from the same sender at the same time that has
    none; a revision to the packet whose fix was used before.
    """
    mine: list[list[ReceiptRecord]] = [[] for _ in packets]
    places: dict[tuple[str, int], list[int]] = {}
    for i, p in enumerate(packets):
        places.setdefault((p.source, p.receive_ns), []).append(i)
    loose = []
    for r in receipts:
        if r.topic.strip('/').rpartition('acomms/')[2] != 'rx':
            continue
        at = places.get((r.source, r.receive_ns or 0), [])
        numbers = [
            i
            for i in at
            if r.sequence in (packets[i].sequence % _WRAP, packets[i].order, packets[i].sequence)
        ]
        free = [i for i in numbers if bool(mine[i]) == (r.revision > 0)]
        if free:
            mine[free[0]].append(r)
        else:
            loose.append(r)
    heard = [Heard(p, tuple(rs)) for p, rs in zip(packets, mine, strict=True)]
    heard.sort(key=lambda h: h.packet.receive_ns)
    return heard, loose
