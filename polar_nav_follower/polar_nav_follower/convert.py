"""Conversion of acoustic packets' messages to events.

Messages that every vehicle has are read and written in polar_nav_ros; besides the node and the
session, this is the only place of the package that knows both worlds.
"""

from __future__ import annotations

from polar_nav_core.engine.events import Fix
from polar_nav_core.link.packet import Broadcast
from polar_nav_core.link.station_packet import StationReport
from polar_nav_msgs.msg import AcousticPacket, StationFix
from polar_nav_ros.stamps import to_msg, to_ns
from polar_nav_ros.station_outputs import station_fix_to_msg

from .measurements.fix import fix_from_packet
from .measurements.station_fix import StationNumbers, polar_of, station_fix_from_packet
from .params import FollowerParams


def fix_from_msg(
    msg: AcousticPacket, number: int, params: FollowerParams
) -> tuple[Fix, Broadcast | None]:
    """Event of a leader's polar_nav_msgs/AcousticPacket, and its content if it can be decoded."""
    return fix_from_packet(
        bytes(msg.data),
        msg.source,
        msg.sequence,
        number,
        to_ns(msg.transmit_time),
        to_ns(msg.receive_time),
        params,
    )


def station_fix_from_msg(
    msg: AcousticPacket, number: int, params: FollowerParams, numbers: StationNumbers
) -> tuple[Fix, StationReport | None]:
    """Event of a station's polar_nav_msgs/AcousticPacket, and its content if it can be decoded."""
    return station_fix_from_packet(
        bytes(msg.data),
        msg.source,
        msg.sequence,
        number,
        to_ns(msg.transmit_time),
        to_ns(msg.receive_time),
        params,
        numbers,
    )


def station_report_to_msg(
    report: StationReport, source: str, target: str, params: FollowerParams
) -> StationFix:
    """polar_nav_msgs/StationFix of a packet's content; the ping time is unknown: zero."""
    polar = polar_of(report, params)
    msg = station_fix_to_msg(polar, source, target, report.sequence, report.validity_ns)
    msg.return_time = to_msg(report.return_ns)
    return msg
