"""Packets of the leader, made when its states cover a reading: no clock, no ROS.

A measurement can be used when the leader's own states reach over ping and return; it is sent
`processing_delay_s` after the return, when the stamps of the data get there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from polar_nav_core.link.packet import Broadcast, encode

from .broadcast import ArrayMeasurement, Mounting, Unusable, make_broadcast
from .params import LeaderParams
from .states import LeaderState, LeaderStates


@dataclass(frozen=True)
class Packet:
    """A packet and its stamp of transmission.

    Attributes
    ----------
    transmit_ns : int
        Stamp of its first bit [ns].
    broadcast, data : Broadcast, bytes
        Content, and the same encoded.
    """

    transmit_ns: int
    broadcast: Broadcast
    data: bytes


class Leader:
    """Leader's part of a fix: readings and states in, packets out.

    Parameters
    ----------
    params : LeaderParams
        Mounting, identities, delays.
    """

    def __init__(self, params: LeaderParams) -> None:
        self._p = params
        self._mounting = Mounting.of(params.array_lever_b, params.array_rpy_deg)
        self._states = LeaderStates(params.odometry_history_s)
        self._waiting: list[ArrayMeasurement] = []
        self._delay_ns = round(params.processing_delay_s * 1e9)
        self._patience_ns = round(params.odometry_history_s * 1e9)
        self.counts: Counter[str] = Counter()

    @property
    def waiting(self) -> int:
        """Number of readings that wait for states of the leader."""
        return len(self._waiting)

    def add_state(self, state: LeaderState) -> None:
        """Store a state of the leader's own navigation."""
        if not self._states.add(state):
            self.counts['odometry_refused'] += 1

    def restart(self) -> None:
        """Drop the states, after a new start of the navigation."""
        self._states.clear()

    def add_measurement(self, measurement: ArrayMeasurement) -> None:
        """Store a reading of the array."""
        if measurement.target != self._p.follower:
            self.counts['other_target'] += 1
            return
        self._waiting.append(measurement)
        self._waiting.sort(key=lambda m: (m.return_ns, m.sequence))

    def due(self, now_ns: int | None = None) -> Iterator[Packet]:
        """Packets that are due, in order of transmission.

        Parameters
        ----------
        now_ns : int, optional
            Newest stamp of any data; by default that of the newest state.
        """
        newest = self._states.newest_ns
        now_ns = newest if now_ns is None else now_ns
        if now_ns is None:
            return
        while self._waiting and self._waiting[0].return_ns + self._delay_ns <= now_ns:
            return_ns = self._waiting[0].return_ns
            known = newest is not None and newest >= return_ns
            # Its state is still to come, unless the navigation has stopped.
            if not known and now_ns - return_ns <= self._patience_ns:
                return
            packet = self._packet(self._waiting.pop(0))
            if packet is not None:
                yield packet

    def _packet(self, measurement: ArrayMeasurement) -> Packet | None:
        at_ping = self._states.at(measurement.ping_ns)
        at_return = self._states.at(measurement.return_ns)
        if at_ping is None or at_return is None:
            self.counts['no_own_state'] += 1
            return None
        try:
            broadcast = make_broadcast(measurement, at_ping, at_return, self._mounting, self._p)
            data = encode(broadcast)
        except (Unusable, ValueError):
            self.counts['unusable'] += 1
            return None
        self.counts['sent'] += 1
        return Packet(measurement.return_ns + self._delay_ns, broadcast, data)
