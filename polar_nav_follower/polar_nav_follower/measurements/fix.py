"""Position of the follower's transponder from a leader's packet.

Leader and follower have different grid frames, so only earth-frame vectors are added:
p_F(t3) = p_L(t4) + C_G_e(leader) r_lf_G, with the covariances of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import grid
from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.link import station_packet
from polar_nav_core.link.many import Broadcasts, decode_many, is_readable
from polar_nav_core.link.packet import Broadcast, PacketError, decode

from ..params import FollowerParams

_NO_VECTOR = np.full(3, np.nan)
_NO_COVARIANCE = np.full((3, 3), np.nan)
_EARTH = (6.3e6, 6.4e6)
"""Range of a leader's distance from the Earth's centre [m]."""
_AT_ONCE = 4096
"""Packets that are read at once: the numbers of a day are not held besides its fixes."""
_LAST_STAMP_NS = (1 << 31) * 1_000_000_000


def position_of(b: Broadcast) -> tuple[Array, Array]:
    """Position of the transponder at t3 and its covariance, ECEF, (3,) [m] and (3, 3) [m^2]."""
    r_e, covariance_e = _positions(
        b.leader_r_e[None],
        np.array([b.leader_sigma_horizontal]),
        np.array([b.leader_sigma_vertical]),
        b.r_lf_G[None],
        b.r_lf_covariance_G[None],
    )
    return r_e[0], covariance_e[0]


def _positions(
    leader_r_e: Array, horizontal: Array, vertical: Array, r_lf_G: Array, covariance_G: Array
) -> tuple[Array, Array]:
    """Positions and covariances, ECEF, (n, 3) and (n, 3, 3).

    Sums are written out, so that a row does not depend on how many there are.
    """
    C_e_G = np.asarray(grid.ecef_to_grid(leader_r_e))
    covariance_G = covariance_G.copy()
    for axis, sigma in enumerate((horizontal, horizontal, vertical)):
        covariance_G[:, axis, axis] += sigma * sigma
    x, y, z = (C_e_G[:, axis] for axis in range(3))
    r_e = leader_r_e + (x * r_lf_G[:, 0:1] + y * r_lf_G[:, 1:2] + z * r_lf_G[:, 2:3])
    half = (
        covariance_G[:, :, 0, None] * x[:, None]
        + covariance_G[:, :, 1, None] * y[:, None]
        + covariance_G[:, :, 2, None] * z[:, None]
    )
    covariance_e = (
        x[:, :, None] * half[:, None, 0]
        + y[:, :, None] * half[:, None, 1]
        + z[:, :, None] * half[:, None, 2]
    )
    symmetric = 0.5 * (covariance_e + covariance_e.transpose(0, 2, 1))
    return r_e, np.ascontiguousarray(symmetric)


def fix_from_packet(
    data: bytes,
    source: str,
    order: int,
    arrival: int,
    transmit_ns: int,
    receive_ns: int,
    params: FollowerParams,
) -> tuple[Fix, Broadcast | None]:
    """Fix and content of a received packet; a fix without a position holds the reason."""

    def refused(
        verdict: Verdict, reason: str, b: Broadcast | None = None
    ) -> tuple[Fix, Broadcast | None]:
        fix = Fix(
            validity_ns=b.validity_ns if b else 0,
            transmit_ns=transmit_ns,
            receive_ns=receive_ns,
            source=source,
            sequence=b.sequence if b else order,
            order=order,
            arrival=arrival,
            r_e=_NO_VECTOR,
            covariance_e=_NO_COVARIANCE,
            refusal=verdict,
            reason=reason,
        )
        return fix, b

    try:
        b = decode(data, receive_ns)
    except PacketError as error:
        if error.damaged:
            return refused(Verdict.BAD_CRC, str(error))
        return refused(Verdict.BAD_FORMAT, _of_a_station(data) or str(error))
    if not (0 <= b.validity_ns <= b.return_ns < _LAST_STAMP_NS):
        return refused(Verdict.NOT_FINITE, 'its times are none that a stamp can hold')
    distance = float(np.linalg.norm(b.leader_r_e))
    if not _EARTH[0] < distance < _EARTH[1]:
        return refused(Verdict.NOT_FINITE, f'the leader is {distance:.0f} m from the centre')
    if b.source != params.leader_id:
        return refused(
            Verdict.UNKNOWN_SOURCE,
            f'sent by vehicle {b.source}, the leader is {params.leader_id}',
            b,
        )
    if b.target != params.own_id:
        return refused(
            Verdict.UNKNOWN_SOURCE, f'meant for vehicle {b.target}, this is {params.own_id}', b
        )
    try:
        r_e, covariance_e = position_of(b)
    except ValueError as error:  # grid axes are undefined at two places on the equator
        return refused(Verdict.NOT_FINITE, str(error))
    fix = Fix(
        validity_ns=b.validity_ns,
        transmit_ns=transmit_ns,
        receive_ns=receive_ns,
        source=source,
        sequence=b.sequence,
        order=order,
        arrival=arrival,
        r_e=r_e,
        covariance_e=covariance_e,
        array_heading=b.leader_grid_heading,
        relative_e=r_e - b.leader_r_e,
        leader_sigma=b.leader_sigma_horizontal,
        leader_heading_sigma=b.leader_sigma_heading,
    )
    return fix, b


class Packet(NamedTuple):
    """Fields of one AcousticPacket that the follower uses."""

    data: bytes
    source: str
    sequence: int
    transmit_ns: int
    receive_ns: int


def fixes_from_packets(packets: Sequence[Packet], params: FollowerParams) -> list[Fix]:
    """Fixes of many packets, numbered in order, equal to `fix_from_packet` to the bit.

    Those that hold a position for this vehicle are read many at once, the others one by one.
    """
    return [
        fix
        for first in range(0, len(packets), _AT_ONCE)
        for fix in _fixes_from(packets, range(first, min(first + _AT_ONCE, len(packets))), params)
    ]


def _fixes_from(packets: Sequence[Packet], some: range, params: FollowerParams) -> list[Fix]:
    """Fixes of some of the packets, by number."""
    fixes: dict[int, Fix] = {}
    numbers = [n for n in some if is_readable(packets[n].data)]
    if numbers:
        received_ns = np.array([packets[n].receive_ns for n in numbers], dtype=np.int64)
        b = decode_many([packets[n].data for n in numbers], received_ns)
        distance = np.sqrt(np.sum(b.leader_r_e**2, axis=1))
        plain = (
            (b.source == params.leader_id)
            & (b.target == params.own_id)
            & (b.validity_ns >= 0)
            & (b.return_ns < _LAST_STAMP_NS)
            & (distance > _EARTH[0] + 1.0)
            & (distance < _EARTH[1] - 1.0)
        )
        fixes = _plain_fixes(packets, np.array(numbers), b, np.flatnonzero(plain))
    return [
        fixes[n] if n in fixes else fix_from_packet(*p[:3], n, *p[3:], params)[0]
        for n, p in ((n, packets[n]) for n in some)
    ]


def _plain_fixes(
    packets: Sequence[Packet], numbers: NDArray[np.int64], b: Broadcasts, rows: NDArray[np.intp]
) -> dict[int, Fix]:
    """Fixes of some rows of ``b`` by packet number; empty if a place has no grid axes."""
    try:
        r_e, covariance_e = _positions(
            b.leader_r_e[rows],
            b.leader_sigma_horizontal[rows],
            b.leader_sigma_vertical[rows],
            b.r_lf_G[rows],
            b.r_lf_covariance_G[rows],
        )
    except ValueError:
        return {}
    columns = (
        numbers[rows].tolist(),
        b.validity_ns[rows].tolist(),
        b.sequence[rows].tolist(),
        r_e,
        covariance_e,
        b.leader_grid_heading[rows].tolist(),
        r_e - b.leader_r_e[rows],
        b.leader_sigma_horizontal[rows].tolist(),
        b.leader_sigma_heading[rows].tolist(),
    )
    return {
        n: Fix(
            validity_ns=validity_ns,
            transmit_ns=packets[n].transmit_ns,
            receive_ns=packets[n].receive_ns,
            source=packets[n].source,
            sequence=sequence,
            order=packets[n].sequence,
            arrival=n,
            r_e=position,
            covariance_e=covariance,
            array_heading=heading,
            relative_e=relative,
            leader_sigma=sigma,
            leader_heading_sigma=heading_sigma,
        )
        for (
            n,
            validity_ns,
            sequence,
            position,
            covariance,
            heading,
            relative,
            sigma,
            heading_sigma,
        ) in zip(*columns, strict=True)
    }


def _of_a_station(data: bytes) -> str:
    """Sentence if a packet is a station's; empty if it is not."""
    if len(data) != station_packet.SIZE or data[0] != station_packet.VERSION:
        return ''
    return (
        f'packet format {station_packet.VERSION}, range and bearing from a station: mode sins '
        "takes the position in a leader's packet"
    )
