"""Range and bearing in the station frame from a hydroacoustic station's packet.

The packet states when the transponder replied (t3), where the station was when the reply was back,
and what it measured. How well it measures is a property of the instrument, not of a fix: those
sigmas are parameters of the receiver.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_core.link import packet
from polar_nav_core.link.fields import rewound
from polar_nav_core.link.packet import PacketError
from polar_nav_core.link.station_packet import StationReport, decode

from ..params import FollowerParams

_NO_VECTOR = np.full(3, np.nan)
_NO_COVARIANCE = np.full((3, 3), np.nan)
_LAST_STAMP_NS = (1 << 31) * 1_000_000_000
_SEQUENCES = 256
"""The packet has room for eight bits of the number of the interrogation."""


def polar_of(report: StationReport, params: FollowerParams) -> PolarFix:
    """Range and bearing of a station's report, with the sigmas from the parameters."""
    return PolarFix(
        station=report.station_position,
        station_heading=report.station_heading,
        station_heading_sigma=report.station_heading_sigma,
        range=report.range,
        range_sigma=math.sqrt(params.range_variance(report.range)),
        bearing=report.bearing,
        bearing_sigma=math.sqrt(params.bearing_variance()),
        sound_speed=report.sound_speed,
    )


class StationNumbers:
    """Restores numbers of interrogations, of which packets hold the last eight bits.

    Of the numbers that fit, the one is taken that is nearest to what the times of validity say at
    the pace of the fixes so far; before there is a pace, the nearest to the newest number. So a
    silence of many cycles does not make a new fix look like an old one. Times wrap, and are read
    beside the vehicle's clock, which may step by years: only their differences count.
    """

    def __init__(self) -> None:
        self._first: dict[int, tuple[int, int]] = {}
        self._newest: dict[int, tuple[int, int]] = {}

    def whole(self, source: int, sequence: int, validity_ns: int) -> int:
        """Number of an interrogation of a station, given its last eight bits."""
        newest = self._newest.get(source)
        if newest is None:
            self._first[source] = self._newest[source] = (sequence, validity_ns)
            return sequence
        number, stamp_ns = newest
        validity_ns = rewound(validity_ns, stamp_ns)
        first, first_ns = self._first[source]
        passed = 0.0
        if number > first and stamp_ns > first_ns:
            passed = (validity_ns - stamp_ns) * (number - first) / (stamp_ns - first_ns)
        turns = round((number + passed - sequence) / _SEQUENCES)
        found = max(sequence + _SEQUENCES * turns, sequence)
        if validity_ns > stamp_ns and found > number:
            self._newest[source] = (found, validity_ns)
        return found


def station_fix_from_packet(
    data: bytes,
    source: str,
    order: int,
    arrival: int,
    transmit_ns: int,
    receive_ns: int,
    params: FollowerParams,
    numbers: StationNumbers,
) -> tuple[Fix, StationReport | None]:
    """Fix and content of a received packet; a fix without a range holds the reason."""
    unread = Fix(
        validity_ns=0,
        transmit_ns=transmit_ns,
        receive_ns=receive_ns,
        source=source,
        sequence=order,
        order=order,
        arrival=arrival,
        r_e=_NO_VECTOR,
        covariance_e=_NO_COVARIANCE,
    )

    def refused(verdict: Verdict, reason: str, fix: Fix = unread) -> Fix:
        return replace(fix, refusal=verdict, reason=reason)

    try:
        report = decode(data, receive_ns)
    except PacketError as error:
        if error.damaged:
            return refused(Verdict.BAD_CRC, str(error)), None
        return refused(Verdict.BAD_FORMAT, _of_a_leader(data) or str(error)), None
    if not 0 <= report.validity_ns < _LAST_STAMP_NS:
        return refused(Verdict.NOT_FINITE, 'its time is none that a stamp can hold'), None
    stated = replace(unread, validity_ns=report.validity_ns, sequence=report.sequence)
    if report.source != params.leader_id:
        reason = f'sent by station {report.source}, ours is {params.leader_id}'
        return refused(Verdict.UNKNOWN_SOURCE, reason, stated), report
    if report.target != params.own_id:
        reason = f'meant for vehicle {report.target}, this is {params.own_id}'
        return refused(Verdict.UNKNOWN_SOURCE, reason, stated), report
    number = numbers.whole(report.source, report.sequence, report.validity_ns)
    report = replace(report, sequence=number)
    fix = replace(stated, sequence=number, polar=polar_of(report, params))
    if report.range <= 0.0:
        return refused(Verdict.NOT_FINITE, 'its range is 0 m', replace(fix, polar=None)), report
    return fix, report


def _of_a_leader(data: bytes) -> str:
    """Sentence if a packet is a leader's; empty if it is not."""
    if len(data) != packet.SIZE or data[0] != packet.VERSION:
        return ''
    return (
        f'packet format {packet.VERSION}, a position that a leader gives: mode station takes '
        "range and bearing of a station's packet"
    )
