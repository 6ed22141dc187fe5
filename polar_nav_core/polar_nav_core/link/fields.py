"""Codec of acoustic packets: one table of fields makes encoder, decoder, documentation and tests.

A packet is a little-endian struct of scaled integers, the version first, CRC-16/CCITT-FALSE last.
Standard deviations are coded on a logarithmic scale and rounded up: what the receiver reads is
never more confident than what the sender said. Times are ticks that wrap, resolved by the time of
reception.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import PolarNavError

TICK_NS = 100_000
"""Resolution of times [ns]."""
WRAP = 1 << 32
"""Ticks after which a time wraps."""
WRAP_NS = WRAP * TICK_NS
_LAST_TIME_NS = ((1 << 31) - 10) * 1_000_000_000
"""What a stamp holds, less the longest travel of a reply [ns]."""
SIGMA_RATIO = 1.06
_SIGMA_FLOOR = 0.005
SIGMA_MOST = _SIGMA_FLOOR * SIGMA_RATIO**254
"""Largest standard deviation that one byte has room for, in the unit of its field."""
ANGLE_STEP = 2 * math.pi / 65536

Kind = Literal['int', 'linear', 'above', 'sigma', 'ticks', 'angle', 'correlation']
"""``linear`` counts resolutions from zero, ``above`` from the lower bound."""


@dataclass(frozen=True)
class Field:
    """One field of a packet: ``count`` values, coded by struct letter ``code``."""

    name: str
    code: str
    kind: Kind
    resolution: float
    lo: float
    hi: float
    unit: str
    doc: str
    count: int = 1


class PacketError(PolarNavError):
    """Bytes that cannot be read; ``damaged`` tells a failed CRC from an unknown format."""

    def __init__(self, message: str, *, damaged: bool) -> None:
        super().__init__(message)
        self.damaged = damaged


class Layout:
    """Bytes of one packet format.

    Parameters
    ----------
    version : int
        The first byte.
    fields : tuple of Field
        In order; the first is the version.
    """

    def __init__(self, version: int, fields: tuple[Field, ...]) -> None:
        self.version = version
        self.fields = fields
        self._struct = struct.Struct('<' + ''.join(f.code * f.count for f in fields))
        self.size = self._struct.size + 2

    def pack(self, content: object, values: Mapping[str, object]) -> bytes:
        """Bytes of a packet's content.

        Parameters
        ----------
        content : object
            Attributes of the fields' names have their values.
        values : mapping of str to number or array
            Values of the other fields, and of those that are not sent as they are.

        Raises
        ------
        ValueError
            For a value outside of its field's range, with the field's name.
        """
        numbers: list[int] = []
        for f in self.fields:
            value = values.get(f.name, getattr(content, f.name, None))
            numbers += [to_integer(f, v.item()) for v in np.atleast_1d(np.asarray(value))]
        body = self._struct.pack(*numbers)
        return body + struct.pack('<H', crc16(body))

    def unpack(self, data: bytes) -> dict[str, list[float]]:
        """Values by field.

        Raises
        ------
        PacketError
            When the CRC does not fit, or the version or the length is not this one.
        """
        if len(data) != self.size:
            raise PacketError(
                f'packet of {len(data)} bytes, version {self.version} has {self.size}',
                damaged=False,
            )
        body, crc = data[:-2], struct.unpack('<H', data[-2:])[0]
        if crc16(body) != crc:
            raise PacketError(
                f'CRC is {crc16(body):#06x}, the packet says {crc:#06x}', damaged=True
            )
        if data[0] != self.version:
            raise PacketError(
                f'packet format {data[0]}, this program reads {self.version}', damaged=False
            )
        numbers = list(self._struct.unpack(body))
        return {
            f.name: [from_integer(f, numbers.pop(0)) for _ in range(f.count)] for f in self.fields
        }

    def changed(self, data: bytes, values: Mapping[str, Sequence[float]]) -> bytes:
        """The same packet with other values in some fields, and the CRC that fits.

        Raises
        ------
        PacketError
            For bytes that are no packet of this layout.
        ValueError
            For a value outside of its field's range, with the field's name.
        """
        self.unpack(data)
        numbers = list(self._struct.unpack(data[:-2]))
        first = 0
        for f in self.fields:
            if f.name in values:
                new = [to_integer(f, v) for v in values[f.name]]
                numbers[first : first + f.count] = new
            first += f.count
        body = self._struct.pack(*numbers)
        return body + struct.pack('<H', crc16(body))

    def documentation(self) -> str:
        """Table of the fields in Markdown."""
        rows = [
            '| field | bytes | resolution | range | unit | meaning |',
            '| --- | --- | --- | --- | --- | --- |',
        ]
        for f in self.fields:
            size = struct.calcsize('<' + f.code) * f.count
            step = {
                'int': '1',
                'sigma': f'+{(SIGMA_RATIO - 1) * 100:.0f} %, up',
                'correlation': '1/127',
            }
            resolution = step.get(f.kind, f'{f.resolution:.3g}')
            rows.append(
                f'| {f.name} | {size} | {resolution} | {f.lo:g} to {f.hi:g} | {f.unit} | {f.doc} |'
            )
        rows.append('| crc | 2 | | | | CRC-16/CCITT-FALSE of all bytes before |')
        return '\n'.join(rows)


def kind_of(data: bytes) -> int:
    """Format of received bytes: 1 from a leader, 2 from a station; whether it fits, unpack says.

    Raises
    ------
    PacketError
        For no bytes at all.
    """
    if not data:
        raise PacketError('packet of 0 bytes', damaged=False)
    return data[0]


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF); 0x29B1 for b'123456789'."""
    return binascii.crc_hqx(data, 0xFFFF)


_Stamp = TypeVar('_Stamp', int, NDArray[np.int64])


def round_tick(stamp_ns: _Stamp) -> _Stamp:
    """Tick nearest to a time [ns], or to each of an array, not wrapped."""
    return (stamp_ns + TICK_NS // 2) // TICK_NS


def unwrap(ticks: int, near_ns: int) -> int:
    """Time nearest to ``near_ns`` that a wrapped tick can mean, and a stamp can hold [ns]."""
    near = round_tick(near_ns)
    delta = (ticks - near) % WRAP
    if delta >= WRAP // 2:
        delta -= WRAP
    time_ns = (near + delta) * TICK_NS
    # At the ends of what a stamp holds a clock is wrong: the receiver knows by how much.
    if time_ns < 0:
        return time_ns + WRAP_NS
    return time_ns - WRAP_NS if time_ns >= _LAST_TIME_NS else time_ns


def rewound(validity_ns: int, near_ns: int) -> int:
    """Time nearest to ``near_ns`` that is whole wraps of packet time off another one [ns]."""
    return validity_ns + (near_ns - validity_ns + WRAP_NS // 2) // WRAP_NS * WRAP_NS


def to_integer(f: Field, value: float) -> int:
    """Integer that stands for a value.

    Raises
    ------
    ValueError
        Outside of the field's range, with its name.
    """
    if f.kind == 'ticks':
        return round_tick(int(value)) % WRAP
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
        return 1 + math.ceil(math.log(value / _SIGMA_FLOOR) / math.log(SIGMA_RATIO) - 1e-9)
    if f.kind == 'correlation':
        return math.trunc(value * 127)
    start = f.lo if f.kind == 'above' else 0.0
    return round((value - start) / f.resolution)


def from_integer(f: Field, number: int) -> float:
    """Value that an integer stands for."""
    if f.kind == 'sigma':
        return 0.0 if number == 0 else _SIGMA_FLOOR * SIGMA_RATIO ** (number - 1)
    if f.kind == 'angle':
        return math.remainder(number * f.resolution, 2 * math.pi)
    if f.kind in ('int', 'ticks'):
        return number
    return number * f.resolution + (f.lo if f.kind == 'above' else 0.0)
