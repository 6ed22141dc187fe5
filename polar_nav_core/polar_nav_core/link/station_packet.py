"""The 24 bytes (192 bits) that a hydroacoustic station sends to a vehicle (format 2).

Content of polar_nav_msgs/StationFix as far as a cheap receiver needs it. Positions are decimetres
in the station frame: the grid axes at the station's first position (x grid east, y grid north, z
up), fixed to the Earth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .fields import ANGLE_STEP, SIGMA_MOST, SIGMA_RATIO, WRAP, Field, Layout, unwrap

VERSION = 2

FIELDS: tuple[Field, ...] = (
    Field('version', 'B', 'int', 1, 0, 255, '', 'packet format, 2'),
    Field('source', 'B', 'int', 1, 0, 255, '', 'number of the station'),
    Field('target', 'B', 'int', 1, 0, 255, '', 'number of the vehicle that was ranged'),
    Field('sequence', 'B', 'int', 1, 0, 255, '', 'of the interrogation, wraps'),
    Field(
        'validity',
        'I',
        'ticks',
        1e-4,
        0,
        (WRAP - 1) * 1e-4,
        's',
        't3, when the transponder replied, wraps after 4.97 days',
    ),
    Field(
        'station_position',
        'h',
        'linear',
        0.1,
        -3276.7,
        3276.7,
        'm',
        'when the reply was back, station frame',
        3,
    ),
    Field(
        'station_heading',
        'H',
        'angle',
        ANGLE_STEP,
        -math.pi,
        math.pi,
        'rad',
        'psi when the reply was back, counter-clockwise from x',
    ),
    Field('station_heading_sigma', 'B', 'sigma', SIGMA_RATIO, 0, SIGMA_MOST, 'mrad', '1-sigma'),
    Field('range', 'H', 'linear', 0.1, 0, 6553.5, 'm', 'slant range'),
    Field(
        'bearing',
        'H',
        'angle',
        ANGLE_STEP,
        -math.pi,
        math.pi,
        'rad',
        "counter-clockwise from the station's heading",
    ),
    Field('sound_speed', 'B', 'above', 1, 1400, 1655, 'm/s', 'used for the range'),
)
LAYOUT = Layout(VERSION, FIELDS)
SIZE = LAYOUT.size
"""Bytes of a packet, CRC included."""


@dataclass(frozen=True)
class StationReport:
    """Content of one station packet in SI units.

    Attributes
    ----------
    sequence : int
        Of the interrogation; only its last eight bits are sent.
    validity_ns : int
        t3, when the vehicle's transponder replied.
    station_position : (3,) array
        When the reply was back, station frame [m].
    station_heading, station_heading_sigma : float
        psi then, counter-clockwise from x, and its 1-sigma [rad].
    range, bearing : float
        Slant range [m]; angle counter-clockwise from the station's heading [rad].
    sound_speed : float
        Used for the range [m/s].
    """

    source: int
    target: int
    sequence: int
    validity_ns: int
    station_position: NDArray[np.float64]
    station_heading: float
    station_heading_sigma: float
    range: float
    bearing: float
    sound_speed: float
    version: int = field(default=VERSION)

    @property
    def return_ns(self) -> int:
        """t4, when the reply was back at the station: t3 + range / c [ns]."""
        return self.validity_ns + round(self.range / self.sound_speed * 1e9)


def encode(report: StationReport) -> bytes:
    """Bytes of a report.

    Raises
    ------
    ValueError
        For a value outside of its field's range, with the field's name.
    """
    values: dict[str, object] = {
        'sequence': report.sequence % 256,
        'validity': report.validity_ns,
        'station_heading_sigma': report.station_heading_sigma * 1e3,
    }
    return LAYOUT.pack(report, values)


def decode(data: bytes, received_ns: int) -> StationReport:
    """Content of a station's packet, format 2; arguments and errors as in `packet.decode`."""
    raw = LAYOUT.unpack(data)
    return StationReport(
        source=int(raw['source'][0]),
        target=int(raw['target'][0]),
        sequence=int(raw['sequence'][0]),
        validity_ns=unwrap(int(raw['validity'][0]), received_ns),
        station_position=np.array(raw['station_position'], dtype=np.float64),
        station_heading=raw['station_heading'][0],
        station_heading_sigma=raw['station_heading_sigma'][0] * 1e-3,
        range=raw['range'][0],
        bearing=raw['bearing'][0],
        sound_speed=raw['sound_speed'][0],
    )


def documentation() -> str:
    """Table of the fields in Markdown."""
    return LAYOUT.documentation()
