"""What the watchdog of a strapdown navigation sees of it, and what the vehicle can do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...arrays import Array, Ints
from ...kernels import watch
from .compass import Compass
from .slow import Evidence


class Gaps(NamedTuple):
    """Number of gaps, length of the newest one [s], stamp of its end [ns], samples missing [1]."""

    number: int
    last_s: float
    end_ns: int
    missing: float = 0.0


NO_GAPS = Gaps(0, 0.0, 0)


@dataclass(frozen=True)
class View:
    """Quantities of a navigation that the watchdog judges at one stamp.

    Attributes
    ----------
    stamp_ns : int
    memories : (STREAMS, MEMORIES, WIDTH) array
        Innovation memories of DVL, depth and fixes.
    opened_ns : (STREAMS,) array of int
        When the gate of a stream was last opened again; 0 for never.
    used_ns : (STREAMS,) array of int
        Newest measurement of a stream that was used; 0 for none.
    refused_row : (STREAMS,) array of int
        How many of the newest measurements of a stream were refused one after the other.
    speed, depth : float
        Of the vehicle [m/s], below the surface [m].
    P_horizontal : (2, 2) array
        Published covariance of the horizontal position [m^2].
    resets : int
        How often the state was inflated, restored or started anew.
    gaps : Gaps
        Between IMU samples, that were bridged.
    imu_noise : float
        Of the noise that is stated for the IMU, how many times it is taken to be.
    leader_stated : bool
        Whether packets state a leader's error: it is covered amply, and fixes scatter less.
    shared : (COLUMNS + 1, COLUMNS) array or None
        What innovations show of the common errors (kernels.sins.shared); None where nobody looks.
    evidence : Evidence or None
        About slow faults; None where nobody looks.
    leapt_ns : int
        When a ping last corrected more than an attitude that is right needs; 0 for never.
    shock_ns : int
        Stamp of the newest IMU sample that differed by far more than is usual; 0 for none.
    compass : Compass or None
        Measured headings; None where they are not used.
    """

    stamp_ns: int
    memories: Array
    opened_ns: Ints
    used_ns: Ints
    speed: float
    depth: float
    P_horizontal: Array
    resets: int
    gaps: Gaps = NO_GAPS
    refused_row: Ints = field(default_factory=lambda: np.zeros(watch.STREAMS, dtype=np.int64))
    imu_noise: float = 1.0
    shared: Array | None = None
    leader_stated: bool = False
    evidence: Evidence | None = None
    leapt_ns: int = 0
    shock_ns: int = 0
    compass: Compass | None = None


@dataclass(frozen=True)
class Envelope:
    """Limits of the vehicle and of the pauses of its sensors.

    Attributes
    ----------
    max_speed, max_depth : float
        [m/s], [m].
    lost_radius : float
        Horizontal 95 % radius from which on it counts as lost [m].
    max_imu_gap_s : float
        A longer gap between IMU samples is an error.
    silent_after_s : float
        A sensor that was used and is not for longer is silent.
    max_current : float
        Strongest current that an estimate in station mode can have [m/s].
    """

    max_speed: float
    max_depth: float
    lost_radius: float = math.inf
    max_imu_gap_s: float = math.inf
    silent_after_s: float = math.inf
    max_current: float = math.inf
