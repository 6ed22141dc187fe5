"""A leader's packet to a position of the follower's transponder.

Leader and follower have different grid frames, so only earth-frame vectors are added:
p_F(t3) = p_L(t4) + C_G_e(leader) r_lf_G, with the covariances of both.
"""

from __future__ import annotations

import numpy as np

from polar_nav_core import grid, station_packet
from polar_nav_core.engine.events import Array, Fix, Verdict
from polar_nav_core.packet import Broadcast, PacketError, decode

from ..params import FollowerParams

_NO_VECTOR = np.full(3, np.nan)
_NO_COVARIANCE = np.full((3, 3), np.nan)
_EARTH = (6.3e6, 6.4e6)
"""Distances from the Earth's centre at which a leader may be [m]."""
_LAST_STAMP_NS = (1 << 31) * 1_000_000_000


def position_of(b: Broadcast) -> tuple[Array, Array]:
    """Position of the transponder at t3 and its covariance, ECEF, (3,) [m] and (3, 3) [m^2]."""
    C_e_G = grid.ecef_to_grid(b.leader_r_e)
    covariance_G = b.r_lf_covariance_G + np.diag(
        [b.leader_sigma_horizontal**2] * 2 + [b.leader_sigma_vertical**2]
    )
    r_e = b.leader_r_e + np.einsum('ji,j->i', C_e_G, b.r_lf_G)
    covariance_e = np.einsum('ki,kl,lj->ij', C_e_G, covariance_G, C_e_G)
    return r_e, 0.5 * (covariance_e + covariance_e.T)


def fix_from_packet(
    data: bytes,
    source: str,
    order: int,
    arrival: int,
    transmit_ns: int,
    receive_ns: int,
    params: FollowerParams,
) -> tuple[Fix, Broadcast | None]:
    """Read a received packet's bytes; the fix says why when they hold none for this vehicle."""

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
    )
    return fix, b


def _of_a_station(data: bytes) -> str:
    """Say that a packet is a station's; empty when it is not."""
    if len(data) != station_packet.SIZE or data[0] != station_packet.VERSION:
        return ''
    return (
        f'packet format {station_packet.VERSION}, range and bearing from a station: mode sins '
        "takes the position in a leader's packet"
    )
