"""Serialized VehicleTruth: encoded in whole blocks, decoded one by one, without ROS.

polar_nav_msgs/VehicleTruth has one string (the frame) and then only fixed-size numbers, so its CDR
form is a header followed by :data:`FIELDS` doubles. A test compares both directions with rclpy's
own.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .trajectory import NS, TruthBlock

Floats = NDArray[np.float64]

FRAME = 'earth'
FIELDS = {
    'r_e': 3,
    'latitude': 1,
    'longitude': 1,
    'height': 1,
    'depth': 1,
    'altitude': 1,
    'v_g': 3,
    'c_b_g': 9,
    'omega_ib_b': 3,
    'f_b': 3,
    'delta_theta_b': 3,
    'delta_v_b': 3,
    'interval': 1,
    'current_g': 3,
}
"""Doubles of the message after ``sequence``, in order."""
_COUNT = sum(FIELDS.values())
_STARTS = dict(zip(FIELDS, np.cumsum([0, *FIELDS.values()])[:-1].tolist(), strict=True))
_CDR_LE = (0, 1, 0, 0)
_HEADER = 4
_STRING_AT = 12
"""Offset of the frame's characters in the body, behind the stamp and the string's length."""

_RECORD = np.dtype(
    [
        ('cdr', 'u1', 4),
        ('sec', '<i4'),
        ('nanosec', '<u4'),
        ('length', '<u4'),
        ('frame', f'S{len(FRAME) + 1}'),
        ('pad', 'u1', 6),
        ('sequence', '<u8'),
        ('values', '<f8', _COUNT),
    ]
)
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')
_SEQUENCE = struct.Struct('<Q')
_DOUBLE = struct.Struct('<d')


@dataclass(frozen=True)
class TruthSample:
    """One VehicleTruth message.

    Attributes
    ----------
    stamp_ns, sequence : int
        Time [ns], number of the sample.
    values : ndarray, shape (36,)
        The doubles of the message in the order of :data:`FIELDS`.
    """

    stamp_ns: int
    sequence: int
    values: Floats

    def vector(self, name: str) -> Floats:
        """Return a field of several numbers, e.g. ``r_e``; ``c_b_g`` has shape (9,)."""
        start = _STARTS[name]
        return self.values[start : start + FIELDS[name]]

    def number(self, name: str) -> float:
        """Return a field of one number, e.g. ``depth``."""
        return float(self.values[_STARTS[name]])

    @property
    def C_b_G(self) -> Floats:
        """Body to grid, shape (3, 3)."""
        return self.vector('c_b_g').reshape(3, 3)

    @property
    def since_start_ns(self) -> int:
        """Time since sample 0 [ns], from the sample number and the interval."""
        return int(self.sequence * round(self.number('interval') * NS))


def encode(block: TruthBlock) -> list[bytes]:
    """Serialize a block of samples, one VehicleTruth message each."""
    s = block.state
    n = len(block.stamp_ns)
    records = np.zeros(n, dtype=_RECORD)
    records['cdr'] = _CDR_LE
    records['sec'], records['nanosec'] = np.divmod(block.stamp_ns, NS)
    records['length'] = len(FRAME) + 1
    records['frame'] = FRAME.encode()
    records['sequence'] = block.k0 + np.arange(n)
    parts = {
        'r_e': s.r_e,
        'latitude': s.lat,
        'longitude': s.lon,
        'height': s.h,
        'depth': s.depth,
        'altitude': s.altitude,
        'v_g': s.v_G,
        'c_b_g': s.C_b_G.reshape(n, 9),
        'omega_ib_b': s.omega_ib_b,
        'f_b': s.f_b,
        'delta_theta_b': block.delta_theta_b,
        'delta_v_b': block.delta_v_b,
        'interval': block.interval_s,
        'current_g': s.current_G,
    }
    values = records['values']
    for name, part in parts.items():
        values[:, _STARTS[name] : _STARTS[name] + FIELDS[name]] = part.reshape(n, -1)
    whole = records.tobytes()
    size = _RECORD.itemsize
    return [whole[i : i + size] for i in range(0, n * size, size)]


def decode(data: bytes) -> TruthSample:
    """Sample of a serialized VehicleTruth message.

    Raises
    ------
    ValueError
        If the bytes are no such message (too short, or not little-endian CDR).
    """
    at = _sequence_at(data)
    values = np.frombuffer(data, '<f8', _COUNT, at + 8)
    sec, nanosec = _STAMP.unpack_from(data, _HEADER)
    return TruthSample(sec * NS + nanosec, int(_SEQUENCE.unpack_from(data, at)[0]), values)


def since_start_ns(data: bytes) -> int:
    """Time since sample 0 of a serialized VehicleTruth message, the rest left unread [ns]."""
    at = _sequence_at(data)
    interval = float(_DOUBLE.unpack_from(data, at + 8 + 8 * _STARTS['interval'])[0])
    return int(_SEQUENCE.unpack_from(data, at)[0]) * round(interval * NS)


def _sequence_at(data: bytes) -> int:
    if len(data) < _RECORD.itemsize - 8 or data[1] != 1:
        raise ValueError(f'{len(data)} bytes are no little-endian VehicleTruth message')
    end = _STRING_AT + int(_LENGTH.unpack_from(data, _HEADER + 8)[0])
    at = _HEADER + (end + 7) // 8 * 8
    if len(data) < at + 8 + 8 * _COUNT:
        raise ValueError(f'{len(data)} bytes are too few for a VehicleTruth message')
    return at
