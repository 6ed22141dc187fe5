"""A whole run at once: sensor data as arrays in, the track and the receipts out.

The engine is the same as in the node; only the driver differs. Experiments, Monte Carlo runs and
fast replays use this.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .engine import Engine
from .events import Array, DepthSample, DvlPing, Estimate, Event, Fix, ImuSample, Output, Receipt
from .params import EngineParams

Stamps = NDArray[np.int64]


def _stamps() -> Stamps:
    return np.zeros(0, dtype=np.int64)


def _empty(*shape: int) -> Callable[[], Array]:
    return lambda: np.zeros((0, *shape))


@dataclass(frozen=True)
class Inputs:
    """What one vehicle's engine takes in a run; each stream in the order of its stamps.

    Attributes
    ----------
    imu_stamps_ns, omega_ib_b, f_b : (n,), (n, 3), (n, 3) arrays
        Ends of the intervals; rate [rad/s] and specific force [m/s^2].
    dvl_stamps_ns, dvl_v_m, dvl_covariance_m, dvl_valid : (d,), (d, 3), (d, 3, 3), (d,) arrays
        Pings: velocity over ground [m/s], instrument axes; whether there was bottom lock.
    depth_stamps_ns, depth, depth_variance : (e,) arrays
        Depth below the sea surface [m], positive down, and variance [m^2].
    fixes : tuple of Fix
        In any order: the engine takes them as they are received.
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

    def events(self) -> Iterator[Event]:
        """All events, in the total order."""
        imu = (
            ImuSample(int(s), k, self.omega_ib_b[k], self.f_b[k])
            for k, s in enumerate(self.imu_stamps_ns)
        )
        dvl = (
            DvlPing(int(s), k, bool(self.dvl_valid[k]), self.dvl_v_m[k], self.dvl_covariance_m[k])
            for k, s in enumerate(self.dvl_stamps_ns)
        )
        depth = (
            DepthSample(int(s), k, float(self.depth[k]), float(self.depth_variance[k]))
            for k, s in enumerate(self.depth_stamps_ns)
        )
        fixes = sorted(self.fixes, key=lambda fix: fix.key)
        return heapq.merge(imu, depth, dvl, fixes, key=lambda event: event.key)


@dataclass(frozen=True)
class Track:
    """Estimates of a run, one row each.

    Attributes
    ----------
    stamps_ns : (k,) array
    r_e, v_G : (k, 3) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G : (k, 3, 3) array
    P : (k, 24, 24) array
        Covariance of the error state.
    sensor_errors : (k, 15) array
        Gyro bias, accelerometer bias, DVL scale, DVL Markov velocity, USBL bias as estimated.
    """

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    sensor_errors: Array


@dataclass(frozen=True)
class Result:
    """What a run gave: the track, the receipts and why the filter stopped, if it did."""

    track: Track
    receipts: tuple[Receipt, ...]
    divergence: str


def run(params: EngineParams, inputs: Inputs) -> Result:
    """Run an engine over the inputs; an estimate every ``params.output_period_s``."""
    engine = Engine(params)
    estimates: list[Estimate] = []
    receipts: list[Receipt] = []

    def keep(outputs: Iterator[Output]) -> None:
        for output in outputs:
            if isinstance(output, Estimate):
                estimates.append(output)
            else:
                receipts.append(output)

    for event in inputs.events():
        keep(engine.process(event))
    keep(engine.finish())
    return Result(_track(estimates), tuple(receipts), engine.divergence)


def _track(estimates: list[Estimate]) -> Track:
    n = len(estimates)
    track = Track(
        np.array([e.stamp_ns for e in estimates], dtype=np.int64),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3, 3)),
        np.empty((n, 24, 24)),
        np.empty((n, 15)),
    )
    for i, e in enumerate(estimates):
        track.r_e[i], track.v_G[i], track.C_b_G[i], track.P[i] = e.r_e, e.v_G, e.C_b_G, e.P
        track.sensor_errors[i] = np.concatenate(
            [e.gyro_bias_b, e.accel_bias_b, e.dvl_scale_m, e.dvl_markov_m, e.usbl_bias_a]
        )
    return track
