"""A run in station mode as arrays, and its replay: the fast way, as `arrays` has it.

What is odd is left to `recorded`: messages that were refused because they came too late,
streams whose stamps run backwards, commands that start anew, forces that are not finite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import nav_columns
from polar_nav_core.engine import run as batch
from polar_nav_core.engine.events import (
    Array,
    Command,
    CommandKind,
    Fix,
    Identification,
    ModelEstimate,
)
from polar_nav_core.engine.inputs import Stamps, StationInputs
from polar_nav_core.error_model import X
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.measurements.fix import Packet
from polar_nav_follower.measurements.station_fix import StationNumbers, station_fix_from_packet
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_ros import topics
from polar_nav_ros.readers import attitudes, command_from_msg, depth_variances
from polar_nav_ros.stamps import NS

from ..bags import arrays
from ..bags.columns import Columns
from ..bags.decode import is_installed
from ..bags.errors import BagError
from ..bags.reader import Bag
from ..bags.request import Request
from ..bags.tables import read_tables
from ..series.estimates import EstimateRows, receipts_of
from ..series.model import Identified, ModelRun, ModelSeries, identified_of_engine
from ..series.vehicle import Floats, TruthSeries
from .arrays import Progress, packets_of, refusals_of, request_of
from .recorded import choose_follower, decoded
from .result import ReplayedRun

_STAMP = arrays.STAMP[0]
_OMEGA = tuple(f'angular_velocity.{axis}' for axis in 'xyz')
_F = tuple(f'linear_acceleration.{axis}' for axis in 'xyz')
_Q = tuple(f'orientation.{axis}' for axis in 'xyzw')
_FORCE = tuple(f'wrench.force.{axis}' for axis in 'xyz')
_TORQUE = tuple(f'wrench.torque.{axis}' for axis in 'xyz')
_FIELDS: dict[str, tuple[str | tuple[str, ...], ...]] = {
    topics.AHRS: (arrays.STAMP, _OMEGA, _F, _Q, 'orientation_covariance'),
    topics.CONTROL: (arrays.STAMP, _FORCE, _TORQUE),
    topics.DEPTH: (arrays.STAMP, 'depth', 'variance'),
}
_ROWS = 512


@dataclass(frozen=True)
class StationArrays:
    """One follower's part of a bag in station mode; names as in `arrays`."""

    bag: Bag
    vehicle: str
    params: Mapping[str, Any]
    columns: Mapping[str, Columns]
    packets: list[Packet]
    commands: list[Command]
    truth: TruthSeries | None = None

    @property
    def taken(self) -> dict[str, int]:
        """Messages taken per full topic name."""
        counts = {topic: len(columns[_STAMP]) for topic, columns in self.columns.items()}
        counts |= {topics.RX: len(self.packets), topics.COMMAND: len(self.commands)}
        return {f'/{self.vehicle}/{topic}': count for topic, count in counts.items() if count}

    def inputs(self, params: FollowerParams) -> StationInputs:
        """What the engine takes with these parameters."""
        imu, control, depth = (self.columns[topic] for topic in _FIELDS)
        return StationInputs(
            imu_stamps_ns=imu[_STAMP],
            omega_ib_b=imu[_OMEGA[0]],
            C_b_G=attitudes(imu[_Q[0]], imu['orientation_covariance'][:, 0]),
            control_stamps_ns=control[_STAMP],
            force_b=control[_FORCE[0]],
            depth_stamps_ns=depth[_STAMP],
            depth=depth['depth'],
            depth_variance=depth_variances(depth['variance'], params.depth_sigma),
            fixes=tuple(self._fixes(params)),
        )

    def _fixes(self, params: FollowerParams) -> list[Fix]:
        numbers = StationNumbers()
        return [
            station_fix_from_packet(*packet[:3], number, *packet[3:], params, numbers)[0]
            for number, packet in enumerate(self.packets)
        ]


def replay_station(source: StationArrays, params: FollowerParams) -> ReplayedRun:
    """Run a bag's messages through the engine."""
    result = batch.run(params, source.inputs(params), commands=source.commands)
    track = result.track
    rows = EstimateRows(params, len(track.stamps_ns))
    for start in range(0, len(track.stamps_ns), _ROWS):
        rows.take(_as_estimates(track, slice(start, start + _ROWS)))  # type: ignore[arg-type]
    return ReplayedRun(
        vehicle=source.vehicle,
        params=params,
        taken=source.taken,
        estimates=rows.series(source.vehicle),
        receipts=receipts_of(result.receipts),
        verdicts={v.name: n for v, n in sorted(result.verdicts.items()) if n},
        divergence=result.divergence,
        model=_model(track, result.identifications, params),
    )


class _Rows(NamedTuple):
    """Rows as `EstimateRows` takes them; what this mode has no estimate of is NaN."""

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    sensor_errors: Array
    local_statistics: Array
    fixes: Stamps
    told: Array = np.zeros((0, nav_columns.WIDTH))


def _as_estimates(track: batch.StationTrack, part: slice) -> _Rows:
    own = track.P[part]
    P = np.full((len(own), X.size, X.size), np.nan)
    P[:, : own.shape[1], : own.shape[2]] = own
    return _Rows(
        track.stamps_ns[part],
        track.r_e[part],
        track.v_G[part],
        track.C_b_G[part],
        P,
        np.full((len(own), 15), np.nan),
        track.local_statistics[part],
        track.fixes[part],
    )


def _model(
    track: batch.StationTrack, identifications: tuple[Identification, ...], params: FollowerParams
) -> ModelRun | None:
    """The first row of each second, as a session publishes it."""
    seconds = track.stamps_ns // NS
    if not len(seconds):
        return None
    first = np.flatnonzero(np.r_[True, seconds[1:] != seconds[:-1]])
    told = [track.model(int(k), params) for k in first]
    found: tuple[Identified, ...] = tuple(identified_of_engine(i) for i in identifications)
    return ModelRun(_series(track.stamps_ns[first], told), found)


def _series(stamp_ns: NDArray[np.int64], told: list[ModelEstimate]) -> ModelSeries:
    def column(name: str) -> Floats:
        return np.array([getattr(one, name) for one in told], dtype=np.float64)

    return ModelSeries(
        stamp_ns=stamp_ns,
        v_r_b=column('v_r_b'),
        P_v_r_b=column('v_r_covariance_b'),
        current_G=column('current_G'),
        P_current_G=column('current_covariance_G'),
        drag_linear=column('drag_linear'),
        drag_linear_sigma=column('drag_linear_sigma'),
        drag_quadratic=column('drag_quadratic'),
        drag_quadratic_sigma=column('drag_quadratic_sigma'),
        drag_correlation=column('drag_correlation'),
        heading_bias=column('heading_bias'),
        heading_bias_sigma=column('heading_bias_sigma'),
        current_walk=column('current_walk'),
    )


def station_request(
    bag: Bag, vehicle: str | None = None, *, truth: bool = False
) -> Request | None:
    """Say what `load_station` is going to read; None for a run to be taken by message.

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, params = choose_follower(bag, vehicle)
    if not session.in_station_mode(from_mapping(FollowerParams, params)):
        return None
    bag.require([f'/{name}/{topics.AHRS}'])
    taken = (*_FIELDS, topics.RX, topics.COMMAND, topics.RECEIPT)
    present = [f'/{name}/{topic}' for topic in taken if f'/{name}/{topic}' in bag.topics]
    if not all(is_installed(bag.channel(topic)) for topic in present):
        return None
    return request_of(bag, name, _FIELDS, truth=truth)


def load_station(
    bag: Bag, vehicle: str | None = None, *, truth: bool = False, progress: Progress | None = None
) -> StationArrays | None:
    """Read what a follower in station mode took; None for a run to be taken by message.

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, params = choose_follower(bag, vehicle)
    request = station_request(bag, vehicle, truth=truth)
    if request is None:
        return None
    packet, command, receipt = request.raw
    try:
        tables = read_tables(bag, *request, progress=progress)
        commands = [decoded(bag, command, d, CommandMsg) for d in tables.payloads[command]]
        packets = packets_of(bag, packet, tables.payloads[packet])
        refused = refusals_of(bag, receipt, tables.payloads[receipt])
    except BagError:
        return None  # decoding by message says what is wrong, or does not need it
    asked = [c for c in commands if c.kind != CommandKind.SHUTDOWN]
    ends = [c for c in commands if c.kind == CommandKind.SHUTDOWN]
    limits: dict[str, int] = {}
    if ends:
        limits = dict(zip(ends[-1].taken_topics, map(int, ends[-1].taken_counts), strict=True))
    full = {topic: f'/{name}/{topic}' for topic in _FIELDS}
    if refused or any(t not in tables.columns for t in full.values()):
        return None
    if any(c.kind != CommandKind.IDENTIFY for c in asked):
        return None
    columns = {
        topic: {n: c[: limits.get(t)] for n, c in tables.columns[t].items()}
        for topic, t in full.items()
    }
    if not all(_plain(c) for c in columns.values()):
        return None
    found = tables.columns.get(f'/{name}/{topics.TRUTH}')
    return StationArrays(
        bag=bag,
        vehicle=name,
        params=params,
        columns=columns,
        packets=packets[: limits.get(packet)],
        commands=[command_from_msg(c, k) for k, c in enumerate(asked)],
        truth=None if found is None else arrays.truth_of(found, name),
    )


def _plain(columns: Columns) -> bool:
    """Whether stamps are in order, and what the arrays do not carry on is finite."""
    stamps_ns = columns[_STAMP]
    dropped = [columns[n] for n in (_F[0], _TORQUE[0]) if n in columns]
    return bool(np.all(stamps_ns[1:] >= stamps_ns[:-1])) and all(
        bool(np.isfinite(c).all()) for c in dropped
    )


__all__ = [
    'StationArrays',
    'load_station',
    'replay_station',
]
