"""A whole run of station mode: sensor data as arrays in, the track and the receipts out.

The engine is the same as in the node, down to the last bit; only the driver differs: whatever
stands between two fixes goes through one compiled loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FilterDivergence
from ...kernels.station import run as run_kernels
from ...kernels.station import state as ss
from ...order import NEVER_NS
from ..engine import Engine
from ..events import (
    Array,
    Command,
    Estimate,
    Event,
    Identification,
    ImuSample,
    ModelEstimate,
    Output,
    Rank,
    Receipt,
    Verdict,
    no_local_statistics,
)
from ..params import EngineParams
from . import arrays
from .filter import StationFilter, model_of
from .fusion import StationFusion
from .identify import PERIOD_NS
from .inputs import Stamps, StationInputs

__all__ = ['Result', 'StationInputs', 'Track', 'run']

_ROWS = 512


@dataclass(frozen=True)
class Track:
    """Estimates of a run, one row each.

    Attributes
    ----------
    stamps_ns : (k,) array
    r_e, v_G : (k, 3) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G : (k, 3, 3) array
    P : (k, 9, 9) array
        Covariance of attitude, velocity and position errors.
    x, P_x : (k, 12), (k, 12, 12) arrays
        State of kernels.station.state and its covariance.
    walk : (k,) array
        Density q_c in use [m^2/s^3].
    weight : (k, B) array
        Of the bank's members.
    tally : (k, 2, 3) array
        Local statistics since the row before.
    fixes : (k, 3) array
        Fixes received, fixes fused, newest validity [ns].
    """

    stamps_ns: Stamps
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    x: Array
    P_x: Array
    walk: Array
    weight: Array
    tally: Array
    fixes: Stamps

    def model(self, k: int, params: EngineParams) -> ModelEstimate:
        """Vehicle and water of a row."""
        return model_of(self.x[k], self.P_x[k], float(self.walk[k]), params.model_speed)


@dataclass(frozen=True)
class Result:
    """What a run gave: the track, receipts, identifications, and why the filter stopped."""

    track: Track
    receipts: tuple[Receipt, ...]
    identifications: tuple[Identification, ...]
    divergence: str
    verdicts: Mapping[Verdict, int] = field(default_factory=dict)


def run(
    params: EngineParams,
    inputs: StationInputs,
    *,
    commands: Sequence[Command] = (),
    one_by_one: bool = False,
) -> Result:
    """Run an engine over the inputs; an estimate every ``params.output_period_s``.

    Parameters
    ----------
    params : EngineParams
        With mode station.
    inputs : StationInputs
    commands : sequence of Command, optional
        Only IDENTIFY and SHUTDOWN: a reset would begin another run.
    one_by_one : bool
        Take event by event, as a node does: slower, the same bits.
    """
    engine = Engine(params)
    collector = _Collector(engine, len(arrays.densities(params)))
    if one_by_one:
        events = sorted([*inputs.events(), *commands], key=lambda event: event.key)
        for event in events:
            collector.take(engine.process(event))
        collector.take(engine.finish())
    else:
        _Compiled(engine, inputs, commands, collector).run()
    return Result(
        collector.track(),
        tuple(collector.receipts),
        tuple(collector.identifications),
        engine.divergence,
        dict(engine.verdicts),
    )


_NAMES = ('stamps', 'r_e', 'v_G', 'C_b_G', 'P', 'x', 'P_x', 'walk', 'weight', 'tally')


class _Collector:
    """Rows of the track in chunks, and what the engine gives besides."""

    def __init__(self, engine: Engine, members: int) -> None:
        self._engine = engine
        self.rows = arrays.make_rows(_ROWS, members)
        self._chunks: list[tuple[NDArray[Any], ...]] = []
        self._fixes: list[tuple[int, int, int]] = []
        self.tally = no_local_statistics()
        self.receipts: list[Receipt] = []
        self.identifications: list[Identification] = []

    def take(self, outputs: Iterator[Output]) -> None:
        """Take what the engine gives by itself."""
        for output in outputs:
            if isinstance(output, Receipt):
                self.receipts.append(output)
            elif isinstance(output, Identification):
                self.identifications.append(output)
            elif isinstance(output, Estimate):
                self._keep(_filter(self._engine).row, 1)

    def drain(self) -> None:
        """Pass on the rows that the compiled loop wrote."""
        n = int(self.rows.io[1])
        if n:
            self._keep(self.rows, n)
            self.rows.io[1] = 0

    def _keep(self, rows: ss.Rows, n: int) -> None:
        self._chunks.append(tuple(getattr(rows, name)[:n].copy() for name in _NAMES))
        self.tally = self.tally + np.sum(rows.tally[:n], axis=0)
        self._fixes += [self._engine.fix_counts()] * n

    def track(self) -> Track:
        """Return all rows."""
        self.drain()
        if not self._chunks:
            self._chunks.append(tuple(getattr(self.rows, name)[:0] for name in _NAMES))
        columns = zip(*self._chunks, strict=True)
        stamps, r_e, v_G, C_b_G, P, x, P_x, walk, weight, tally = map(np.concatenate, columns)
        fixes = np.array(self._fixes, dtype=np.int64).reshape(-1, 3)
        return Track(stamps, r_e, v_G, C_b_G, P, x, P_x, walk, weight, tally, fixes)


def _filter(engine: Engine) -> StationFilter:
    if not isinstance(engine.fusion, StationFusion):
        raise TypeError('this run is not of station mode')
    return engine.fusion.filter


class _Compiled:
    """Drives an engine with arrays: fixes and whatever is odd in Python, the rest compiled."""

    def __init__(
        self,
        engine: Engine,
        inputs: StationInputs,
        commands: Sequence[Command],
        collector: _Collector,
    ) -> None:
        self._engine = engine
        self._inputs = x = inputs
        self._collector = collector
        self._started = False
        self._next = 0  # sample that the identification is given next
        self._thrust = np.zeros(3)
        imu = _finite(x.omega_ib_b) & _finite(x.C_b_G)
        good = np.flatnonzero(imu)
        imu[good[1:][np.diff(x.imu_stamps_ns[good]) == 0]] = False  # a stamp twice
        self._first = int(good[0]) if len(good) else None
        control = _finite(x.force_b)
        depth = np.isfinite(x.depth) & np.isfinite(x.depth_variance) & (x.depth_variance > 0.0)
        if self._first is not None:  # what comes before the state goes the engine's way
            control &= x.control_stamps_ns >= x.imu_stamps_ns[self._first]
            depth &= x.depth_stamps_ns >= x.imu_stamps_ns[self._first]
        self._kept = replace(
            x,
            imu_stamps_ns=_rows_of(x.imu_stamps_ns, imu),
            omega_ib_b=_rows_of(x.omega_ib_b, imu),
            C_b_G=_rows_of(x.C_b_G, imu),
            control_stamps_ns=_rows_of(x.control_stamps_ns, control),
            force_b=_rows_of(x.force_b, control),
            depth_stamps_ns=_rows_of(x.depth_stamps_ns, depth),
            depth=_rows_of(x.depth, depth),
            depth_variance=_rows_of(x.depth_variance, depth),
        )
        self._odd: list[Event] = sorted(
            [
                *x.fixes,
                *commands,
                *(x.imu_sample(int(k)) for k in np.flatnonzero(~imu)),
                *(x.control_sample(int(k)) for k in np.flatnonzero(~control)),
                *(x.depth_sample(int(k)) for k in np.flatnonzero(~depth)),
            ],
            key=lambda event: event.key,
        )

    def run(self) -> None:
        """Drive the engine to the end of the inputs."""
        first = None if self._first is None else self._inputs.imu_sample(self._first)
        for event in self._odd:
            if first is not None and not self._started and event.key > first.key:
                self._start(first)
            # A sample whose stamp was there before comes after the first of them.
            rank = int(event.key[1]) + isinstance(event, ImuSample)
            self._advance(event.stamp_ns, rank)
            self._collector.take(self._engine.process(event))
        if first is not None and not self._started:
            self._start(first)
        self._advance(NEVER_NS - 1, int(Rank.IMU))
        self._flush(NEVER_NS - 1)
        gap_ns = self._engine.params.max_imu_gap_s * 1e9
        gaps = int(np.sum(np.diff(self._kept.imu_stamps_ns) > gap_ns))
        statistics = self._collector.tally
        if self._engine.navigating:
            statistics = statistics + _filter(self._engine).bank.tally
        self._engine.count_locals(statistics, gaps)

    def _start(self, first: ImuSample) -> None:
        """The engine makes its filter at the first sample; hand it the arrays."""
        self._started = True
        self._collector.take(self._engine.process(first))
        self._engine.pass_on_estimates()
        if not self._engine.navigating:
            return
        f, x = _filter(self._engine), self._kept
        before = int(f.streams.counts[1])  # a thrust from before the state
        self._thrust = f.streams.force_b[0].copy() if before else self._thrust
        stamps = np.concatenate([f.streams.control_stamps[:before], x.control_stamps_ns])
        force_b = np.concatenate([f.streams.force_b[:before], x.force_b])
        counts = [len(x.imu_stamps_ns), len(stamps), len(x.depth_stamps_ns), 0]
        f.streams = f.streams._replace(
            counts=np.array(counts, dtype=np.int64),
            imu_stamps=x.imu_stamps_ns,
            omega_ib_b=x.omega_ib_b,
            C_b_G=x.C_b_G.copy(),
            control_stamps=_at_least_one(stamps),
            force_b=_at_least_one(force_b),
            depth_stamps=_at_least_one(x.depth_stamps_ns),
            depth=_at_least_one(x.depth),
            depth_variance=_at_least_one(x.depth_variance),
        )
        f.smooth(1)
        f.rows = self._collector.rows
        f.rows.io[0] = first.stamp_ns

    def _advance(self, stamp_ns: int, rank: int) -> None:
        """Take everything before a place in the order of events."""
        if not self._started or not self._engine.navigating:
            return
        f = _filter(self._engine)
        self._log(stamp_ns + (rank > int(Rank.IMU)))
        try:
            while f.advance(stamp_ns, rank) == ss.FULL:
                self._collector.drain()
        except FilterDivergence as error:
            self._engine.diverge(str(error), f.stamp_ns)
            return
        self._flush(stamp_ns)
        self._engine.note_imu(f.stamp_ns)

    def _log(self, until_ns: int) -> None:
        """Give the identification what it would have been given sample by sample."""
        adaptation, x = self._engine.adaptation, self._kept
        if adaptation is None:
            return
        while self._next < len(x.imu_stamps_ns) and x.imu_stamps_ns[self._next] < until_ns:
            k, now_ns = self._next, int(x.imu_stamps_ns[self._next])
            newest = int(np.searchsorted(x.control_stamps_ns, now_ns)) - 1
            force_b = self._thrust if newest < 0 else x.force_b[newest]
            adaptation.log(now_ns, x.C_b_G[k], x.omega_ib_b[k], force_b)
            self._next = int(np.searchsorted(x.imu_stamps_ns, now_ns + PERIOD_NS))

    def _flush(self, stamp_ns: int) -> None:
        """Give what is due before a stamp; fixes count for the rows that come after them."""
        if not self._started or not self._engine.navigating:
            return
        f, rows = _filter(self._engine), self._collector.rows
        if 0 <= rows.io[0] < stamp_ns:
            if rows.io[1] >= _ROWS:
                self._collector.drain()
            run_kernels.put_row(f.bank, f.settings, f.work, f.streams, rows)
        self._collector.drain()


def _finite(values: Array) -> NDArray[np.bool_]:
    finite = np.isfinite(values)
    if finite.all():  # nearly always, and ten times as fast as row by row
        return np.ones(len(values), dtype=bool)
    return np.asarray(finite.reshape(len(values), -1).all(axis=1))


def _rows_of(values: NDArray[Any], keep: NDArray[np.bool_]) -> NDArray[Any]:
    return np.ascontiguousarray(values if keep.all() else values[keep])


def _at_least_one(values: NDArray[Any]) -> NDArray[Any]:
    """Return the array, or one row of zeros for an empty one: a ring has a length."""
    return values if len(values) else np.zeros((1, *values.shape[1:]), dtype=values.dtype)
