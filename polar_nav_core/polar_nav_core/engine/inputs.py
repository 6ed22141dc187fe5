"""Sensor data of one vehicle's run in either mode, as arrays and as events."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import spilled
from ..arrays import Array
from .events import (
    ControlSample,
    DepthSample,
    DvlPing,
    Event,
    Fix,
    HeadingSample,
    ImuSample,
    OrderKey,
)

Stamps = NDArray[np.int64]


def _stamps() -> Stamps:
    return np.zeros(0, dtype=np.int64)


def _empty(*shape: int) -> Callable[[], Array]:
    return lambda: np.zeros((0, *shape))


@dataclass(frozen=True)
class Inputs:
    """Sensor data of a run in SINS mode; each stream in the order of its stamps.

    Attributes
    ----------
    imu_stamps_ns, omega_ib_b, f_b : (n,), (n, 3), (n, 3) arrays
        Ends of the intervals; rate [rad/s] and specific force [m/s^2].
    dvl_stamps_ns, dvl_v_m, dvl_covariance_m, dvl_valid : (d,), (d, 3), (d, 3, 3), (d,) arrays
        Pings: velocity over ground [m/s], instrument axes; whether there was bottom lock.
    dvl_water : (d,) array of bool, or empty for none
        Whether a ping's velocity is relative to the water.
    depth_stamps_ns, depth, depth_variance : (e,) arrays
        Depth below the sea surface [m], positive down, and variance [m^2].
    fixes : tuple of Fix
        In any order: the engine takes them as they are received.
    control_stamps_ns, control_force_b, control_torque_b : (u,), (u, 3), (u, 3) arrays
        Stamps from which thrust holds: force [N] and torque [N m], body axes.
    heading_stamps_ns, headings, heading_up_b : (h,), (h,), (h, 3) arrays
        Headings [rad], clockwise from their reference; up in body axes, NaN where not measured.
    """

    imu_stamps_ns: Stamps
    omega_ib_b: Array
    f_b: Array
    dvl_stamps_ns: Stamps = field(default_factory=_stamps)
    dvl_v_m: Array = field(default_factory=_empty(3))
    dvl_covariance_m: Array = field(default_factory=_empty(3, 3))
    dvl_valid: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    depth_stamps_ns: Stamps = field(default_factory=_stamps)
    depth: Array = field(default_factory=_empty())
    depth_variance: Array = field(default_factory=_empty())
    fixes: tuple[Fix, ...] = ()
    control_stamps_ns: Stamps = field(default_factory=_stamps)
    control_force_b: Array = field(default_factory=_empty(3))
    control_torque_b: Array = field(default_factory=_empty(3))
    dvl_water: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    heading_stamps_ns: Stamps = field(default_factory=_stamps)
    headings: Array = field(default_factory=_empty())
    heading_up_b: Array = field(default_factory=_empty(3))

    def imu_sample(self, k: int) -> ImuSample:
        """Sample number k as an event."""
        return ImuSample(int(self.imu_stamps_ns[k]), k, self.omega_ib_b[k], self.f_b[k])

    def dvl_ping(self, k: int) -> DvlPing:
        """Ping number k as an event."""
        return DvlPing(
            int(self.dvl_stamps_ns[k]),
            k,
            bool(self.dvl_valid[k]),
            self.dvl_v_m[k],
            self.dvl_covariance_m[k],
            water=bool(len(self.dvl_water) and self.dvl_water[k]),
        )

    def depth_sample(self, k: int) -> DepthSample:
        """Depth number k as an event."""
        return DepthSample(
            int(self.depth_stamps_ns[k]), k, float(self.depth[k]), float(self.depth_variance[k])
        )

    def control_sample(self, k: int) -> ControlSample:
        """Control sample number k as an event."""
        return ControlSample(
            int(self.control_stamps_ns[k]), k, self.control_force_b[k], self.control_torque_b[k]
        )

    def heading_sample(self, k: int) -> HeadingSample:
        """Heading number k as an event."""
        stamp_ns = int(self.heading_stamps_ns[k])
        return HeadingSample(stamp_ns, k, float(self.headings[k]), self.heading_up_b[k])

    def events(self) -> Iterator[Event]:
        """All events, in the total order."""
        return heapq.merge(
            (self.imu_sample(k) for k in range(len(self.imu_stamps_ns))),
            (self.control_sample(k) for k in range(len(self.control_stamps_ns))),
            (self.depth_sample(k) for k in range(len(self.depth_stamps_ns))),
            (self.dvl_ping(k) for k in range(len(self.dvl_stamps_ns))),
            (self.heading_sample(k) for k in range(len(self.heading_stamps_ns))),
            sorted(self.fixes, key=lambda fix: fix.key),
            key=_key,
        )


@dataclass(frozen=True)
class StationInputs:
    """Sensor data of a run in station mode; each stream in the order of its stamps.

    Attributes
    ----------
    imu_stamps_ns, omega_ib_b, C_b_G : (n,), (n, 3), (n, 3, 3) arrays
        Rate [rad/s] and the AHRS' attitude.
    control_stamps_ns, force_b : (c,), (c, 3) arrays
        Thrust from the stamp on [N], body axes.
    depth_stamps_ns, depth, depth_variance : (e,) arrays
        Depth below the sea surface [m], positive down, and variance [m^2].
    fixes : tuple of Fix
        In any order: the engine takes them as they are received.
    """

    imu_stamps_ns: Stamps
    omega_ib_b: Array
    C_b_G: Array
    control_stamps_ns: Stamps = field(default_factory=_stamps)
    force_b: Array = field(default_factory=_empty(3))
    depth_stamps_ns: Stamps = field(default_factory=_stamps)
    depth: Array = field(default_factory=_empty())
    depth_variance: Array = field(default_factory=_empty())
    fixes: tuple[Fix, ...] = ()

    def imu_sample(self, k: int) -> ImuSample:
        """Sample number k as an event."""
        stamp_ns = int(self.imu_stamps_ns[k])
        return ImuSample(stamp_ns, k, self.omega_ib_b[k], np.zeros(3), self.C_b_G[k])

    def control_sample(self, k: int) -> ControlSample:
        """Thrust number k as an event."""
        return ControlSample(int(self.control_stamps_ns[k]), k, self.force_b[k], np.zeros(3))

    def depth_sample(self, k: int) -> DepthSample:
        """Depth number k as an event."""
        return DepthSample(
            int(self.depth_stamps_ns[k]), k, float(self.depth[k]), float(self.depth_variance[k])
        )

    def events(self) -> Iterator[Event]:
        """All events, in the total order."""
        return heapq.merge(
            (self.imu_sample(k) for k in range(len(self.imu_stamps_ns))),
            (self.control_sample(k) for k in range(len(self.control_stamps_ns))),
            (self.depth_sample(k) for k in range(len(self.depth_stamps_ns))),
            sorted(self.fixes, key=lambda fix: fix.key),
            key=_key,
        )


def rows_of(values: NDArray[Any], keep: NDArray[np.bool_]) -> NDArray[Any]:
    """Rows where ``keep`` is true, contiguous; the array itself if that is all of them."""
    if keep.all():
        return np.ascontiguousarray(values)
    return spilled.chosen(values, np.flatnonzero(keep))


def new_seconds(stamps_ns: NDArray[np.int64]) -> list[int]:
    """Stamps of the samples with which a new second begins [ns], without the first sample."""
    found: list[int] = []
    for part in spilled.parts(len(stamps_ns) - 1):
        before, after = stamps_ns[part], stamps_ns[part.start + 1 : part.stop + 1]
        found += after[after // 1_000_000_000 != before // 1_000_000_000].tolist()
    return found


def at_least_one(values: NDArray[Any]) -> NDArray[Any]:
    """The array, or one row of zeros for an empty one: a ring needs a length."""
    return values if len(values) else np.zeros((1, *values.shape[1:]), dtype=values.dtype)


def _key(event: Event) -> OrderKey:
    return event.key
