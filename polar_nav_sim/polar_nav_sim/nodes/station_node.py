"""station_node: truth of station and vehicle -> ``station/fix``, and its packet on ``acomms/tx``.

A hydroacoustic station, fixed or on a vehicle of its own. The packet goes to the acoustic link,
which carries it after T_sigma; the fix in SI units is for displays, recording and other receivers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.link.station_packet import encode
from polar_nav_core.warm import forgo_blas, warm_places
from polar_nav_msgs.msg import AcousticPacket, StationFix, VehicleTruth
from polar_nav_ros import topics
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode
from polar_nav_ros.process import run
from polar_nav_ros.stamps import stamp_ns_of_cdr

from ..acoustics import Packet
from ..convert import packet_to_msg, station_to_msg
from ..params import StationParams
from ..poses import TruthHistory
from ..sensors.station import Station, StationFrame
from ..sound_speed import SoundSpeed
from ..station_sequence import StationSequence
from ..trajectory import NS
from ..truth_cdr import decode, since_start_ns

_HORIZON_NS = 60 * NS
"""Stored truth [s], longer than any cycle: 40 km of sound there and back."""


class StationNode(PolarNode[StationParams]):
    """One station; it publishes when the truth stamps that drive it reach t4."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('station_node', StationParams, **kwargs)
        warm_places()
        p = self.params
        if not p.target or p.target == self.vehicle:
            raise ConfigError(
                f'parameter target: {p.target!r} must name another vehicle than {self.vehicle!r}'
            )
        self._own, self._target = TruthHistory(_HORIZON_NS), TruthHistory(_HORIZON_NS)
        self._sequence: StationSequence | None = None
        self._refused = 0
        self._told = 0
        self._fix = self.advertise(StationFix, topics.STATION)
        self._tx = self.advertise(AcousticPacket, topics.TX)
        for history, topic in (
            (self._own, topics.TRUTH),
            (self._target, f'/{p.target}/{topics.TRUTH}'),
        ):
            self.subscribe(VehicleTruth, topic, partial(self._on_truth, history), raw=True)

    def diagnose(self) -> Diagnosis:
        """Counts, lost and queued cycles, random streams."""
        values: dict[str, object] = {
            **self.taken_counts(),
            **self.published_counts(),
            'refused': self._refused,
        }
        queued = 0
        if self._sequence is not None:
            queued = self._sequence.queued
            values |= {
                'interrogations': self._sequence.sequence,
                'lost_cycles': self._sequence.lost,
                'queued_pings': queued,
                'random_stream': f'{self.vehicle}/station/{self.params.target}/<sequence>',
            }
        if self._refused:
            text = f'{self._refused} truth messages unreadable or running backwards'
            return Diagnosis(Level.WARN, text, values)
        if queued:
            text = f'{queued} pings waited: period_s is too short for the range'
            return Diagnosis(Level.WARN, text, values)
        return Diagnosis(values=values)

    def _on_truth(self, history: TruthHistory, data: bytes) -> None:
        try:
            stamp_ns, since_ns = stamp_ns_of_cdr(data), since_start_ns(data)
        except ValueError as error:
            self._refuse(str(error))
            return
        if not history.add(stamp_ns, data):
            self._refuse(f'stamp {stamp_ns} is not newer than the last')
            return
        if self._sequence is None and history is self._own:
            self._sequence = self._start(data, stamp_ns, since_ns)
        self._advance()

    def _start(self, data: bytes, stamp_ns: int, since_ns: int) -> StationSequence:
        p = self.params
        if since_ns > 0:
            self.get_logger().warning(
                f'station axes begin {since_ns / NS:.2f} s after the start: the station was not'
                ' heard before; if it moves they are not those of its first position'
            )
        frame = StationFrame(decode(data).vector('r_e'))
        station = Station(p, SoundSpeed.from_spec(p), p.seed, self.vehicle, p.target, frame)
        start_ns = stamp_ns - since_ns
        return StationSequence(station, self._own, self._target, p, p, start_ns, stamp_ns)

    def _advance(self) -> None:
        sequence, p = self._sequence, self.params
        if sequence is None:
            return
        for reading in sequence.advance(min(self._own.newest_ns, self._target.newest_ns)):
            self._fix.publish(station_to_msg(reading, self.vehicle, p.target))
            packet = Packet(
                self.vehicle,
                p.target,
                reading.cycle.sequence,
                reading.transmit_ns,
                p.bit_rate,
                encode(reading.report(p.own_id, p.target_id)),
            )
            self._tx.publish(packet_to_msg(packet))
        if sequence.queued > self._told:
            self._told = sequence.queued
            self.get_logger().warning(
                f'{self._told} pings waited: period_s {p.period_s} s is shorter than'
                ' 3 D/c + N/v + T_sigma',
                throttle_duration_sec=30.0,
            )

    def _refuse(self, why: str) -> None:
        self._refused += 1
        self.get_logger().warning(f'truth refused: {why}', throttle_duration_sec=5.0)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    forgo_blas()
    return run(StationNode, args)
