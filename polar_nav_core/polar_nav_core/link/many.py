"""Many packets of a leader read at once, to the bits of `packet.decode`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fields import TICK_NS, WRAP, crc16, from_integer, round_tick
from .packet import FIELDS, SIZE, VERSION


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
    leader_sigma_heading: NDArray[np.float64]
    r_lf_G: NDArray[np.float64]
    r_lf_covariance_G: NDArray[np.float64]


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
        table = np.array([from_integer(f, n) for n in found.tolist()], dtype=np.float64)
        return table[at].reshape(numbers.shape)

    def lengths(name: str) -> NDArray[np.float64]:
        return raw[name] * _BY_NAME[name].resolution

    near = round_tick(received_ns)
    delta = (values('validity') - near) % WRAP
    validity_ns = (near + np.where(delta >= WRAP // 2, delta - WRAP, delta)) * TICK_NS
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
        leader_sigma_heading=values('leader_sigma_heading') * 1e-3,
        r_lf_G=lengths('r_lf_G'),
        r_lf_covariance_G=correlation * (sigma_G[:, :, None] * sigma_G[:, None, :]),
    )
