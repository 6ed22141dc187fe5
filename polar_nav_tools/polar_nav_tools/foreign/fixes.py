"""Delayed positions of the vehicle: any position topic, acoustic packets, or USBL + leader."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polar_nav_core import usbl
from polar_nav_core.arrays import Array
from polar_nav_core.attitude import exp, log
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.engine.events import Fix
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.link.packet import Broadcast, PacketError, decode
from polar_nav_follower.measurements.fix import fix_from_packet
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters.fixes import (
    fixes_of,
    level_height,
    reception_ns,
    sigma_covariance,
)
from polar_nav_ros.adapters.layouts import PACKET, PACKETS, USBL
from polar_nav_ros.adapters.mapping import FixMapping, Stream
from polar_nav_ros.adapters.messages import Fields, stamp_ns_of
from polar_nav_ros.adapters.packets import carries_packets, packet_of, require_room
from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.rows import places_of
from polar_nav_ros.adapters.sensor_clock import SensorClock

from ..bags.decode import store_of
from ..bags.errors import BagError
from ..bags.reader import Topic
from .read import read_positions
from .sources import Source, Stamps, require

_NS = 1_000_000_000
_LOOKED_AT = 20
"""Messages of a modem among which a packet is looked for."""


@dataclass(frozen=True)
class FixRows:
    """Fixes of one topic.

    ``covariance_e`` (n, 3, 3) and ``r_e`` (n, 3) are as in `Fix`; ``positions`` are the rows they
    came from, None for packets.
    """

    topic: str
    stamps_ns: Stamps
    log_ns: Stamps
    fixes: tuple[Fix, ...]
    positions: PositionRows | None


def read_fixes(
    source: Source,
    mapping: FixMapping,
    first_arrival: int = 0,
    sea_surface_height: float = 0.0,
) -> FixRows:
    """Read a source of fixes.

    Parameters
    ----------
    source : Source
    mapping : FixMapping
    first_arrival : int
        Number of the first fix among those of all sources: places equal stamps in order.
    sea_surface_height : float
        Above the ellipsoid [m], for depths that a transponder told.

    Raises
    ------
    BagError, ConfigError
        As the adapters.
    """
    kind = require(source, mapping.position.stream.topic).type
    packets = carries_packets(mapping.position.stream, kind)
    if mapping.slow_sigma and (packets or kind == USBL):
        raise ConfigError(
            f'{mapping.position.stream.topic}: slow_sigma: fixes of {kind} come with the error '
            'that they share'
        )
    if packets:
        return _packets(source, mapping, kind, first_arrival)
    if kind == USBL:
        return _usbl(source, mapping, first_arrival, sea_surface_height)
    rows = read_positions(source, mapping.position, level_height(mapping, sea_surface_height))
    rows = replace(rows, log_ns=reception_ns(rows.stamps_ns, rows.log_ns))
    fixes = fixes_of(mapping, rows, first_arrival)
    return FixRows(rows.topic, rows.stamps_ns, rows.log_ns, fixes, rows)


def _messages(source: Source, topic: str) -> list[tuple[int, Any]]:
    kind = require(source, topic).type
    store = store_of(source.text(topic), kind)
    out = []
    for log_ns, data in source.records(topic):
        try:
            out.append((log_ns, store.deserialize_cdr(data, kind)))
        except Exception as error:  # bytes from a file can fail in any way
            raise BagError(f'{source.path}: a message on {topic} is no {kind}') from error
    return out


def _ns(time: Any) -> int:  # noqa: ANN401 - builtin_interfaces/Time of any store
    return int(time.sec) * _NS + int(time.nanosec)


def _packets(source: Source, mapping: FixMapping, kind: str, first_arrival: int) -> FixRows:
    """Fixes of packets; what holds no bytes is left out."""
    stream = replace(mapping.position.stream, type=kind)
    mapping = replace(mapping, position=replace(mapping.position, stream=stream))
    require_room(stream, kind, str(source.path))
    params = FollowerParams(leader_id=mapping.leader_id, own_id=mapping.own_id)
    messages = _messages(source, stream.topic)
    places = places_of(stream, 'packet', kind, Fields(messages[0][1]), str(source.path))
    clock = SensorClock() if stream.clock == 'sensor' else None
    fixes, logged = [], []
    for k, (log_ns, m) in enumerate(messages):
        try:
            stamp_ns = stamp_ns_of(m, places.stamp, log_ns)
            if clock is not None:
                stamp_ns = clock.host_ns(stamp_ns, log_ns)
            row = packet_of(m, places.quantities, mapping, stamp_ns + stream.offset_ns, k)
        except (ValueError, TypeError):
            continue
        fix, _ = fix_from_packet(*row[:3], first_arrival + k, *row[3:], params)
        fixes.append(fix)
        logged.append(log_ns)
    stamps = np.array([f.receive_ns for f in fixes], dtype=np.int64)
    return FixRows(stream.topic, stamps, np.array(logged, dtype=np.int64), tuple(fixes), None)


def packets_in(source: Source, topics: list[Topic]) -> dict[Topic, Broadcast]:
    """Topics of modems whose bytes are a leader's packets, with the content of the first one."""
    out = {}
    for topic in topics:
        if topic.type in PACKETS and topic.type != PACKET:
            stream = Stream(topic.name, stamp='log', type=topic.type)
            mapping = FixMapping.of_packets(stream)
            for log_ns, m in _messages(source, topic.name)[:_LOOKED_AT]:
                quantities = places_of(stream, 'packet', topic.type, Fields(m), '').quantities
                try:
                    out[topic] = decode(packet_of(m, quantities, mapping, log_ns, 0).data, log_ns)
                except (ValueError, TypeError, PacketError):
                    continue
                break
    return out


def _usbl(
    source: Source, mapping: FixMapping, first_arrival: int, sea_surface_height: float
) -> FixRows:
    stream = mapping.position.stream
    if mapping.leader is None:
        raise ConfigError(
            f'{stream.topic}: a UsblFix is relative to its array: give `leader` with the topic of '
            "the array vehicle's position and attitude"
        )
    leader = read_positions(source, mapping.leader).sorted()
    if len(leader.stamps_ns) < 2 or not np.isfinite(leader.C_b_G).all():
        raise ConfigError(
            f'{mapping.leader.stream.topic}: a leader needs position and attitude in every message'
        )
    fixes, stamps, logged = [], [], []
    for k, (log_ns, m) in enumerate(_messages(source, stream.topic)):
        validity_ns = _ns(m.header.stamp) + stream.offset_ns
        stamps.append(validity_ns)
        logged.append(log_ns)
        try:
            relative = _transponder(m, leader, mapping, stream.offset_ns, sea_surface_height)
        except (ValueError, np.linalg.LinAlgError):
            relative = None  # numbers that fit no geometry
        if relative is None:
            continue
        covariance = relative.covariance
        if mapping.sigma is not None:
            covariance = sigma_covariance(mapping.sigma, relative.vector[None])[0]
        receive_ns = log_ns if mapping.delay_ns is None else validity_ns + mapping.delay_ns
        fixes.append(
            Fix(
                validity_ns=validity_ns,
                transmit_ns=0,
                receive_ns=receive_ns,
                source=mapping.source,
                sequence=int(m.sequence),
                order=k,
                arrival=first_arrival + k,
                r_e=relative.vector,
                covariance_e=covariance,
                topic=stream.topic,
                delay_sigma=mapping.delay_sigma_s,
            )
        )
    return FixRows(
        stream.topic,
        np.array(stamps, dtype=np.int64),
        np.array(logged, dtype=np.int64),
        tuple(fixes),
        None,
    )


def _transponder(
    m: Any,  # noqa: ANN401 - a UsblFix of any store
    leader: PositionRows,
    mapping: FixMapping,
    offset_ns: int,
    sea_surface_height: float,
) -> usbl.Relative | None:
    """Position of the transponder; None where the leader's at that time is not known."""
    ping_ns, return_ns = _ns(m.ping_time) + offset_ns, _ns(m.return_time) + offset_ns
    known = leader.stamps_ns
    if not known[0] <= return_ns <= known[-1]:
        return None
    k = int(np.clip(np.searchsorted(known, return_ns), 1, len(known) - 1))
    share = (return_ns - int(known[k - 1])) / max(int(known[k] - known[k - 1]), 1)
    r_e = _interpolated(leader, return_ns)
    before = leader.C_b_G[k - 1]
    C_b_G = before @ exp(share * log(before.T @ leader.C_b_G[k]))
    C_a_G = C_b_G @ mapping.C_a_b
    direction = np.array([m.direction.x, m.direction.y, m.direction.z])
    lever_G = C_b_G @ np.asarray(mapping.lever_b)
    moved_e = r_e - _interpolated(leader, ping_ns)
    displacement_a = C_a_G.T @ (ecef_to_grid(r_e) @ moved_e)
    distance = usbl.range_at_reply(m.range, m.range_variance, direction, displacement_a)
    told = np.isfinite(m.target_depth)
    height = 0.0
    if told:
        array_height = float(geodetic_from_ecef(r_e)[2]) + float(lever_G[2])
        height = sea_surface_height - float(m.target_depth) - array_height
    relative_a = usbl.relative_in_array(
        direction,
        np.asarray(m.direction_cosine_covariance).reshape(2, 2),
        distance.distance,
        distance.variance,
        C_a_G[2] if told else None,
        height,
        float(m.target_depth_variance) if told else 0.0,
    )
    relative_G = usbl.relative_in_grid(
        relative_a, mapping.C_a_b, mapping.lever_b, C_b_G, np.zeros((3, 3))
    )
    P_leader = leader.covariance_e[k]
    return usbl.transponder_position(
        r_e, relative_G, P_leader if np.isfinite(P_leader).all() else None
    )


def _interpolated(leader: PositionRows, stamp_ns: int) -> Array:
    t = (leader.stamps_ns - leader.stamps_ns[0]) * 1e-9
    at = (stamp_ns - int(leader.stamps_ns[0])) * 1e-9
    return np.array([np.interp(at, t, leader.r_e[:, i]) for i in range(3)])
