"""Whole runs of either mode: sensor data as arrays in, track and receipts out.

The engine is the same as in the node, down to the last bit; only the driver differs: valid IMU,
DVL, depth and thrust samples run in the compiled loop, with `back_propagate` and `clone` fixes
too; refused fixes and unusable samples go one by one through `Engine.process`. Experiments, Monte
Carlo runs and fast replays use this.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, overload

import numpy as np

from ..error_model import X
from ..errors import FilterDivergence
from ..identification.result import Identification
from ..order import NEVER_NS
from .collector import Collector
from .driver import Driver, WholeArrays
from .engine import Engine
from .events import Command, Event, ImuSample, InitialState, OrderKey, Rank
from .fixes_at_once import FixesAtOnce, diverge
from .health.conditions import Health
from .inputs import Inputs, Stamps, StationInputs
from .lever import Rates
from .looks import Look, looks_of
from .outputs import Receipt
from .params import EngineParams
from .pieces import SinsPieces, StationPieces
from .refusals import usable_imu
from .sins.whole import SinsArrays, Usable, usable_of
from .station.filter import StationFilter
from .station.fusion import StationFusion
from .station.whole import StationArrays
from .strategies import compiled
from .track import StationTrack, T, Track
from .verdicts import Verdict

__all__ = [
    'Inputs', 'Progress', 'Result', 'RowSink', 'Stamps', 'StationInputs', 'StationTrack', 'Track',
    'run',
]  # fmt: skip


class Record(Protocol):
    """Interface of what records a filter for a smoother (`sins.tape`, `station.recorded`)."""

    def make(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> Driver:
        """Filter that is recorded, as of `driver.Make`."""

    def take(self) -> None:
        """Copy what was logged since the last call."""


Progress = Callable[[float], None]
"""Called with the share of the run that is done."""
RowSink = Callable[[Track], None]
"""Called with the rows of a run some hundred at a time; they are overwritten after the call."""

_END_NS = NEVER_NS - 1


@dataclass(frozen=True)
class Result(Generic[T]):
    """Result of a run: track, receipts, identifications, and the reason if the filter stopped.

    The track is empty where a sink got its rows; ``divergence`` is empty where nothing stopped.
    """

    track: T
    receipts: Sequence[Receipt]
    divergence: str
    verdicts: Mapping[Verdict, int] = field(default_factory=dict)
    identifications: tuple[Identification, ...] = ()
    health: tuple[Health, ...] = ()
    """Once a second, of a run event by event; of a compiled run as often as was asked for."""


@overload
def run(
    params: EngineParams,
    inputs: Inputs,
    *,
    commands: Sequence[Command] = (),
    progress: Progress | None = None,
    one_by_one: bool = False,
    sink: RowSink | None = None,
    derived: bool = False,
    states: int = ...,
    look_every_s: float = 0.0,
    tape: Record | None = None,
    imu_lever_b: Sequence[float] = ...,
    usable: Usable | None = ...,
) -> Result[Track]: ...


@overload
def run(
    params: EngineParams,
    inputs: StationInputs,
    *,
    commands: Sequence[Command] = (),
    progress: Progress | None = None,
    one_by_one: bool = False,
    sink: Callable[[StationTrack], None] | None = None,
    look_every_s: float = 0.0,
    tape: Record | None = None,
) -> Result[StationTrack]: ...


def run(
    params: EngineParams,
    inputs: Inputs | StationInputs,
    *,
    commands: Sequence[Command] = (),
    progress: Progress | None = None,
    one_by_one: bool = False,
    sink: Callable[[Any], None] | None = None,
    derived: bool = False,
    states: int = X.size,
    look_every_s: float = 0.0,
    tape: Record | None = None,
    imu_lever_b: Sequence[float] = (0.0, 0.0, 0.0),
    usable: Usable | None = None,
) -> Result[Any]:
    """Track and receipts of a run over the inputs; an estimate every ``params.output_period_s``.

    Parameters
    ----------
    params : EngineParams
        Of the mode that the inputs are for.
    inputs : Inputs or StationInputs
    commands : sequence of Command, optional
        Only IDENTIFY and SHUTDOWN: a reset would begin another run.
    progress : callable, optional
    one_by_one : bool
        Process event by event, as a node does: slower, the same bits.
    sink : callable, optional
        Gets the rows instead of the result: half a day of covariances does not fit in memory.
    derived : bool
        Replace the covariances in the rows by the columns that nav/state publishes, derived from
        state and covariance (`nav_columns`); not in station mode.
    states : int
        Leading states of which the track has the covariance, 9 of attitude, velocity and position:
        all 24 are 2 GB for 12 h at 10 Hz. Not in station mode.
    look_every_s : float
        How often the watchdog looks at a compiled run (whole seconds); 0 for never.
    tape : Record, optional
        Records the filter of a compiled run, also at each look, which finds no health then.
        Nothing is identified.
    imu_lever_b : sequence of float, optional
        IMU from base_link, body axes [m]: parameters and track are of base_link.
    usable : Usable, optional
        What `usable_of` has found for these inputs and the limits of these parameters.
    """
    make = tape.make if tape is not None else None
    engine = Engine(params, make, imu_lever_b=imu_lever_b)
    if tape is not None:
        engine.adaptation = None
    health: list[Health] = []
    collector: Collector[Any]
    # What is copied anyway is written to rows that stay in a cache.
    room = _outputs_of(params, inputs) if sink is None and states == X.size else 0
    if isinstance(inputs, StationInputs):
        station = StationPieces(params, lambda: _station_filter(engine), room)
        collector = Collector(station, sink)
    else:
        pieces = SinsPieces(params, derived=derived, room=room, states=states)
        if engine.arm is not None:
            pieces.moved_by(engine.arm.lever_b, used_rates(params, inputs))
        collector = Collector(pieces, sink)
    if one_by_one or not compiled(params):
        ordered = sorted(commands, key=_key)
        for event in heapq.merge(inputs.events(), ordered, key=_key):
            collector.collect(engine.process(event))
            if engine.health is not None and (not health or engine.health is not health[-1]):
                health.append(engine.health)
        collector.collect(engine.finish())
    else:
        arrays = _arrays_of(params, inputs, collector, usable)
        looks = looks_of(arrays.new_seconds_ns(), look_every_s)
        events = [*inputs.fixes, *commands, *arrays.unusable, *looks]
        single = sorted(events, key=_key)
        _Driver(engine, arrays, single, collector, progress, health, tape).run()
    collector.drain()
    return Result(
        collector.track(),
        collector.receipts,
        engine.divergence,
        dict(engine.verdicts),
        tuple(collector.identifications),
        tuple(health),
    )


def used_rates(params: EngineParams, x: Inputs) -> Rates:
    """Rates at the stamps of the IMU samples that the engine uses."""
    used, _ = usable_imu(params, x.imu_stamps_ns, x.omega_ib_b, x.f_b)
    return Rates(x.imu_stamps_ns[used], x.omega_ib_b[used], params.imu_sample == 'mean')


def _outputs_of(params: EngineParams, inputs: Inputs | StationInputs) -> int:
    """How many estimates a run gives at most."""
    periods = inputs.imu_stamps_ns // round(params.output_period_s * 1e9)
    return int(np.count_nonzero(np.diff(periods))) + 2


def _key(event: Event | Look) -> OrderKey:
    return event.key


def _station_filter(engine: Engine) -> StationFilter:
    if not isinstance(engine.fusion, StationFusion):
        raise TypeError('parameters and inputs are not of the same mode')
    return engine.fusion.filter


def _arrays_of(
    params: EngineParams,
    inputs: Inputs | StationInputs,
    collector: Collector[Any],
    usable: Usable | None,
) -> WholeArrays:
    if isinstance(inputs, StationInputs):
        return StationArrays(params, inputs, collector.rows)
    return SinsArrays(params, usable or usable_of(params, inputs), collector.rows)


class _Driver:
    """Drives an engine: valid local samples in the compiled loop, other events one by one.

    Parameters
    ----------
    engine : Engine
    arrays : SinsArrays or StationArrays
    single : list of Event or Look
        Fixes, commands, unusable samples and looks, in the total order.
    collector : Collector
    progress : callable or None
    health : list of Health
        Gets the results of the looks.
    tape : Record or None
        Takes what was logged at each look.
    """

    def __init__(
        self,
        engine: Engine,
        arrays: WholeArrays,
        single: list[Event | Look],
        collector: Collector[Any],
        progress: Progress | None,
        health: list[Health],
        tape: Record | None,
    ) -> None:
        self._engine = engine
        self._tape = tape
        self._arrays = arrays
        self._single = single
        self._collector = collector
        self._progress = progress
        self._health = health
        self._started = False
        self._fixes: FixesAtOnce | None = None

    def run(self) -> None:
        """Drive the engine to the end of the inputs."""
        first, number, next_report = self._arrays.first, 0, 0
        while number < len(self._single):
            event = self._single[number]
            if first is not None and event.key > first.key:
                self._start(first)
                first = None
            number += self._several_fixes(number) or self._one(event)
            if self._progress is not None and number >= next_report:
                self._progress(number / len(self._single))
                next_report = number + len(self._single) // 100
        if first is not None:
            self._start(first)
        self._advance(_END_NS, int(Rank.IMU))
        self._flush(_END_NS)
        self._take()
        if self._progress is not None:
            self._progress(1.0)

    def _start(self, first: ImuSample) -> None:
        """Start the engine's filter at the first usable sample, and hand the arrays over to it."""
        self._collector.collect(self._engine.process(first))
        self._engine.due_ns = None  # from now on the compiled loop sees to estimates
        self._started = self._arrays.start(self._engine.fusion, first)
        if self._started and isinstance(self._arrays, SinsArrays) and self._arrays.takes_fixes:
            self._fixes = FixesAtOnce(self._engine, self._arrays, self._collector)

    def _take(self) -> None:
        if self._tape is not None:
            self._tape.take()

    @property
    def _running(self) -> bool:
        """Whether the filter holds the arrays and has not stopped."""
        return self._started and self._engine.navigating

    def _several_fixes(self, number: int) -> int:
        """Fuse fixes from an index on in the compiled loop; returns their number, perhaps 0."""
        if self._fixes is None or not self._engine.navigating:
            return 0
        return self._fixes.fuse(self._single, number)

    def _one(self, event: Event | Look) -> int:
        """Process one event, or look, after all data before it; returns 1."""
        # A sample whose stamp was there before comes after the first of them.
        rank = int(event.key[1]) + isinstance(event, ImuSample)
        self._advance(event.stamp_ns, rank)
        if isinstance(event, Look):
            if self._tape is not None:  # nobody reads the health of a run that is recorded
                self._take()
                return 1
            self._engine.too_sure_ns = self._arrays.too_sure_ns(event.stamp_ns)
            found = self._engine.look()
            self._health += [] if found is None else [found]
            return 1
        lost = self._engine.fusion
        cursors = self._arrays.cursors() if self._running else None
        self._collector.collect(self._engine.process(event))
        if cursors is not None and self._engine.fusion is not lost:
            self._arrays.hand_over(self._engine.fusion, cursors)
        return 1

    def _advance(self, stamp_ns: int, rank: int) -> None:
        """Process everything before a place in the order of events."""
        if not self._running:
            return
        engine, arrays, collector = self._engine, self._arrays, self._collector
        if engine.adaptation is not None:
            arrays.log(engine.adaptation, stamp_ns + (rank > int(Rank.IMU)))
        full = True
        while full:
            try:
                full = arrays.advance(stamp_ns, rank)
                if full:
                    collector.note(engine)
                    collector.drain()
            except FilterDivergence as error:
                collector.note(engine)
                diverge(engine, arrays, error, arrays.stamp_ns)
                if not self._running:
                    return
        self._flush(stamp_ns)
        engine.last_imu_ns = arrays.stamp_ns

    def _flush(self, stamp_ns: int) -> None:
        """Write the estimate that is due before a stamp."""
        if not self._running:
            return
        rows, collector = self._collector.rows, self._collector
        if 0 <= rows.io[0] < stamp_ns:
            if rows.io[1] >= len(rows.stamps):
                collector.note(self._engine)
                collector.drain()
            self._arrays.put_row()
        collector.note(self._engine)
