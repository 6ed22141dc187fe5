"""Sensor data of a whole run, as arrays, in the streams of station mode's filter."""

from __future__ import annotations

import numpy as np

from ...arrays import Ints
from ...kernels.station import run as run_kernels
from ...kernels.station import state as ss
from ..driver import Adaptation, Driver
from ..events import Event, ImuSample
from ..inputs import StationInputs, at_least_one, new_seconds, rows_of
from ..params import EngineParams
from ..refusals import usable_control, usable_depth, usable_imu
from .filter import StationFilter
from .fusion import StationFusion
from .identify import PERIOD_NS


class StationArrays:
    """Inputs of a run in station mode, split into arrays for the compiled loop and single events.

    Parameters
    ----------
    params : EngineParams
    inputs : StationInputs
    rows : Rows
        Rows of output that the loop writes.
    """

    filter: StationFilter
    takes_fixes = False

    def __init__(self, params: EngineParams, inputs: StationInputs, rows: ss.Rows) -> None:
        x, self._rows = inputs, rows
        self._next = 0  # sample that the identification gets next
        self._thrust = np.zeros(3)
        imu, _ = usable_imu(params, x.imu_stamps_ns, x.omega_ib_b, x.C_b_G)
        control = usable_control(params, x.force_b)
        depth = usable_depth(params, x.depth, x.depth_variance)
        self.first = x.imu_sample(int(np.argmax(imu))) if imu.any() else None
        if self.first is not None:  # what comes before the state goes the engine's way
            control &= x.control_stamps_ns >= self.first.stamp_ns
            depth &= x.depth_stamps_ns >= self.first.stamp_ns
        self.unusable: list[Event] = [
            *(x.imu_sample(int(k)) for k in np.flatnonzero(~imu)),
            *(x.control_sample(int(k)) for k in np.flatnonzero(~control)),
            *(x.depth_sample(int(k)) for k in np.flatnonzero(~depth)),
        ]
        self._imu_stamps = rows_of(x.imu_stamps_ns, imu)
        self._omega_ib_b = rows_of(x.omega_ib_b, imu)
        self._C_b_G = rows_of(x.C_b_G, imu)
        self._control_stamps = rows_of(x.control_stamps_ns, control)
        self._force_b = rows_of(x.force_b, control)
        self._depth_stamps = rows_of(x.depth_stamps_ns, depth)
        self._depth = rows_of(x.depth, depth)
        self._depth_variance = rows_of(x.depth_variance, depth)

    def too_sure_ns(self, stamp_ns: int) -> int | None:
        """None: there are no pings in this mode."""

    def new_seconds_ns(self) -> list[int]:
        """Stamps of the AHRS samples with which a new second begins [ns]."""
        return new_seconds(self._imu_stamps)

    def start(self, driver: Driver | None, first: ImuSample) -> bool:
        """Hand the arrays to the filter started at the first sample; False without a filter."""
        if not isinstance(driver, StationFusion):
            return False
        self.filter = f = driver.filter
        before = int(f.streams.counts[1])  # a thrust from before the state
        self._thrust = f.streams.force_b[0].copy() if before else self._thrust
        stamps = np.concatenate([f.streams.control_stamps[:before], self._control_stamps])
        force_b = np.concatenate([f.streams.force_b[:before], self._force_b])
        counts = [len(self._imu_stamps), len(stamps), len(self._depth_stamps), 0]
        f.streams = f.streams._replace(
            counts=np.array(counts, dtype=np.int64),
            imu_stamps=self._imu_stamps,
            omega_ib_b=self._omega_ib_b,
            C_b_G=self._C_b_G.copy(),  # they are smoothed in place
            unexplained=np.zeros(len(self._imu_stamps)),
            control_stamps=at_least_one(stamps),
            force_b=at_least_one(force_b),
            depth_stamps=at_least_one(self._depth_stamps),
            depth=at_least_one(self._depth),
            depth_variance=at_least_one(self._depth_variance),
        )
        f.smooth(1)
        f.rows = self._rows
        f.rows.io[0] = first.stamp_ns
        return True

    def cursors(self) -> Ints:
        """How much of each stream is processed: the filter's counters, a copy."""
        return self.filter.bank.counters.copy()

    def hand_over(self, driver: Driver | None, cursors: Ints) -> None:
        """Go on with a filter that was restored, from where the lost one was in the streams."""
        if not isinstance(driver, StationFusion):
            return
        streams, self.filter = self.filter.streams, driver.filter
        f, counters = driver.filter, driver.filter.bank.counters
        f.streams, f.rows = streams, self._rows
        counters[ss.IMU], counters[ss.DEPTH] = cursors[ss.IMU], cursors[ss.DEPTH]
        counters[ss.CONTROL] = max(0, cursors[ss.CONTROL] - 1)  # the last one still holds
        streams.counts[ss.FIX - ss.IMU] = 0
        f.log.counts[0] = 0
        run_kernels.take_snapshot(f.bank, f.log)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample processed [ns]."""
        return self.filter.stamp_ns

    def advance(self, until_ns: int, until_rank: int) -> bool:
        """Process all data before a stamp [ns] and rank; True if the rows were full before."""
        return self.filter.advance(until_ns, until_rank) == ss.FULL

    def put_row(self) -> None:
        """Write the present estimate to the rows."""
        f = self.filter
        run_kernels.put_row(f.bank, f.settings, f.work, f.streams, self._rows)

    def log(self, adaptation: Adaptation, until_ns: int) -> None:
        """Pass attitude, rate and thrust before a stamp [ns] on to the identification."""
        stamps = self._imu_stamps
        while self._next < len(stamps) and stamps[self._next] < until_ns:
            k, now_ns = self._next, int(stamps[self._next])
            newest = int(np.searchsorted(self._control_stamps, now_ns)) - 1
            force_b = self._thrust if newest < 0 else self._force_b[newest]
            adaptation.log(now_ns, self._C_b_G[k], self._omega_ib_b[k], force_b)
            self._next = int(np.searchsorted(stamps, now_ns + PERIOD_NS))
