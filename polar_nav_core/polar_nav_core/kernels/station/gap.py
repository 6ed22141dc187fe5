"""A gap between AHRS samples in station mode: counted, and in the covariance.

The model runs over a gap in one step, by the mean of the attitudes on both sides of it. Where the
vehicle really went meanwhile is not known.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from . import state as ss
from .state import Bank, Settings, Streams

USUAL = 3
"""A gap is longer than so many of the intervals that were usual before it."""
LEAST_TURN = 0.087
"""5 deg: turn of the AHRS against its own rates from which on its heading is doubted [rad]."""
TURN_RATE = 0.1
"""At which a vehicle turns while its attitude is not known [rad/s], 1-sigma."""


@kernel
def _is_gap(b: Bank, c: Settings, streams: Streams, i: int) -> bool:
    """Whether AHRS sample i ends a gap: longer than stated, and than the interval before it."""
    n = streams.imu_stamps.shape[0]
    length_ns = streams.imu_stamps[i % n] - b.counters[ss.STAMP]
    if length_ns <= c.gap_ns:
        return False
    usual_ns = 0
    if i > 1:
        usual_ns = streams.imu_stamps[(i - 1) % n] - streams.imu_stamps[(i - 2) % n]
    return bool(length_ns > USUAL * usual_ns)


@kernel
def cross_gap(b: Bank, c: Settings, streams: Streams, i: int, points: Array) -> None:
    """Count a gap that AHRS sample i ends, and add the unknown path to the covariance.

    Meanwhile the vehicle may have turned at TURN_RATE, up to about a radian. The published filter
    keeps its covariance.

    Parameters
    ----------
    b : Bank
        In place; its stamp is that of the sample before.
    c, streams : settings, streams
    i : int
        Number of the sample.
    points : (B, 12) array
        States before it.
    """
    if not _is_gap(b, c, streams, i):
        return
    stamp_ns = streams.imu_stamps[i % streams.imu_stamps.shape[0]]
    length_ns = stamp_ns - b.counters[ss.STAMP]
    b.counters[ss.GAPS] += 1
    b.counters[ss.GAP_NS] = length_ns
    b.counters[ss.GAP_END_NS] = stamp_ns
    if c.published:
        return
    dt = length_ns * 1e-9
    for m in range(b.x.shape[0]):
        v_r = points[m]
        speed = math.sqrt(v_r[0] * v_r[0] + v_r[1] * v_r[1])
        far = speed * dt * min(1.0, 0.5 * TURN_RATE * dt)
        for k in range(ss.POSITION, ss.POSITION + 2):
            b.P[m, k, k] += far * far


@kernel
def doubt_heading(b: Bank, c: Settings, streams: Streams, i: int) -> None:
    """Add a turn of the AHRS against its own rates to the variance of the heading's bias.

    ``i`` is the number of its sample. The turn may be the error or the end of one. Magnets, a
    compass that sticks: gyros that are off by half a degree per second do not reach `LEAST_TURN`.
    """
    if c.doubt <= 0.0:
        return
    angle = streams.unexplained[i % streams.imu_stamps.shape[0]]
    square = angle * angle
    part = b.loose[ss.TURNED_2]
    if square < 0.25 * LEAST_TURN * LEAST_TURN:
        b.loose[ss.TURNED_2] = 0.0
    elif square > LEAST_TURN * LEAST_TURN and square > part:
        if part == 0.0:
            b.counters[ss.TURNS] += 1
            b.counters[ss.TURN_NS] = streams.imu_stamps[i % streams.imu_stamps.shape[0]]
        for m in range(b.x.shape[0]):
            b.P[m, ss.HEADING, ss.HEADING] += square - part
        b.loose[ss.TURNED_2] = square
