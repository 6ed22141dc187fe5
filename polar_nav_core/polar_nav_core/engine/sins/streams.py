"""Input streams of the compiled filter: rings of live measurements, or arrays of whole runs.

The filter's cursors count all measurements from the start; number i stands at i % length. A live
ring keeps as much as `rewind` goes back over; a run's arrays keep everything.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import Ints
from ...kernels.sins.rings import OUTCOME, Streams
from ..events import ControlSample, DepthSample, DvlPing, Fix, HeadingSample, ImuSample
from ..level import degrees_of_freedom
from ..results import FIXES
from .leader import Split
from .leader_drift import COLUMNS as LEADER_COLUMNS


def live_streams(length_s: float, imu_rate: float, local_rate: float) -> Streams:
    """Empty rings for ``seconds``; ``local_rate`` is that of DVL and depth each [Hz].

    Thrust and headings may come as often as IMU samples.
    """
    imu, local = int(length_s * imu_rate) + 16, int(length_s * local_rate) + 16
    return Streams(
        counts=np.zeros(6, dtype=np.int64),
        imu_stamps=np.zeros(imu, dtype=np.int64),
        omega_ib_b=np.zeros((imu, 3)),
        f_b=np.zeros((imu, 3)),
        depth_stamps=np.zeros(local, dtype=np.int64),
        depth=np.zeros(local),
        depth_variance=np.zeros(local),
        dvl_stamps=np.zeros(local, dtype=np.int64),
        dvl_v_m=np.zeros((local, 3)),
        dvl_covariance_m=np.zeros((local, 3, 3)),
        dvl_water=np.zeros(local, dtype=np.int64),
        **room_for_fixes(),
        control_stamps=np.zeros(imu, dtype=np.int64),
        control_force_b=np.zeros((imu, 3)),
        heading_stamps=np.zeros(imu, dtype=np.int64),
        headings=np.zeros(imu),
        heading_up_b=np.zeros((imu, 3)),
    )


def room_for_fixes() -> dict[str, Any]:
    """Empty columns of `Streams` for fixes."""
    return {
        'fix_stamps': np.zeros(FIXES, dtype=np.int64),
        'fix_validities': np.zeros(FIXES, dtype=np.int64),
        'fix_r_e': np.zeros((FIXES, 3)),
        'fix_covariance_e': np.zeros((FIXES, 3, 3)),
        'fix_array_heading': np.zeros(FIXES),
        'fix_relative_e': np.zeros((FIXES, 3)),
        'fix_common_e': np.zeros((FIXES, 3, 3 + LEADER_COLUMNS)),
        'fix_dof': np.zeros(FIXES, dtype=np.int64),
        'fix_outcomes': np.zeros((FIXES, OUTCOME)),
        'fix_notes': np.zeros((FIXES, 3), dtype=np.int64),
    }


def put_imu(streams: Streams, sample: ImuSample) -> None:
    """Append an IMU sample to its ring."""
    i = _append(streams.counts, 0, streams.imu_stamps, sample.stamp_ns)
    streams.omega_ib_b[i] = sample.omega_ib_b
    streams.f_b[i] = sample.f_b


def put_depth(streams: Streams, sample: DepthSample) -> None:
    """Append a depth to its ring."""
    i = _append(streams.counts, 1, streams.depth_stamps, sample.stamp_ns)
    streams.depth[i] = sample.depth
    streams.depth_variance[i] = sample.variance


def put_dvl(streams: Streams, ping: DvlPing) -> None:
    """Append a usable DVL ping to its ring."""
    i = _append(streams.counts, 2, streams.dvl_stamps, ping.stamp_ns)
    streams.dvl_v_m[i] = ping.v_m
    streams.dvl_covariance_m[i] = ping.covariance_m
    streams.dvl_water[i] = ping.water


def put_control(streams: Streams, sample: ControlSample) -> None:
    """Append a thrust to its ring."""
    i = _append(streams.counts, 4, streams.control_stamps, sample.stamp_ns)
    streams.control_force_b[i] = sample.force_b


def put_heading(streams: Streams, sample: HeadingSample) -> None:
    """Append a heading to its ring."""
    i = _append(streams.counts, 5, streams.heading_stamps, sample.stamp_ns)
    streams.headings[i] = sample.heading
    streams.heading_up_b[i] = sample.up_b


def _append(counts: Ints, stream: int, stamps: Ints, stamp_ns: int) -> int:
    """Store a stamp [ns] at the end of a ring, count it, and return its slot."""
    slot = int(counts[stream]) % len(stamps)
    stamps[slot] = stamp_ns
    counts[stream] += 1
    return slot


def insert_fix(streams: Streams, fix: Fix, split: Split, number: int) -> None:
    """Insert a fix at an index of the fixes; those at and after it move up by one."""
    length = len(streams.fix_stamps)
    columns = (
        streams.fix_stamps,
        streams.fix_validities,
        streams.fix_r_e,
        streams.fix_covariance_e,
        streams.fix_array_heading,
        streams.fix_relative_e,
        streams.fix_common_e,
        streams.fix_dof,
        streams.fix_outcomes,
    )
    for k in range(int(streams.counts[3]), number, -1):
        for column in columns:
            column[k % length] = column[(k - 1) % length]
    _put_fix(streams, fix, split, number, fix.validity_ns)


def put_late_fix(streams: Streams, fix: Fix, split: Split) -> None:
    """Append a fix at its stamp of reception."""
    _put_fix(streams, fix, split, int(streams.counts[3]), fix.receive_ns)


def _put_fix(streams: Streams, fix: Fix, split: Split, number: int, stamp_ns: int) -> None:
    i = number % len(streams.fix_stamps)
    streams.fix_stamps[i] = stamp_ns
    streams.fix_validities[i] = fix.validity_ns
    streams.fix_r_e[i] = fix.r_e
    streams.fix_covariance_e[i] = split.covariance_e
    streams.fix_array_heading[i] = fix.array_heading
    streams.fix_relative_e[i] = fix.relative_e
    streams.fix_common_e[i] = split.common_e
    streams.fix_dof[i] = degrees_of_freedom(fix)
    streams.fix_outcomes[i] = 0.0
    streams.counts[3] += 1
