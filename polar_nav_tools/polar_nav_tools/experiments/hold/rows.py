"""Rows of the experiment `faults`: one injected fault each, and a selection by name."""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError

from ...inject.faults import parse
from ..draws import numbers_after
from ..request import rows_matching
from ..station.world import NS, StationWorld
from ..world import World
from .random_rows import PREFIXES, random_row
from .row import START_S, Row, inertial, station

_SINS = (
    'imu_silent:0.3', 'imu_silent:1', 'imu_silent:3', 'imu_silent:20', 'imu_silent:inf',
    'imu_ahead:5', 'imu_several_ahead:5', 'imu_2038', 'imu_several_2038', 'imu_1970',
    'imu_force:1e6', 'imu_force:1000', 'imu_force:50', 'imu_rate:1', 'imu_rate:3', 'imu_rate:30',
    'imu_rate:1e300', 'imu_nan:1', 'imu_nan:300',
    'imu_stuck:10', 'imu_gyro_stuck:10', 'imu_accelerometer_stuck:10', 'imu_gyro_step:0.01',
    'imu_gyro_axis_stuck:30', 'imu_gyro_degrees:1', 'imu_yaw:5', 'imu_yaw:20', 'imu_yaw:180',
    'imu_accelerometer_step:0.05', 'imu_mirrored', 'imu_swapped', 'imu_lost:0.5', 'imu_repeated',
    'imu_reordered:0.3', 'imu_late:5', 'imu_clock:3600', 'imu_clock:-10', 'imu_clock:0.3',
    'imu_clock:-0.3', 'imu_clock:-0.1', 'imu_clock_rate:1000', 'imu_clock_rate:-300',
    'dvl_indefinite', 'dvl_covariance:5e-324', 'dvl_covariance:9e-12',
    'dvl_covariance:1e300', 'dvl_sigma:3e-6', 'dvl_velocity:1e300', 'dvl_velocity:100', 'dvl_nan',
    'dvl_silent:30', 'dvl_silent:inf', 'dvl_outage:60', 'dvl_stuck:20', 'dvl_scale:0.05',
    'dvl_turn:3', 'dvl_swapped', 'dvl_2038', 'dvl_ahead:5', 'dvl_late:5', 'dvl_repeated',
    'dvl_lost', 'dvl_clock:10', 'dvl_clock:-10', 'dvl_clock:0.3', 'dvl_clock_rate:1000',
    'depth_value:1e160', 'depth_value:1000', 'depth_variance:5e-324', 'depth_variance:1e308',
    'depth_nan', 'depth_silent:30', 'depth_silent:inf', 'depth_stuck:20', 'depth_swapped',
    'depth_2038', 'depth_clock:10',
    'packet_flipped:20', 'packet_indefinite', 'packet_jump:5000', 'packet_displaced:500',
    'packet_drift:0.05', 'packet_replayed:20', 'packet_burnt:600', 'packet_sigma:0.005',
    'packet_sigma:13000', 'packet_silent:30', 'packet_silent:inf',
    'packet_repeated', 'packet_reordered:10', 'packet_late:10', 'packet_lost', 'packet_clock:10',
    'clock_step:3600', 'clock_step:-10', 'clock_step:2', 'clock_step:-2',
    'clock_step:0.4', 'clock_step:-0.3',
)  # fmt: skip
_WITHOUT_DVL = (
    'imu_silent:1', 'imu_silent:3', 'imu_stuck:10', 'imu_force:50', 'imu_rate:1',
    'imu_gyro_step:0.01', 'imu_gyro_axis_stuck:30', 'imu_gyro_degrees:1', 'imu_yaw:20',
    'imu_yaw:180', 'imu_accelerometer_step:0.05', 'depth_silent:30', 'packet_jump:5000',
    'packet_displaced:500', 'packet_drift:0.05', 'packet_silent:30',
)  # fmt: skip
"""Nothing but fixes vouches for such a vehicle."""
_TURNING = ('imu_yaw:30', 'imu_yaw:90', 'imu_yaw:130')
"""On a racetrack a turn that never was is no offset of a straight track."""
_STATION = (
    'imu_silent:1', 'imu_silent:20', 'imu_2038', 'imu_rate:30', 'imu_swapped', 'imu_stuck:10',
    'thrust_absurd:1e6', 'thrust_silent:30', 'thrust_silent:inf', 'thrust_nan', 'thrust_swapped',
    'depth_value:1e160', 'depth_silent:30', 'packet_jump:500', 'packet_flipped:30',
    'packet_silent:60', 'packet_burnt:200', 'packet_replayed:5', 'clock_step:3600',
    'clock_step:-10',
)  # fmt: skip


def _rows() -> dict[str, Row]:
    groups = (
        ('', _SINS, inertial()),
        ('turning/', _TURNING, inertial(mission='racetrack')),
        ('no_dvl/', _WITHOUT_DVL, inertial(dvl_rate_hz=0.0)),
        ('station/', _STATION, station()),
    )
    rows = [
        Row(f'{prefix}{text}', (parse(f'{text}@{START_S:g}'),), scene)
        for prefix, texts, scene in groups
        for text in texts
    ]
    return {row.name: row for row in rows}


ROWS = _rows()


def rows_named(patterns: str | None) -> list[Row]:
    """Rows whose names match comma-separated shell patterns; all without any.

    Numbers after one of `PREFIXES` are rows drawn at random.

    Raises
    ------
    ConfigError
        For a pattern that matches none, or a prefix that no number follows.
    """
    chosen: dict[str, Row] = {}
    for word in (patterns or '*').split(','):
        pattern = word.strip()
        prefix = next((p for p in PREFIXES if pattern.startswith(p)), '')
        found = (
            [random_row(prefix, number) for number in numbers_after(prefix, pattern)]
            if prefix
            else [ROWS[name] for name in _matching(pattern)]
        )
        chosen |= {row.name: row for row in found}
    return list(chosen.values())


def _matching(pattern: str) -> list[str]:
    try:
        return rows_matching(pattern, ROWS)
    except ConfigError as error:
        drawn = ', '.join(f'{prefix}1-50' for prefix in PREFIXES)
        raise ConfigError(f'{error}; or drawn at random: {drawn}') from error


def true_positions(world: World | StationWorld, time_s: Array) -> Array:
    """True ECEF positions (n, 3) [m] at times since the start [s]."""
    if isinstance(world, World):
        stamps = world.truth.start_ns + np.rint(time_s * NS).astype(np.int64)
        return np.asarray(world.truth.state(stamps).r_e)
    run = world.run
    row = np.clip(np.searchsorted(run.t_s, time_s - 1e-6), 0, len(run.t_s) - 1)
    return np.asarray(world.origin_e + run.p[row] @ world.C_e_S)
