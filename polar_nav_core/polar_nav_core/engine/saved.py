"""A navigation's state as bytes, for a file from which a restarted node goes on.

Bytes are a magic word, the version of the format, a SHA-256, and a body: JSON with names and
shapes, then the numbers (64 bits, little-endian) and the record of fixes. Reading trusts nothing:
whatever is not exactly such a state is refused with a sentence.
"""

from __future__ import annotations

import hashlib
import json
import math
import reprlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from ..arrays import Array
from ..errors import PolarNavError
from .away import Seen
from .events import InitialState
from .health.heading import LostHeading

_MAGIC: Final = b'POLARNAV'
VERSION: Final = 7
"""Of the format of the bytes; older ones are read, too."""
SINCE: Final[dict[int, dict[str, tuple[str, tuple[int, ...]]]]] = {
    2: {'sins 24': ('leader', (20,)), 'station 12': ('loose', (6,))},
    3: {'sins 24': ('wander', (2,))},
    4: {'sins 24': ('used', (2,))},
    6: {'sins 24': ('free', (1,))},
}
"""By format and layout: array that older ones did not have, its shape; zeros: nothing known."""
GROWN: Final[dict[int, dict[str, dict[str, tuple[int, ...]]]]] = {
    3: {'sins 24': {'leader': (27,), 'sensitivity': (24, 16)}},
    5: {'sins 24': {'leader': (28,)}},
    7: {'sins 24': {'leader': (44,)}},
}
"""By format and layout: arrays that were shorter in older ones, their shapes; zeros as above."""
_HEAD: Final = struct.Struct('<8sH32sQ')
_JSON: Final = struct.Struct('<I')
MOST_BYTES: Final = 32 << 20
"""Of a saved state; the fullest one has 6 MiB of fixes."""
_TOO_MANY: Final = 1 << 62
_FARTHEST_M: Final = 1e8
_NONSENSE: Final = (
    KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, struct.error,
)  # fmt: skip
"""What reading a body raises that is none."""


class SavedStateError(PolarNavError, ValueError):
    """Bytes that are no saved state of this program."""


@dataclass(frozen=True)
class SavedState(InitialState):
    """Initial state with all that the filter had estimated, as it was at a stamp.

    Attributes
    ----------
    stamp_ns : int
        Of the newest IMU sample in it.
    layout : str
        Kind of filter that `values` are of.
    values : mapping of str to ndarray
        Arrays of the filter by name.
    fixes : (int, int, int)
        Fixes received, fused, and newest validity of a fused one [ns].
    records : (bytes, bytes)
        Fused and refused fixes, packed.
    version : int
        Of the format of the bytes that it was read from.
    vehicle : str
        Name of the vehicle that it is of; empty where nobody said so, as in older files.
    since_start : int or None
        Fixes fused since the navigation was started or reset; None in older files: all of them.
    lost_heading : (int, bool) or None
        When the navigation began anew with a heading [ns], and whether one was measured since;
        None where it did not, and in older files.
    followed : (float, float, bool) or None
        Way to refused fixes that the estimate has followed [m], grid axes or those of the station,
        and whether they had jumped; None where it has not, and in older files.
    seen : Seen or None
        What its new owner saw of the vehicle before it goes on from it; not part of the bytes.
    """

    stamp_ns: int
    layout: str
    values: Mapping[str, Array]
    fixes: tuple[int, int, int]
    records: tuple[bytes, bytes]
    version: int = VERSION
    vehicle: str = ''
    since_start: int | None = None
    lost_heading: tuple[int, bool] | None = None
    followed: tuple[float, float, bool] | None = None
    seen: Seen | None = None

    def doubt(self) -> LostHeading | None:
        """What a navigation that goes on from it has to doubt of its heading."""
        if self.lost_heading is None:
            return None
        anew_ns, measured = self.lost_heading
        # Of a DVL that was used before, the restored filter knows no more than that.
        return LostHeading(anew_ns, -1 if measured else self.stamp_ns)

    def away_s(self, stamp_ns: int) -> float:
        """Time from the saved state to a stamp [s], at least 0."""
        return max(0.0, (stamp_ns - self.stamp_ns) * 1e-9)


def pack(saved: SavedState) -> bytes:
    """Bytes of a state, for `unpack`."""
    plain = {f.name: getattr(saved, f.name) for f in fields(InitialState)}
    header = {
        'initial': plain,
        'stamp_ns': saved.stamp_ns,
        'layout': saved.layout,
        'vehicle': saved.vehicle,
        'since_start': saved.since_start,
        'lost_heading': saved.lost_heading,
        'followed': saved.followed,
        'fixes': saved.fixes,
        'shapes': {name: list(value.shape) for name, value in saved.values.items()},
        'records': [len(record) for record in saved.records],
    }
    text = json.dumps(header).encode()
    numbers = [np.ascontiguousarray(v, dtype='<f8').tobytes() for v in saved.values.values()]
    body = b''.join([_JSON.pack(len(text)), text, *numbers, *saved.records])
    return _HEAD.pack(_MAGIC, VERSION, hashlib.sha256(body).digest(), len(body)) + body


def unpack(data: bytes) -> SavedState:
    """State of packed bytes.

    Raises
    ------
    SavedStateError
        Saying what is wrong with them.
    """
    if len(data) < _HEAD.size:
        raise SavedStateError(f'{len(data)} bytes are too few for a saved state')
    magic, version, digest, size = _HEAD.unpack_from(data)
    if magic != _MAGIC:
        raise SavedStateError('the bytes are no saved state of polar_nav')
    if not 1 <= version <= VERSION:
        raise SavedStateError(
            f'format {version} of a saved state, this program reads formats up to {VERSION}'
        )
    body = data[_HEAD.size :]
    if len(body) != size or hashlib.sha256(body).digest() != digest:
        raise SavedStateError('the saved state is damaged: its checksum does not fit')
    try:
        return _read(body, version)
    except _NONSENSE as error:
        raise SavedStateError(f'the saved state makes no sense: {error}') from error


def _read(body: bytes, version: int) -> SavedState:
    (length,) = _JSON.unpack_from(body)
    at = _JSON.size + length
    header: dict[str, Any] = json.loads(body[_JSON.size : at])
    values = {}
    for name, shape in header['shapes'].items():
        count = math.prod(int(n) for n in shape)
        values[name] = np.frombuffer(body, '<f8', count, at).reshape(shape).astype(np.float64)
        at += 8 * count
    layout = str(header['layout'])
    for since, added in SINCE.items():
        if version < since and layout in added:
            name, shape = added[layout]
            values[name] = np.zeros(shape)
    for since, grown in GROWN.items():
        for name, shape in grown.get(layout, {}).items() if version < since else ():
            values[name] = _padded(values[name], shape)
    records = []
    for size in header['records']:
        records.append(body[at : at + size])
        at += size
    if at != len(body):
        raise ValueError(f'{len(body) - at} bytes are left over')
    fused, refused = records
    received, used, newest_ns = (_count(n) for n in header['fixes'])
    since_start, lost = header.get('since_start'), header.get('lost_heading')
    followed = header.get('followed')
    plain: dict[str, Any] = dict(header['initial'])
    v_x, v_y, v_z = map(float, plain.pop('v_G'))
    numbers: dict[str, Any] = {name: float(value) for name, value in plain.items()}
    return SavedState(
        v_G=(v_x, v_y, v_z),
        **numbers,
        stamp_ns=int(header['stamp_ns']),
        layout=layout,
        values=values,
        fixes=(received, used, newest_ns),
        records=(fused, refused),
        version=version,
        vehicle=str(header.get('vehicle', '')),
        since_start=None if since_start is None else _count(since_start),
        lost_heading=None if lost is None else _lost(*lost),
        followed=None if followed is None else _followed(*followed),
    )


def _lost(anew_ns: Any, measured: Any) -> tuple[int, bool]:  # noqa: ANN401 - of a file
    return _count(anew_ns), bool(measured)


def _followed(x: Any, y: Any, jumped: Any) -> tuple[float, float, bool]:  # noqa: ANN401 - as above
    way = float(x), float(y)
    if not math.hypot(*way) <= _FARTHEST_M:
        raise ValueError(f'{reprlib.repr(way)} is no way')
    return *way, bool(jumped)


def _count(value: Any) -> int:  # noqa: ANN401 - of a file
    """Number of fixes, or time [ns], that a message can hold."""
    count = int(value)
    if not 0 <= count < _TOO_MANY:
        raise ValueError(f'{reprlib.repr(count)} is no number of fixes')
    return count


def _padded(value: Array, shape: tuple[int, ...]) -> Array:
    """Value with zeros at the end of its last axis; itself if it is none that was shorter."""
    missing = shape[-1] - value.shape[-1] if value.ndim == len(shape) else 0
    if missing <= 0:
        return value
    return np.pad(value, [(0, 0)] * (value.ndim - 1) + [(0, missing)])


def layout_problem(saved: SavedState, layout: str, shapes: Mapping[str, tuple[int, ...]]) -> str:
    """Sentence about a state that a filter of this layout cannot use; empty if it can."""
    if saved.layout != layout:
        return f'the state is of a filter {saved.layout}, this one is {layout}'
    found = {name: value.shape for name, value in saved.values.items()}
    if found != dict(shapes):
        names = sorted(n for n in found.keys() | shapes if found.get(n) != shapes.get(n))
        return f'the state has other shapes of {", ".join(names)} than this filter'
    if not all(np.isfinite(value).all() for value in saved.values.values()):
        return 'the state is not finite'
    return ''
