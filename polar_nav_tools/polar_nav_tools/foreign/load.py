"""A foreign bag and its mapping to the engine's inputs; nothing severe passes unnoticed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import default_of, from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters.arrays import unfilled
from polar_nav_ros.adapters.headings import HeadingRows
from polar_nav_ros.adapters.mapping import Mapping, PositionMapping, Stream
from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.sensors import DepthRows, DvlRows, ImuRows

from ..bags.finding import Finding, Severity
from ..series.vehicle import TruthSeries
from .aligned import align, must_align
from .check_imu import check_imu
from .check_path import check_path
from .check_stamps import Times, check_spans, check_stamps
from .check_values import check_depth, check_dvl, check_fixes, check_positions
from .findings import NAMES, Refused, finding, refusals
from .fixes import FixRows, read_fixes
from .initial import Start, find_start
from .read import read_depth, read_dvl, read_headings, read_imu, read_positions
from .reference import truth_of
from .sources import Source

_T = TypeVar('_T', ImuRows, DvlRows, DepthRows, HeadingRows)
_DVL_NOISE = ('dvl_scale_sigma', 'dvl_markov_sigma')
_NOISE = ('gyro_bias_sigma', 'gyro_noise_density', 'accel_bias_sigma', 'accel_noise_density')


@dataclass(frozen=True)
class Loaded:
    """Everything for a run.

    Attributes
    ----------
    source, mapping : Source, Mapping
    params : FollowerParams
        With the initial state; lever arms and state are those of base_link.
    inputs : Inputs
        What the engine takes.
    truth : TruthSeries or None
    findings : tuple of Finding
    start : Start
    """

    source: Source
    mapping: Mapping
    params: FollowerParams
    inputs: Inputs
    truth: TruthSeries | None
    findings: tuple[Finding, ...]
    start: Start


@dataclass(frozen=True)
class _Streams:
    imu: ImuRows
    dvls: tuple[DvlRows, ...]
    depths: tuple[DepthRows, ...]
    fixes: tuple[FixRows, ...]
    initial: PositionRows | None
    truth: PositionRows | None
    heading: HeadingRows | None = None

    @property
    def dvl(self) -> DvlRows | None:
        """The only ones, or those of all after `_in_order`."""
        return self.dvls[0] if self.dvls else None

    @property
    def depth(self) -> DepthRows | None:
        """The only ones, or those of all after `_in_order`."""
        return self.depths[0] if self.depths else None


def load(source: Source, mapping: Mapping, accept: Iterable[str] = ()) -> Loaded:
    """Read, check and convert a bag.

    Parameters
    ----------
    source : Source
    mapping : Mapping
    accept : iterable of str
        Names of severe findings to take as they are, beside those that the mapping accepts.

    Raises
    ------
    Refused
        For a severe finding that was not accepted, before anything is integrated.
    BagError, ConfigError
        As reading and the parameters.
    """
    accepted = {*accept, *mapping.accept}
    for name in sorted(accepted - set(NAMES)):
        raise ConfigError(f'{name!r} is no finding; there are {", ".join(NAMES)}')
    streams = _read(source, mapping)
    with np.errstate(over='ignore', invalid='ignore'):  # numbers of any size are looked at
        findings = [*check(streams, mapping), *_unstated(mapping)]
    _refuse(source, findings, accepted)
    ordered = _in_order(streams)
    if ordered.truth is not None and ordered.dvl is not None:
        findings += check_path(ordered.truth, ordered.dvl)
        _refuse(source, findings, accepted)
    stated = dict(mapping.params)
    aligned = must_align(mapping)
    if aligned:
        start = align(mapping, _inputs(ordered, int(ordered.imu.stamps_ns[0]), None))
    else:
        start = find_start(
            mapping.initial,
            mapping.place,
            stated,
            ordered.imu,
            ordered.dvl,
            ordered.initial,
            dvl_from_imu_b=_dvl_from_imu(mapping),
        )
    findings += start.findings
    _refuse(source, findings, accepted)
    for fix in mapping.fixes:
        stated.setdefault('leader_id', fix.leader_id)
        stated.setdefault('own_id', fix.own_id)
    # What is stated of the start wins; an alignment has heeded it already, each with its sigma.
    values = {**stated, **start.values} if aligned else {**start.values, **stated}
    return Loaded(
        source=source,
        mapping=mapping,
        params=from_mapping(FollowerParams, values),
        inputs=_inputs(ordered, start.stamp_ns, mapping.initial.position),
        truth=truth_of(ordered.truth, mapping.vehicle),
        findings=tuple(findings),
        start=start,
    )


def _dvl_from_imu(mapping: Mapping) -> Array:
    """DVL from the IMU, body axes [m]."""
    stated = mapping.params.get('dvl_lever_b', default_of(EngineParams, 'dvl_lever_b'))
    from_base = np.asarray(stated, dtype=np.float64)
    return np.asarray(from_base - np.asarray(mapping.imu.lever_b))


def _refuse(source: Source, findings: Sequence[Finding], accepted: set[str]) -> None:
    refused = refusals(findings, accepted)
    if refused:
        raise Refused(source.path, refused)


def _read(source: Source, mapping: Mapping) -> _Streams:
    params = mapping.params

    def number(name: str) -> float:
        return float(params.get(name, default_of(EngineParams, name)))

    fixes: list[FixRows] = []
    for one in mapping.fixes:
        taken = sum(len(f.stamps_ns) for f in fixes)
        fixes.append(read_fixes(source, one, taken, number('sea_surface_height')))
    initial = mapping.initial.position
    where = None if initial is None else read_positions(source, initial)
    latitude_deg = float(params.get('initial_latitude_deg', 90.0))
    if 'initial_latitude_deg' not in params:
        latitude_deg = _latitude_deg(where, fixes, latitude_deg)
    return _Streams(
        imu=read_imu(source, mapping.imu),
        dvls=tuple(
            read_dvl(source, dvl, number('dvl_sigma'), number('water_sound_speed'))
            for dvl in mapping.dvls
        ),
        depths=tuple(
            read_depth(source, depth, number('depth_sigma'), latitude_deg)
            for depth in mapping.depths
        ),
        fixes=tuple(fixes),
        initial=where,
        truth=_truth(source, mapping, where),
        heading=None if mapping.heading is None else read_headings(source, mapping.heading),
    )


def _truth(source: Source, mapping: Mapping, start: PositionRows | None) -> PositionRows | None:
    """Read the reference, which often is what the start was taken from."""
    one, other = mapping.truth, mapping.initial.position
    if one is None:
        return None
    if start is not None and other is not None and _alike(one, other):
        return start
    return read_positions(source, one)


def _alike(one: PositionMapping, other: PositionMapping) -> bool:
    same = (one.stream, one.frame) == (other.stream, other.frame)
    return same and np.array_equal(one.C_s_b, other.C_s_b)


def _latitude_deg(where: PositionRows | None, fixes: Sequence[FixRows], otherwise: float) -> float:
    """Latitude of the first position there is, for the gravity in pressure to depth [deg]."""
    rows = where.r_e if where is not None else np.zeros((0, 3))
    found = [r for r in rows if np.isfinite(r).all()][:1]
    found += [f.r_e for one in fixes for f in one.fixes if np.isfinite(f.r_e).all()][:1]
    return float(np.degrees(geodetic_from_ecef(found[0])[0])) if found else otherwise


def check(streams: _Streams, mapping: Mapping) -> list[Finding]:
    """Look at everything that was read."""
    out: list[Finding] = []
    every = (streams.imu, *streams.dvls, *streams.depths, streams.heading)
    sensors = [s for s in every if s is not None]
    for rows in sensors:
        out += check_stamps(rows.topic, rows.stamps_ns, rows.log_ns)
    for one in streams.fixes:
        out += check_stamps(one.topic, one.stamps_ns, one.log_ns, delayed=True)
    if streams.truth is not None:
        out += check_stamps(streams.truth.topic, streams.truth.stamps_ns, streams.truth.log_ns)
    out += check_spans(*_times(streams, mapping))
    out += check_imu(streams.imu)
    for dvl in streams.dvls:
        out += check_dvl(dvl)
    for depth in streams.depths:
        out += check_depth(depth)
    limit = mapping.params.get('max_delay_s', default_of(EngineParams, 'max_delay_s'))
    for one in streams.fixes:
        out += check_fixes(one, float(limit))
    if streams.truth is not None:
        out += check_positions(streams.truth)
        if not np.isfinite(streams.truth.C_b_G).any():
            out.append(_no_attitude(streams.truth))
    return out


def _times(s: _Streams, mapping: Mapping) -> tuple[Times, list[Times]]:
    """Times of the IMU, and of everything else."""

    def times(
        rows: ImuRows | DvlRows | DepthRows | PositionRows | FixRows | HeadingRows,
        stream: Stream,
        *,
        delayed: bool = False,
    ) -> Times:
        return Times(rows.topic, rows.stamps_ns, rows.log_ns, stream.offset_ns, delayed)

    pings = zip(s.dvls, mapping.dvls, strict=True)
    depths = zip(s.depths, mapping.depths, strict=True)
    others = [times(rows, one.stream) for rows, one in pings]
    others += [times(rows, one.stream) for rows, one in depths]
    if s.heading is not None and mapping.heading is not None:
        others.append(times(s.heading, mapping.heading.stream))
    for rows, fix in zip(s.fixes, mapping.fixes, strict=True):
        others.append(times(rows, fix.position.stream, delayed=True))
    if s.truth is not None and mapping.truth is not None:
        others.append(times(s.truth, mapping.truth.stream))
    return times(s.imu, mapping.imu.stream), others


def _no_attitude(truth: PositionRows) -> Finding:
    return finding(
        'truth_attitude',
        Severity.NOTE,
        truth.topic,
        int(truth.stamps_ns[0]),
        len(truth.stamps_ns),
        0.0,
        f'{truth.type} has no attitude here: errors of attitude are not scored, velocity is that '
        'of the positions',
    )


def _unstated(mapping: Mapping) -> list[Finding]:
    wanted = _NOISE if mapping.dvl is None else (*_NOISE, *_DVL_NOISE)
    missing = [name for name in wanted if name not in mapping.params]
    if not missing:
        return []
    return [
        finding(
            'noise_not_stated',
            Severity.WARNING,
            mapping.imu.stream.topic,
            None,
            0,
            float(len(missing)),
            f'{", ".join(missing)} are not stated: those of a navigation-grade IMU and a good DVL '
            'are taken, and cheaper ones make the filter too sure of itself; `noise: {imu: CLASS, '
            'dvl: CLASS}` states them',
        )
    ]


def _in_order(s: _Streams) -> _Streams:
    return _Streams(
        imu=_sorted(s.imu),
        dvls=_together(s.dvls),
        depths=_together(s.depths),
        fixes=s.fixes,
        initial=None if s.initial is None else s.initial.sorted(),
        truth=None if s.truth is None else s.truth.sorted(),
        heading=None if s.heading is None else _sorted(s.heading),
    )


def _together(several: tuple[_T, ...]) -> tuple[_T, ...]:
    """All rows of sensors of one kind, by stamp; equal stamps in the order that a node counts."""
    if len(several) < 2:
        return tuple(_sorted(rows) for rows in several)
    count = len(several)
    numbers = [np.arange(len(rows.stamps_ns)) * count + i for i, rows in enumerate(several)]
    order = np.argsort(np.concatenate(numbers))
    changes: dict[str, Any] = {}
    for name in vars(several[0]):
        values = [getattr(rows, name) for rows in several]
        if all(isinstance(value, np.ndarray) for value in values):
            changes[name] = np.concatenate(values)[order]
        elif name != 'topic':  # pressures, where not all have them
            changes[name] = None
    return (_sorted(replace(several[0], **changes)),)


def _sorted(rows: _T) -> _T:
    """By stamp, without stamps that nobody filled in where others have one."""
    stamps = rows.stamps_ns
    zero = unfilled(stamps)
    if (np.diff(stamps) >= 0).all() and not zero.any():
        return rows
    order: NDArray[Any] = np.argsort(stamps, kind='stable')
    if not zero.all():
        order = order[~zero[order]]
    changes = {
        name: value[order] for name, value in vars(rows).items() if isinstance(value, np.ndarray)
    }
    return replace(rows, **changes)


def _inputs(s: _Streams, start_ns: int, started_from: PositionMapping | None) -> Inputs:
    """Cut everything to the start; the sample at the start gives the engine its first stamp.

    Fixes that the start was taken from are left out: they would count twice.
    """
    imu, dvl, depth = s.imu, s.dvl, s.depth
    i, d, e = (
        slice(0 if rows is None else int(np.searchsorted(rows.stamps_ns, start_ns)), None)
        for rows in (imu, dvl, depth)
    )
    given: dict[str, Any] = {}
    if dvl is not None:
        given |= {
            'dvl_stamps_ns': dvl.stamps_ns[d],
            'dvl_v_m': dvl.velocity[d],
            'dvl_covariance_m': dvl.covariance[d],
            'dvl_valid': dvl.valid[d],
            'dvl_water': dvl.water[d],
        }
    if depth is not None:
        given |= {
            'depth_stamps_ns': depth.stamps_ns[e],
            'depth': depth.depth[e],
            'depth_variance': depth.variance[e],
        }
    if s.heading is not None:
        h = (s.heading.stamps_ns >= start_ns) & np.isfinite(s.heading.heading)
        given |= {
            'heading_stamps_ns': s.heading.stamps_ns[h],
            'headings': s.heading.heading[h],
            'heading_up_b': _c(s.heading.up_b[h]),
        }
    fixes: tuple[Fix, ...] = tuple(f for one in s.fixes for f in one.fixes)
    topic = None if started_from is None else started_from.stream.topic
    fixes = tuple(
        f
        for f in fixes
        if f.receive_ns >= start_ns and not (f.topic == topic and f.validity_ns <= start_ns)
    )
    return Inputs(imu.stamps_ns[i], _c(imu.omega_ib_b[i]), _c(imu.f_b[i]), fixes=fixes, **given)


def _c(values: Array) -> Array:
    return np.ascontiguousarray(values)
