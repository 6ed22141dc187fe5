"""What a hydroacoustic station measured, as a message: the same of the simulation and a packet."""

from __future__ import annotations

from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_msgs.msg import StationFix

from .stamps import to_msg


def station_fix_to_msg(
    polar: PolarFix, source: str, target: str, sequence: int, validity_ns: int
) -> StationFix:
    """polar_nav_msgs/StationFix of a measurement; times of ping and return are left at zero.

    Parameters
    ----------
    polar : PolarFix
    source, target : str
        Vehicles of the station and of the transponder.
    sequence : int
        Number of the interrogation.
    validity_ns : int
        t3, when the transponder replied [ns].
    """
    msg = StationFix(source=source, target=target, sequence=sequence)
    msg.header.stamp = to_msg(validity_ns)
    msg.header.frame_id = 'station'
    msg.station_position = polar.station
    msg.station_heading = polar.station_heading
    msg.station_heading_sigma = polar.station_heading_sigma
    msg.range = polar.range
    msg.range_sigma = polar.range_sigma
    msg.bearing = polar.bearing
    msg.bearing_sigma = polar.bearing_sigma
    msg.sound_speed = polar.sound_speed
    return msg
