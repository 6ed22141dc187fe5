"""Smooths the follower of a bag, of this project or mapped; the result as series and as a bag."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine import station_smoothing as of_station
from polar_nav_core.engine.health.conditions import Health
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.smoothed import MOST_PASSES, Smoothed
from polar_nav_core.errors import ConfigError
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters.mapping import Mapping as Sources

from ..bags import Bag
from ..foreign.lever import at_the_imu
from ..foreign.load import Loaded, load
from ..foreign.sources import Source
from ..replay.arrays import StationArrays
from ..replay.by_message import parameters
from ..replay.plain import plain_arrays, whole_arrays
from ..replay.result import LOOK_EVERY_S
from ..replay.station_run import as_track, model_run, replay_station
from ..scoring import Comparison, compare
from ..scoring.verdicts import FUSED, VerdictSeries, count_verdicts
from ..series.estimates import EstimateRows, receipts_of
from ..series.model import ModelRun
from ..series.run import FILTER, SMOOTHER, RunSeries
from ..series.vehicle import EstimateSeries, ReceiptRecord, TruthSeries
from .doubts import Doubts, doubts_of

Progress = Callable[[float], None]
AnySmoothed: TypeAlias = Smoothed[engine_run.Track] | Smoothed[engine_run.StationTrack]
_NOT_TESTED = 'constants are tested by `./polar smooth` in mode sins only'


def _to_base_link(
    params: EngineParams, inputs: Inputs, imu_lever_b: tuple[float, float, float]
) -> Callable[[engine_run.Track], engine_run.Track] | None:
    """Function that moves estimates of the IMU's point to base_link; None where they are one.

    It leaves out estimates between IMU samples, in a gap: a rate is needed to move them.
    """
    if not any(imu_lever_b):
        return None
    rates = engine_run.used_rates(params, inputs)

    def moved(piece: engine_run.Track) -> engine_run.Track:
        stamps = rates.stamps_ns
        place = np.searchsorted(stamps, piece.stamps_ns).clip(max=len(stamps) - 1)
        at = stamps[place] == piece.stamps_ns
        columns = {
            name: value[at] if len(value) == len(at) else value
            for name, value in vars(piece).items()
        }
        return engine_run.Track(**columns).at_base_link(
            np.asarray(imu_lever_b), rates, params.gyro_noise_density
        )

    return moved


@dataclass(frozen=True)
class How:
    """How to smooth.

    Attributes
    ----------
    every_s : float
        From one estimate to the next [s].
    passes : int
        Most passes.
    tested : bool
        Whether constants that the recording shows to be stated wrong are looked for.
    """

    every_s: float = 1.0
    passes: int = MOST_PASSES
    tested: bool = True


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """Filtered and smoothed estimates of one vehicle.

    Attributes
    ----------
    path : Path
        Of the bag.
    vehicle : str
    params : FollowerParams
        Of both.
    filtered, smoothed : EstimateSeries
    track : Track
        The smoothed one, with derived columns.
    found : Smoothed
        With what the innovations say of common errors.
    filter_receipts : sequence of ReceiptRecord
        Of the filter, fixes as they came.
    truth : TruthSeries or None
    health : sequence of Health
        Of the filter: what contradicts its model contradicts the smoother's, which is surer.
    doubts : Doubts
        Constants that the recording shows to be stated wrong; none in station mode.
    models : mapping of str to ModelRun
        Current and drag in station mode, of filter and smoother.
    """

    path: Path
    vehicle: str
    params: FollowerParams
    filtered: EstimateSeries
    smoothed: EstimateSeries
    track: engine_run.Track
    found: AnySmoothed
    filter_receipts: Sequence[ReceiptRecord]
    truth: TruthSeries | None
    health: Sequence[Health] = ()
    doubts: Doubts = field(default_factory=lambda: Doubts(why_not=_NOT_TESTED))
    models: Mapping[str, ModelRun] = field(default_factory=dict)

    @property
    def fixes_used(self) -> dict[str, tuple[int, int]]:
        """How many fixes filter and smoother used, and of how many."""
        receipts = {FILTER: self.filter_receipts, SMOOTHER: receipts_of(self.found.receipts)}
        counts = {name: count_verdicts(VerdictSeries.of(some)) for name, some in receipts.items()}
        return {name: (c.by_verdict.get(FUSED, 0), c.total) for name, c in counts.items()}

    @property
    def comparison(self) -> Comparison | None:
        """Scores of filter and smoother; None without a truth."""
        if self.truth is None:
            return None
        return compare(
            {
                FILTER: (self.truth, self.filtered, self.filter_receipts),
                SMOOTHER: (self.truth, self.smoothed, receipts_of(self.found.receipts)),
            },
            models=self.models,
        )


def stated_sigma(series: EstimateSeries) -> float:
    """Median stated 1-sigma of the horizontal position [m]; NaN without an estimate."""
    variance = series.P_position_G[:, 0, 0] + series.P_position_G[:, 1, 1]
    return float(np.sqrt(np.median(variance))) if len(variance) else float('nan')


def smooth_bag(
    bag: Bag,
    vehicle: str,
    *,
    configuration: str | None,
    changes: Mapping[str, Any],
    how: How,
    progress: Progress,
) -> SmoothedRun:
    """Smoothed run of a follower's own recording.

    Raises
    ------
    ConfigError
        As `plain_arrays`.
    """
    arrays = whole_arrays(
        bag, vehicle, 'smoothed', truth=True, progress=lambda share: progress(0.3 * share)
    )
    params = parameters(arrays.params, configuration, changes)
    if isinstance(arrays, StationArrays):
        return _of_station(arrays, params, how, _later(progress, 0.3))
    inputs = arrays.inputs(params).inputs
    found = _both(params, params, inputs, vehicle, how, (0.0, 0.0, 0.0), _later(progress, 0.3))
    return _run(bag.path, vehicle, params, found, arrays.truth)


def smoothed_series(bag: Bag, vehicle: str, progress: Progress | None = None) -> RunSeries:
    """Smoothed estimates of a follower's own recording, by its default configuration.

    Raises
    ------
    ConfigError
        As `smooth_bag`.
    """
    run = smooth_bag(
        bag,
        vehicle,
        configuration='default',
        changes={},
        how=How(tested=False),
        progress=progress or (lambda _: None),
    )
    return RunSeries(
        estimates=run.smoothed,
        receipts=receipts_of(run.found.receipts),
        divergence=run.found.divergence,
        model=run.models.get(SMOOTHER),
    )


def recorded_inputs(bag: Bag, vehicle: str) -> tuple[FollowerParams, Inputs]:
    """Default filter of a follower of mode sins, and its own recording.

    Raises
    ------
    ConfigError
        As `plain_arrays`.
    """
    arrays = plain_arrays(bag, vehicle, 'timed')
    params = parameters(arrays.params, 'default', {})
    return params, arrays.inputs(params).inputs


def mapped_inputs(
    source: Source, mapping: Sources, accept: Iterable[str]
) -> tuple[FollowerParams, Inputs]:
    """Filter of a mapping, at the point of the IMU, and a bag of any origin."""
    loaded = _loaded(source, mapping, accept)
    return at_the_imu(loaded), loaded.inputs


def _loaded(source: Source, mapping: Sources, accept: Iterable[str]) -> Loaded:
    loaded = load(source, mapping, accept)
    if not len(loaded.inputs.imu_stamps_ns):
        raise ConfigError(f'{source.path}: no IMU sample after the start')
    return loaded


def smooth_mapped(
    source: Source,
    mapping: Sources,
    *,
    accept: Iterable[str],
    how: How,
    progress: Progress,
) -> SmoothedRun:
    """Smoothed run of a bag of any origin."""
    loaded = _loaded(source, mapping, accept)
    params = at_the_imu(loaded)
    vehicle, lever_b = mapping.vehicle, mapping.imu.lever_b
    found = _both(loaded.params, params, loaded.inputs, vehicle, how, lever_b, progress)
    return _run(Path(source.path), vehicle, params, found, loaded.truth)


_Both: TypeAlias = tuple[
    EstimateSeries,
    EstimateSeries,
    engine_run.Track,
    Smoothed[engine_run.Track],
    Sequence[ReceiptRecord],
    Sequence[Health],
    Doubts,
]


def _run(
    path: Path, vehicle: str, params: FollowerParams, both: _Both, truth: TruthSeries | None
) -> SmoothedRun:
    filtered, smoothed, track, found, receipts, health, doubts = both
    return SmoothedRun(
        path, vehicle, params, filtered, smoothed, track, found, receipts, truth, health, doubts
    )


def _of_station(
    arrays: StationArrays, params: FollowerParams, how: How, progress: Progress
) -> SmoothedRun:
    """Filtered and smoothed estimates of a vehicle located by a station."""
    of_station.in_order(params)  # refuses before a long run
    filtered = replay_station(arrays, params)
    progress(0.2)
    found = smoothing.smooth(
        params,
        arrays.inputs(params),
        every_s=how.every_s,
        passes=how.passes,
        progress=_later(progress, 0.2),
    )
    track = as_track(found.track)
    smoothed = EstimateRows(params, len(track.stamps_ns))
    smoothed.append(track)
    models = {FILTER: filtered.model, SMOOTHER: model_run(found.track, (), params)}
    return SmoothedRun(
        arrays.bag.path,
        arrays.vehicle,
        params,
        filtered.estimates,
        smoothed.series(arrays.vehicle),
        track,
        found,
        filtered.receipts,
        arrays.truth,
        filtered.health,
        models={name: model for name, model in models.items() if model is not None},
    )


def _later(progress: Progress, start: float) -> Progress:
    return lambda share: progress(start + (1.0 - start) * share)


def _both(
    stated: FollowerParams,
    params: FollowerParams,
    inputs: Inputs,
    vehicle: str,
    how: How,
    imu_lever_b: tuple[float, float, float],
    progress: Progress,
) -> _Both:
    """Filtered and smoothed estimates of base_link; ``params`` are ``stated`` from the IMU."""
    smoothing.in_order(params)  # refuses before a long run
    stamps = inputs.imu_stamps_ns
    span_s = float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0
    expected = min(int(span_s / params.output_period_s), len(stamps)) + 2
    rows = EstimateRows(params, expected)
    result = engine_run.run(
        stated,
        inputs,
        sink=rows.append,
        imu_lever_b=imu_lever_b,
        progress=lambda share: progress(0.2 * share),
        derived=True,
        look_every_s=LOOK_EVERY_S,
    )

    def again(
        params: EngineParams,
        inputs: Inputs,
        passes: int = 1,
        progress: Progress | None = None,
    ) -> Smoothed[engine_run.Track]:
        return smoothing.smooth(
            params,
            inputs,
            every_s=how.every_s,
            passes=passes,
            move=_to_base_link(params, inputs, imu_lever_b),
            progress=progress,
        )

    def series(track: engine_run.Track) -> EstimateSeries:
        smoothed = EstimateRows(params, len(track.stamps_ns))
        smoothed.append(track)
        return smoothed.series(vehicle)

    found = again(params, inputs, how.passes, lambda share: progress(0.2 + 0.7 * share))
    smoothed = series(found.track)
    doubts = Doubts(why_not=_NOT_TESTED)
    if how.tested:
        doubts = doubts_of(params, inputs, smoothed, lambda *moved: series(again(*moved).track))
    progress(1.0)
    receipts = receipts_of(result.receipts)
    return rows.series(vehicle), smoothed, found.track, found, receipts, result.health, doubts
