"""The bytes that a leader sends to a follower, all by one table of fields.

The table makes encoder, decoder, documentation and tests. A packet is a little-endian struct of
scaled integers, version first, CRC-16/CCITT-FALSE last. Positions are ECEF centimetres, so the
pole is an ordinary place. Standard deviations are coded on a logarithmic scale and rounded up:
what the follower reads is never more confident than what the leader said.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import PolarNavError

VERSION = 1
TICK_NS = 100_000
"""Resolution of times [ns]."""
_WRAP = 1 << 32
_SIGMA_FLOOR = 0.005
_SIGMA_RATIO = 1.06

Kind = Literal['int', 'linear', 'above', 'sigma', 'ticks', 'angle', 'correlation']
"""``linear`` counts resolutions from zero, ``above`` from the lower bound."""


@dataclass(frozen=True)
class Field:
    """One field of the packet: ``count`` values, coded by struct letter ``code``."""

    name: str
    code: str
    kind: Kind
    resolution: float
    lo: float
    hi: float
    unit: str
    doc: str
    count: int = 1


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
    Field('validity', 'I', 'ticks', 1e-4, 0, (_WRAP - 1) * 1e-4, 's', 't3, wraps after 4.97 days'),
    Field('reply_travel', 'H', 'linear', 1e-4, 0, 6.5535, 's', 't4 - t3'),
    Field(
        'leader_r_e', 'i', 'linear', 0.01, -2.1e7, 2.1e7, 'm', "leader's base_link at t4, ECEF", 3
    ),
    Field(
        'leader_sigma_horizontal',
        'B',
        'sigma',
        _SIGMA_RATIO,
        0,
        1.4e4,
        'm',
        '1-sigma per horizontal axis',
    ),
    Field('leader_sigma_vertical', 'B', 'sigma', _SIGMA_RATIO, 0, 1.4e4, 'm', '1-sigma'),
    Field(
        'leader_v_G', 'h', 'linear', 0.001, -32.767, 32.767, 'm/s', "leader's grid axes at t4", 3
    ),
    Field(
        'leader_sigma_velocity', 'B', 'sigma', _SIGMA_RATIO, 0, 1.4e4, 'm/s', '1-sigma per axis'
    ),
    Field(
        'leader_grid_heading',
        'H',
        'angle',
        2 * math.pi / 65536,
        -math.pi,
        math.pi,
        'rad',
        'at t4, clockwise from grid north',
    ),
    Field('leader_sigma_heading', 'B', 'sigma', _SIGMA_RATIO, 0, 1.4e4, 'mrad', '1-sigma'),
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
    Field('r_lf_sigma_G', 'B', 'sigma', _SIGMA_RATIO, 0, 1.4e4, 'm', '1-sigma of r_lf_G', 3),
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
_LAYOUT = struct.Struct('<' + ''.join(f.code * f.count for f in FIELDS))
_BY_NAME = {f.name: f for f in FIELDS}
_ROW = np.dtype(
    [
        *(
            (f.name, f'<{f.code}', f.count) if f.count > 1 else (f.name, f'<{f.code}')
            for f in FIELDS
        ),
        ('crc', '<u2'),
    ]
)
_Stamp = TypeVar('_Stamp', int, NDArray[np.int64])
SIZE = _LAYOUT.size + 2
"""Bytes of a packet, CRC included."""


class PacketError(PolarNavError):
    """Bytes that cannot be read; ``damaged`` tells a failed CRC from an unknown format."""

    def __init__(self, message: str, *, damaged: bool) -> None:
        super().__init__(message)
        self.damaged = damaged


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


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF); 0x29B1 for b'123456789'."""
    return binascii.crc_hqx(data, 0xFFFF)


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
        'reply_travel': (b.return_ns - _round_tick(b.validity_ns) * TICK_NS) * 1e-9,
        'leader_sigma_heading': b.leader_sigma_heading * 1e3,
        'r_lf_sigma_G': sigma_G,
        'r_lf_correlation': np.array([correlation[0, 1], correlation[0, 2], correlation[1, 2]]),
    }
    numbers: list[int] = []
    for f in FIELDS:
        value = values.get(f.name, getattr(b, f.name, None))
        for v in np.atleast_1d(np.asarray(value)):
            numbers.append(_to_integer(f, v.item()))
    body = _LAYOUT.pack(*numbers)
    return body + struct.pack('<H', crc16(body))


def decode(data: bytes, received_ns: int) -> Broadcast:
    """Content of received bytes.

    Parameters
    ----------
    data : bytes
        The packet.
    received_ns : int
        When it was received; resolves the wrapped time of validity to the nearest possible one.

    Raises
    ------
    PacketError
        When the CRC does not fit, or the version or the length is not one we know.
    """
    if len(data) != SIZE:
        raise PacketError(
            f'packet of {len(data)} bytes, version {VERSION} has {SIZE}', damaged=False
        )
    body, crc = data[:-2], struct.unpack('<H', data[-2:])[0]
    if crc16(body) != crc:
        raise PacketError(f'CRC is {crc16(body):#06x}, the packet says {crc:#06x}', damaged=True)
    if data[0] != VERSION:
        raise PacketError(f'packet format {data[0]}, this program reads {VERSION}', damaged=False)
    numbers = list(_LAYOUT.unpack(body))
    raw: dict[str, list[float]] = {}
    for f in FIELDS:
        raw[f.name] = [_from_integer(f, numbers.pop(0)) for _ in range(f.count)]

    def one(name: str) -> float:
        return raw[name][0]

    def three(name: str) -> NDArray[np.float64]:
        return np.array(raw[name], dtype=np.float64)

    validity_ns = _unwrap(int(one('validity')), received_ns)
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


@dataclass(frozen=True)
class Broadcasts:
    """What a follower needs of n packets, a row each; names and units as in `Broadcast`."""

    source: NDArray[np.int64]
    target: NDArray[np.int64]
    sequence: NDArray[np.int64]
    validity_ns: NDArray[np.int64]
    return_ns: NDArray[np.int64]
    leader_r_e: NDArray[np.float64]
    leader_sigma_horizontal: NDArray[np.float64]
    leader_sigma_vertical: NDArray[np.float64]
    leader_grid_heading: NDArray[np.float64]
    r_lf_G: NDArray[np.float64]
    r_lf_covariance_G: NDArray[np.float64]


def is_readable(data: bytes) -> bool:
    """Whether `decode` would read these bytes."""
    return (
        len(data) == SIZE
        and data[0] == VERSION
        and crc16(data[:-2]) == int.from_bytes(data[-2:], 'little')
    )


def decode_many(packets: Sequence[bytes], received_ns: NDArray[np.int64]) -> Broadcasts:
    """`decode` of many readable packets at once, to the same bits."""
    raw = np.frombuffer(b''.join(packets), dtype=_ROW)

    def values(name: str) -> NDArray[Any]:
        f, numbers = _BY_NAME[name], raw[name]
        if f.kind in ('int', 'ticks'):
            return numbers.astype(np.int64)
        # Powers and remainders number by number: NumPy's differ in the last bit.
        found, at = np.unique(numbers, return_inverse=True)
        table = np.array([_from_integer(f, n) for n in found.tolist()], dtype=np.float64)
        return table[at].reshape(numbers.shape)

    def lengths(name: str) -> NDArray[np.float64]:
        return raw[name] * _BY_NAME[name].resolution

    near = _round_tick(received_ns)
    delta = (values('validity') - near) % _WRAP
    validity_ns = (near + np.where(delta >= _WRAP // 2, delta - _WRAP, delta)) * TICK_NS
    travel_ns = np.rint(lengths('reply_travel') * 1e9).astype(np.int64)
    sigma_G, (xy, xz, yz) = values('r_lf_sigma_G'), values('r_lf_correlation').T
    correlation = np.ones((len(raw), 3, 3))
    for (i, j), column in (((0, 1), xy), ((0, 2), xz), ((1, 2), yz)):
        correlation[:, i, j] = correlation[:, j, i] = column
    return Broadcasts(
        source=values('source'),
        target=values('target'),
        sequence=values('sequence'),
        validity_ns=validity_ns,
        return_ns=validity_ns + travel_ns,
        leader_r_e=lengths('leader_r_e'),
        leader_sigma_horizontal=values('leader_sigma_horizontal'),
        leader_sigma_vertical=values('leader_sigma_vertical'),
        leader_grid_heading=values('leader_grid_heading'),
        r_lf_G=lengths('r_lf_G'),
        r_lf_covariance_G=correlation * (sigma_G[:, :, None] * sigma_G[:, None, :]),
    )


def documentation() -> str:
    """Table of the fields in Markdown."""
    rows = [
        '| field | bytes | resolution | range | unit | meaning |',
        '| --- | --- | --- | --- | --- | --- |',
    ]
    for f in FIELDS:
        size = struct.calcsize('<' + f.code) * f.count
        step = {
            'int': '1',
            'sigma': f'+{(_SIGMA_RATIO - 1) * 100:.0f} %, up',
            'correlation': '1/127',
        }
        resolution = step.get(f.kind, f'{f.resolution:.3g}')
        rows.append(
            f'| {f.name} | {size} | {resolution} | {f.lo:g} to {f.hi:g} | {f.unit} | {f.doc} |'
        )
    rows.append('| crc | 2 | | | | CRC-16/CCITT-FALSE of all bytes before |')
    return '\n'.join(rows)


def _round_tick(stamp_ns: _Stamp) -> _Stamp:
    return (stamp_ns + TICK_NS // 2) // TICK_NS


def _unwrap(ticks: int, near_ns: int) -> int:
    near = _round_tick(near_ns)
    delta = (ticks - near) % _WRAP
    if delta >= _WRAP // 2:
        delta -= _WRAP
    return (near + delta) * TICK_NS


def _to_integer(f: Field, value: float) -> int:
    if f.kind == 'ticks':
        return _round_tick(int(value)) % _WRAP
    if not math.isfinite(value):
        raise ValueError(f'{f.name}: {value} is not finite')
    if f.kind == 'angle':
        return round(math.remainder(value, 2 * math.pi) / f.resolution) % 65536
    if not f.lo <= value <= f.hi:
        raise ValueError(f'{f.name}: {value} is outside of [{f.lo}, {f.hi}] {f.unit}')
    if f.kind == 'sigma':
        if value <= 0.0:
            return 0
        if value <= _SIGMA_FLOOR:
            return 1
        # A decoded value lies on the scale but for rounding: the last term keeps it where it is.
        return 1 + math.ceil(math.log(value / _SIGMA_FLOOR) / math.log(_SIGMA_RATIO) - 1e-9)
    if f.kind == 'correlation':
        return math.trunc(value * 127)
    start = f.lo if f.kind == 'above' else 0.0
    return round((value - start) / f.resolution)


def _from_integer(f: Field, number: int) -> float:
    if f.kind == 'sigma':
        return 0.0 if number == 0 else _SIGMA_FLOOR * _SIGMA_RATIO ** (number - 1)
    if f.kind == 'angle':
        return math.remainder(number * f.resolution, 2 * math.pi)
    if f.kind in ('int', 'ticks'):
        return number
    return number * f.resolution + (f.lo if f.kind == 'above' else 0.0)
