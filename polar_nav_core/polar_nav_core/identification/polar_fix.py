"""Range and bearing of a vehicle, measured by a hydroacoustic station."""

from __future__ import annotations

from dataclasses import dataclass

from ..arrays import Array


@dataclass(frozen=True)
class PolarFix:
    """Range and bearing from a hydroacoustic station, in the frame of its first position.

    Attributes
    ----------
    station : (3,) array
        Its position when the reply was back [m], station frame (grid axes, z up).
    station_heading, station_heading_sigma : float
        psi, counter-clockwise from x, and its 1-sigma, which is the same error in every fix [rad].
    range, range_sigma : float
        Slant range [m].
    bearing, bearing_sigma : float
        Counter-clockwise from the station's heading [rad].
    sound_speed : float
        Used for the range [m/s].
    """

    station: Array
    station_heading: float
    station_heading_sigma: float
    range: float
    range_sigma: float
    bearing: float
    bearing_sigma: float
    sound_speed: float
