"""Reads the quantities of one role from one topic of a bag; the adapters make SI units of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters.headings import HeadingRows, headings_of
from polar_nav_ros.adapters.mapping import (
    DepthMapping,
    DvlMapping,
    HeadingMapping,
    ImuMapping,
    PositionMapping,
    Stream,
)
from polar_nav_ros.adapters.position import PositionRows, positions_of
from polar_nav_ros.adapters.rows import Rows, places_of
from polar_nav_ros.adapters.sensor_clock import SensorClock
from polar_nav_ros.adapters.sensors import (
    DepthRows,
    DvlRows,
    ImuRows,
    depths_of,
    imu_of,
    pings_of,
)

from ..bags.columns import stamps
from ..bags.errors import BagError
from .sources import Source, Stamps, field_paths, read_table, require


def read_rows(source: Source, stream: Stream, role: str) -> Rows:
    """Read what a role needs from a topic.

    Raises
    ------
    BagError
        When the topic has no message or one cannot be decoded.
    ConfigError
        When the type has no adapter and ``fields`` does not say where the quantities stand, or
        is not the one that the mapping states.
    """
    kind = require(source, stream.topic).type
    if stream.type and stream.type != kind:
        raise ConfigError(
            f'{source.path}: {stream.topic} is of type {kind}, the mapping says {stream.type}'
        )
    there = field_paths(source, stream.topic)
    places = places_of(stream, role, kind, there, str(source.path))
    paths = places.quantities.values()
    wanted = list(dict.fromkeys([*places.stamp, *(q for several in paths for q in several)]))
    several = [names for names in paths if len(names) > 1]
    table = read_table(source, stream.topic, wanted or [there[0]], several)
    values = {n: _stacked(table.columns, p) for n, p in places.quantities.items()}
    when = _times(table.columns, places.stamp, table.log_ns)
    if stream.clock == 'sensor':
        when = _on_the_host(when, table.log_ns)
    when = when + stream.offset_ns
    return Rows(stream.topic, kind, when, table.log_ns, values, table.constants)


def read_imu(source: Source, mapping: ImuMapping) -> ImuRows:
    """Read an IMU; errors as `read_rows`."""
    return imu_of(read_rows(source, mapping.stream, 'imu'), mapping)


def read_dvl(
    source: Source, mapping: DvlMapping, default_sigma: float, water_sound_speed: float
) -> DvlRows:
    """Read a DVL; errors as `read_rows`, parameters as `pings_of`."""
    rows = read_rows(source, mapping.stream, 'velocity')
    return pings_of(rows, mapping, default_sigma, water_sound_speed)


def read_depth(
    source: Source, mapping: DepthMapping, default_sigma: float, latitude_deg: float
) -> DepthRows:
    """Read depth or pressure; errors as `read_rows`, parameters as `depths_of`."""
    rows = read_rows(source, mapping.stream, 'depth')
    return depths_of(rows, mapping, default_sigma, latitude_deg)


def read_headings(source: Source, mapping: HeadingMapping) -> HeadingRows:
    """Read an AHRS or compass; errors as `read_rows`."""
    return headings_of(read_rows(source, mapping.stream, 'heading'), mapping)


def read_positions(
    source: Source, mapping: PositionMapping, level: float | None = None
) -> PositionRows:
    """Read a topic of positions; errors as `read_rows`, parameters as `positions_of`."""
    return positions_of(read_rows(source, mapping.stream, 'position'), mapping, level)


def _on_the_host(stamps_ns: Stamps, log_ns: Stamps) -> Stamps:
    """Stamps of a sensor's clock on the clock of the recorder, message by message as live."""
    clock = SensorClock()
    both = zip(stamps_ns.tolist(), log_ns.tolist(), strict=True)
    return np.array([clock.host_ns(own_ns, at_ns) for own_ns, at_ns in both], dtype=np.int64)


def _times(columns: Mapping[str, NDArray[Any]], paths: tuple[str, ...], log_ns: Stamps) -> Stamps:
    if not paths:
        return log_ns.copy()
    if len(paths) == 2:
        return stamps(dict(columns), paths[0].rpartition('.')[0])
    value = columns[paths[0]]
    if value.dtype.kind == 'f':  # seconds; good to 0.24 us at epoch seconds
        if not np.isfinite(value).all():
            raise BagError(f'field {paths[0]} is not a time in every message')
        return np.asarray(np.round(value * 1e9), dtype=np.int64)
    return value.astype(np.int64)  # whole nanoseconds


def _stacked(columns: Mapping[str, NDArray[Any]], paths: tuple[str, ...]) -> NDArray[Any]:
    first = columns[paths[0]]
    if len(paths) == 1 or first.ndim > 1:  # the latter are side by side in the messages
        return first
    return np.column_stack([columns[p] for p in paths])
