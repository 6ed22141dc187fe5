"""Sensor data of a whole run, as arrays, in the streams of the SINS filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Array
from ...kernels.sins import events as fe
from ...kernels.sins import run as filter_run
from ...kernels.sins import state as fs
from ...kernels.sins.output import Rows
from ...kernels.sins.rings import Streams
from ...kernels.sins.update import Ints
from ..driver import Adaptation, Driver
from ..events import Event, Fix, ImuSample
from ..inputs import Inputs, Stamps, at_least_one, new_seconds, rows_of
from ..params import EngineParams
from ..plausibility import are_too_sure, widened_pings
from ..refusals import usable_control, usable_depth, usable_dvl, usable_heading, usable_imu
from ..results import Outcome
from .filter import NavigationFilter
from .fusion import Fusion
from .streams import room_for_fixes


@dataclass(frozen=True)
class Usable:
    """Samples of a run that a filter can use, as columns, and the others one by one.

    Attributes
    ----------
    first : ImuSample or None
        First usable sample of the IMU, at which the state starts.
    unusable : list of Event
    columns : mapping of str to array
        Of `Streams`, but for counts and fixes.
    imu, depths, pings, controls, headings : int
        Number of usable samples.
    too_sure_ns : (n,) array
        Stamps of the pings that state less noise than pings have.
    """

    first: ImuSample | None
    unusable: list[Event]
    columns: Mapping[str, Any]
    imu: int
    depths: int
    pings: int
    controls: int
    headings: int
    too_sure_ns: Stamps


def usable_of(params: EngineParams, inputs: Inputs) -> Usable:
    """Samples of a run that a filter can use; of several runs over them, found once."""
    x = inputs
    imu, refused = usable_imu(params, x.imu_stamps_ns, x.omega_ib_b, x.f_b)
    dvl = x.dvl_valid & usable_dvl(params, x.dvl_valid, x.dvl_v_m, x.dvl_covariance_m)
    water = np.zeros(len(dvl), dtype=bool)
    if len(x.dvl_water):
        dvl &= ~x.dvl_water
        if params.uses_water_track:
            every = np.ones(len(dvl), dtype=bool)
            water = x.dvl_water & usable_dvl(params, every, x.dvl_v_m, x.dvl_covariance_m)
    dvl |= water
    depth = usable_depth(params, x.depth, x.depth_variance)
    control = usable_control(params, x.control_force_b, x.control_torque_b)
    heading = usable_heading(x.headings, x.heading_up_b)
    unusable: list[Event] = [
        *(
            replace(x.imu_sample(int(k)), refused=refused.get(int(k)))
            for k in np.flatnonzero(~imu)
        ),
        *(x.dvl_ping(int(k)) for k in np.flatnonzero(~dvl)),
        *(x.depth_sample(int(k)) for k in np.flatnonzero(~depth)),
        *(x.control_sample(int(k)) for k in np.flatnonzero(~control)),
        *(x.heading_sample(int(k)) for k in np.flatnonzero(~heading)),
    ]
    covariance_m = rows_of(x.dvl_covariance_m, dvl)
    columns = {
        'imu_stamps': rows_of(x.imu_stamps_ns, imu),
        'omega_ib_b': rows_of(x.omega_ib_b, imu),
        'f_b': rows_of(x.f_b, imu),
        'depth_stamps': rows_of(x.depth_stamps_ns, depth),
        'depth': rows_of(x.depth, depth),
        'depth_variance': rows_of(x.depth_variance, depth),
        'dvl_stamps': rows_of(x.dvl_stamps_ns, dvl),
        'dvl_v_m': rows_of(x.dvl_v_m, dvl),
        'dvl_covariance_m': widened_pings(covariance_m, params.dvl_sigma),
        'dvl_water': rows_of(water.astype(np.int64), dvl),
        'control_stamps': rows_of(x.control_stamps_ns, control),
        'control_force_b': rows_of(x.control_force_b, control),
        'heading_stamps': rows_of(x.heading_stamps_ns, heading),
        'headings': rows_of(x.headings, heading),
        'heading_up_b': rows_of(x.heading_up_b, heading),
    }
    return Usable(
        x.imu_sample(int(np.argmax(imu))) if imu.any() else None,
        unusable,
        {name: at_least_one(values) for name, values in columns.items()},
        imu=len(columns['imu_stamps']),
        depths=len(columns['depth_stamps']),
        pings=len(columns['dvl_stamps']),
        controls=len(columns['control_stamps']),
        headings=len(columns['heading_stamps']),
        too_sure_ns=columns['dvl_stamps'][are_too_sure(covariance_m)],
    )


class SinsArrays:
    """Inputs of a run in SINS mode, split into arrays for the compiled loop and single events.

    Parameters
    ----------
    params : EngineParams
    usable : Usable
        The inputs.
    rows : Rows
        Rows of output that the loop writes.
    """

    filter: NavigationFilter
    _fusion: Fusion

    def __init__(self, params: EngineParams, usable: Usable, rows: Rows) -> None:
        x, self._rows = usable, rows
        self.first, self.unusable = x.first, x.unusable
        self._depths, self._pings = x.depths, x.pings
        self._controls, self._headings = x.controls, x.headings
        self._too_sure_ns = x.too_sure_ns
        controls = x.controls if params.model_aiding else 0
        headings = x.headings if params.uses_heading else 0
        counts = [x.imu, x.depths, x.pings, 0, controls, headings]
        counted = np.array(counts, dtype=np.int64)
        self._streams = Streams(counts=counted, **x.columns, **room_for_fixes())

    def new_seconds_ns(self) -> list[int]:
        """Stamps of the IMU samples with which a new second begins [ns]."""
        return new_seconds(self._streams.imu_stamps)

    def too_sure_ns(self, stamp_ns: int) -> int | None:
        """When a ping last stated less noise than pings have, until a stamp [ns]; or None."""
        before = int(np.searchsorted(self._too_sure_ns, stamp_ns, side='right'))
        return int(self._too_sure_ns[before - 1]) if before else None

    def start(self, driver: Driver | None, first: ImuSample) -> bool:
        """Hand the arrays to the filter started at the first sample; False without a filter."""
        if not isinstance(driver, Fusion):
            return False
        self._fusion = driver
        self.filter = f = driver.filter
        f.streams = x = self._streams
        counters, now_ns = f.state.counters, first.stamp_ns
        counters[fs.IMU] = 1
        counters[fs.DEPTH] = int(np.searchsorted(x.depth_stamps[: self._depths], now_ns))
        counters[fs.DVL] = int(np.searchsorted(x.dvl_stamps[: self._pings], now_ns))
        counters[fs.HEADING] = int(np.searchsorted(x.heading_stamps[: self._headings], now_ns))
        # The thrust of before the start still holds.
        before = int(np.searchsorted(x.control_stamps[: self._controls], now_ns))
        counters[fs.CONTROL] = max(0, before - 1)
        f.rows, io, output_ns = self._rows, self._rows.io, f.settings.output_ns
        io[0] = now_ns
        io[2] = (now_ns // output_ns + 1) * output_ns
        f.log.counts[1] = 0
        fe.take_snapshot(f.state, f.log)
        return True

    def cursors(self) -> Ints:
        """How much of each stream is processed: the filter's counters, a copy."""
        return self.filter.state.counters.copy()

    def hand_over(self, driver: Driver | None, cursors: Ints) -> None:
        """Go on with a filter that was restored, from where the lost one was in the streams."""
        if not isinstance(driver, Fusion):
            return
        self._fusion = driver
        self.filter = f = driver.filter
        f.streams, f.rows, counters = self._streams, self._rows, f.state.counters
        for k in (fs.IMU, fs.DEPTH, fs.DVL, fs.HEADING):
            counters[k] = cursors[k]
        counters[fs.CONTROL] = max(0, cursors[fs.CONTROL] - 1)  # the last one still holds
        f.streams.counts[fs.FIX - fs.IMU] = 0
        f.log.counts[1] = 0
        fe.take_snapshot(f.state, f.log)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample processed [ns]."""
        return self.filter.imu_stamp_ns

    def advance(self, until_ns: int, until_rank: int) -> bool:
        """Process all data before a stamp [ns] and rank; True if the rows were full before."""
        return self._fusion.advance(until_ns, until_rank) == fs.FULL

    def put_row(self) -> None:
        """Write the present estimate to the rows."""
        filter_run.put_row(self.filter.state, self.filter.settings, self._rows)

    def log(self, adaptation: Adaptation, until_ns: int) -> None:
        """Do nothing: there is no identification in this mode."""

    # -- fixes in the compiled loop ---------------------------------------------------------------

    @property
    def takes_fixes(self) -> bool:
        """Whether the compiled loop can fuse fixes, too."""
        return self._fusion.takes_fixes

    @property
    def fixes(self) -> int:
        """Number of fixes that the compiled loop has decided so far."""
        return int(self.filter.state.counters[fs.FIX])

    def put_fixes(self, fixes: Sequence[Fix]) -> None:
        """Append fixes to their stream, each at its stamp of reception."""
        for fix in fixes:
            self._fusion.put(fix)

    def settled(self, fixes: Sequence[Fix], outcomes: Array) -> None:
        """Tell the fusion of fixes that the loop has decided, with their rows of `decisions`."""
        self._fusion.settled(fixes, outcomes)

    def drop_fixes(self) -> None:
        """Remove the fixes from the stream that the loop has not processed."""
        self.filter.streams.counts[fs.FIX - fs.IMU] = self.fixes

    def decisions(self, first: int) -> tuple[Array, Ints]:
        """Outcomes (n, OUTCOME) and notes (n, 3) of the decided fixes, from an index on."""
        streams = self.filter.streams
        length, end = len(streams.fix_stamps), self.fixes
        begin = first % length
        if begin + end - first <= length:  # in one piece, nearly always
            here = slice(begin, begin + end - first)
            return streams.fix_outcomes[here].copy(), streams.fix_notes[here].copy()
        places = np.arange(first, end) % length
        return streams.fix_outcomes[places], streams.fix_notes[places]

    def outcome_of(self, row: Array) -> Outcome:
        """Outcome of a fix from its row of `decisions`."""
        return self.filter.outcome_of(row)
