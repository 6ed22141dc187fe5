"""The bytes that a leader sends to a follower (format 1), all by one table of fields.

Positions are ECEF centimetres, so the pole is an ordinary place; packet_fields says how each kind
of field is coded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .fields import (
    ANGLE_STEP,
    SIGMA_MOST,
    SIGMA_RATIO,
    TICK_NS,
    WRAP,
    Field,
    Layout,
    PacketError,
    crc16,
    round_tick,
    unwrap,
)

__all__ = [
    'FIELDS',
    'SIZE',
    'TICK_NS',
    'VERSION',
    'Broadcast',
    'PacketError',
    'crc16',
    'decode',
    'documentation',
    'encode',
]

VERSION = 1

FIELDS: tuple[Field, ...] = (
    Field('version', 'B', 'int', 1, 0, 255, '', 'packet format, 1'),
    Field('source', 'B', 'int', 1, 0, 255, '', 'number of the leader'),
    Field(
        'target',
        'B',
        'int',
        1,
        0,
        255,
        '',
        'number of the follower that the relative vector belongs to',
    ),
    Field('sequence', 'H', 'int', 1, 0, 65535, '', 'of the fix, wraps'),
    Field('validity', 'I', 'ticks', 1e-4, 0, (WRAP - 1) * 1e-4, 's', 't3, wraps after 4.97 days'),
    Field('reply_travel', 'H', 'linear', 1e-4, 0, 6.5535, 's', 't4 - t3'),
    Field(
        'leader_r_e', 'i', 'linear', 0.01, -2.1e7, 2.1e7, 'm', "leader's base_link at t4, ECEF", 3
    ),
    Field(
        'leader_sigma_horizontal',
        'B',
        'sigma',
        SIGMA_RATIO,
        0,
        SIGMA_MOST,
        'm',
        '1-sigma per horizontal axis',
    ),
    Field('leader_sigma_vertical', 'B', 'sigma', SIGMA_RATIO, 0, SIGMA_MOST, 'm', '1-sigma'),
    Field(
        'leader_v_G', 'h', 'linear', 0.001, -32.767, 32.767, 'm/s', "leader's grid axes at t4", 3
    ),
    Field(
        'leader_sigma_velocity',
        'B',
        'sigma',
        SIGMA_RATIO,
        0,
        SIGMA_MOST,
        'm/s',
        '1-sigma per axis',
    ),
    Field(
        'leader_grid_heading',
        'H',
        'angle',
        ANGLE_STEP,
        -math.pi,
        math.pi,
        'rad',
        'at t4, clockwise from grid north',
    ),
    Field('leader_sigma_heading', 'B', 'sigma', SIGMA_RATIO, 0, SIGMA_MOST, 'mrad', '1-sigma'),
    Field(
        'r_lf_G',
        'i',
        'linear',
        0.01,
        -1e5,
        1e5,
        'm',
        "leader at t4 to follower at t3, leader's grid axes",
        3,
    ),
    Field('r_lf_sigma_G', 'B', 'sigma', SIGMA_RATIO, 0, SIGMA_MOST, 'm', '1-sigma of r_lf_G', 3),
    Field(
        'r_lf_correlation',
        'b',
        'correlation',
        1 / 127,
        -1,
        1,
        '',
        'xy, xz, yz; rounded towards zero',
        3,
    ),
    Field('sound_speed', 'H', 'above', 0.01, 1000, 1655.35, 'm/s', 'used for the range'),
)
LAYOUT = Layout(VERSION, FIELDS)
SIZE = LAYOUT.size
"""Bytes of a packet, CRC included."""


@dataclass(frozen=True)
class Broadcast:
    """Content of one leader packet in SI units.

    Attributes
    ----------
    validity_ns, return_ns : int
        t3, when the follower's transponder replied, and t4, when the leader heard it.
    leader_r_e : (3,) array
        Leader's base_link at t4, ECEF [m].
    r_lf_G : (3,) array
        From the leader's base_link at t4 to the follower's transponder at t3, leader's grid axes
        [m].
    r_lf_covariance_G : (3, 3) array
        Its covariance [m^2].
    """

    source: int
    target: int
    sequence: int
    validity_ns: int
    return_ns: int
    leader_r_e: NDArray[np.float64]
    leader_sigma_horizontal: float
    leader_sigma_vertical: float
    leader_v_G: NDArray[np.float64]
    leader_sigma_velocity: float
    leader_grid_heading: float
    leader_sigma_heading: float
    r_lf_G: NDArray[np.float64]
    r_lf_covariance_G: NDArray[np.float64]
    sound_speed: float
    version: int = field(default=VERSION)


def encode(b: Broadcast) -> bytes:
    """Bytes of a broadcast.

    Raises
    ------
    ValueError
        For a value outside of its field's range, with the field's name.
    """
    sigma_G = np.sqrt(np.diag(b.r_lf_covariance_G))
    outer = np.where(np.outer(sigma_G, sigma_G) > 0, np.outer(sigma_G, sigma_G), 1.0)
    correlation = b.r_lf_covariance_G / outer
    values: dict[str, object] = {
        'version': b.version,
        'source': b.source,
        'target': b.target,
        'sequence': b.sequence % 65536,
        'validity': b.validity_ns,
        'reply_travel': (b.return_ns - round_tick(b.validity_ns) * TICK_NS) * 1e-9,
        'leader_sigma_heading': b.leader_sigma_heading * 1e3,
        'r_lf_sigma_G': sigma_G,
        'r_lf_correlation': np.array([correlation[0, 1], correlation[0, 2], correlation[1, 2]]),
    }
    return LAYOUT.pack(b, values)


def decode(data: bytes, received_ns: int) -> Broadcast:
    """Content of a leader's packet.

    Parameters
    ----------
    data : bytes
        The packet, format 1.
    received_ns : int
        When it was received; resolves the wrapped time of validity to the nearest possible one.

    Raises
    ------
    PacketError
        When the CRC does not fit, or the version or the length is not one we know.
    """
    raw = LAYOUT.unpack(data)

    def one(name: str) -> float:
        return raw[name][0]

    def three(name: str) -> NDArray[np.float64]:
        return np.array(raw[name], dtype=np.float64)

    validity_ns = unwrap(int(one('validity')), received_ns)
    sigma_G = three('r_lf_sigma_G')
    xy, xz, yz = raw['r_lf_correlation']
    correlation = np.array([[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]])
    return Broadcast(
        source=int(one('source')),
        target=int(one('target')),
        sequence=int(one('sequence')),
        validity_ns=validity_ns,
        return_ns=validity_ns + round(one('reply_travel') * 1e9),
        leader_r_e=three('leader_r_e'),
        leader_sigma_horizontal=one('leader_sigma_horizontal'),
        leader_sigma_vertical=one('leader_sigma_vertical'),
        leader_v_G=three('leader_v_G'),
        leader_sigma_velocity=one('leader_sigma_velocity'),
        leader_grid_heading=one('leader_grid_heading'),
        leader_sigma_heading=one('leader_sigma_heading') * 1e-3,
        r_lf_G=three('r_lf_G'),
        r_lf_covariance_G=correlation * np.outer(sigma_G, sigma_G),
        sound_speed=one('sound_speed'),
    )


def documentation() -> str:
    """Table of the fields in Markdown."""
    return LAYOUT.documentation()
