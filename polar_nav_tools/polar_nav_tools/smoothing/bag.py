"""Smooths the follower of a bag, of this project or mapped; the result as series and as a bag."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.events import Receipt
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_ros import topics
from polar_nav_ros.adapters.mapping import Mapping as Sources
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.navigation_outputs import receipt_to_msg

from ..bags import Bag, BagWriter
from ..foreign.lever import at_the_imu
from ..foreign.load import load
from ..foreign.replay import Row, states_of, truth_messages
from ..foreign.sources import Source
from ..replay.by_message import parameters
from ..replay.plain import plain_arrays
from ..scoring import Comparison, compare
from ..series.estimates import EstimateRows, receipts_of
from ..series.run import RunSeries
from ..series.vehicle import EstimateSeries, TruthSeries

Progress = Callable[[float], None]
FILTER, SMOOTHER = 'filter', 'smoother'


def _to_base_link(
    params: FollowerParams, inputs: Inputs, imu_lever_b: tuple[float, float, float]
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
    """

    every_s: float = 1.0
    passes: int = smoothing.MOST_PASSES


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
    filter_receipts : tuple of Receipt
        Of the filter, fixes as they came.
    truth : TruthSeries or None
    """

    path: Path
    vehicle: str
    params: FollowerParams
    filtered: EstimateSeries
    smoothed: EstimateSeries
    track: engine_run.Track
    found: smoothing.Smoothed
    filter_receipts: tuple[Receipt, ...]
    truth: TruthSeries | None

    @property
    def comparison(self) -> Comparison | None:
        """Scores of filter and smoother; None without a truth."""
        if self.truth is None:
            return None
        return compare(
            {
                FILTER: (self.truth, self.filtered, receipts_of(self.filter_receipts)),
                SMOOTHER: (self.truth, self.smoothed, receipts_of(self.found.receipts)),
            }
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
    arrays = plain_arrays(
        bag, vehicle, 'smoothed', truth=True, progress=lambda share: progress(0.3 * share)
    )
    params = parameters(arrays.params, configuration, changes)
    inputs = arrays.inputs(params).inputs
    found = _both(params, params, inputs, vehicle, how, (0.0, 0.0, 0.0), _later(progress, 0.3))
    return SmoothedRun(bag.path, vehicle, params, *found, arrays.truth)


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
        how=How(),
        progress=progress or (lambda _: None),
    )
    return RunSeries(
        estimates=run.smoothed,
        receipts=receipts_of(run.found.receipts),
        divergence=run.found.divergence,
    )


def smooth_mapped(
    source: Source,
    mapping: Sources,
    *,
    accept: Iterable[str],
    how: How,
    progress: Progress,
) -> SmoothedRun:
    """Smoothed run of a bag of any origin."""
    loaded = load(source, mapping, accept)
    params = at_the_imu(loaded)
    if not len(loaded.inputs.imu_stamps_ns):
        raise ConfigError(f'{source.path}: no IMU sample after the start')
    vehicle, lever_b = mapping.vehicle, mapping.imu.lever_b
    found = _both(loaded.params, params, loaded.inputs, vehicle, how, lever_b, progress)
    return SmoothedRun(Path(source.path), vehicle, params, *found, loaded.truth)


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
) -> tuple[
    EstimateSeries, EstimateSeries, engine_run.Track, smoothing.Smoothed, tuple[Receipt, ...]
]:
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
    )
    found = smoothing.smooth(
        params,
        inputs,
        every_s=how.every_s,
        passes=how.passes,
        move=_to_base_link(params, inputs, imu_lever_b),
        progress=lambda share: progress(0.2 + 0.8 * share),
    )
    track = found.track
    smoothed = EstimateRows(params, len(track.stamps_ns))
    smoothed.append(track)
    return rows.series(vehicle), smoothed.series(vehicle), track, found, result.receipts


def summary(found: smoothing.Smoothed) -> dict[str, object]:
    """Passes and revisions for JSON."""
    return {
        'passes': found.passes,
        'moved_sigma': None if math.isinf(found.moved) else found.moved,
        'largest_turn_rad': found.largest_turn,
        'unsettled': found.unsettled,
        'revisions': [r.to_dict() for r in found.revisions],
    }


def write(path: Path, run: SmoothedRun) -> Path:
    """Write the smoothed track as nav/state, its fixes' receipts and the truth to a new bag.

    Raises
    ------
    BagError
        When the bag exists or cannot be written.
    """
    receipts: list[Row] = [
        (r.stamp_ns, topics.RECEIPT, to_bytes(receipt_to_msg(r)))
        for r in sorted(run.found.receipts, key=lambda r: r.stamp_ns)
    ]
    streams: list[Iterable[Row]] = [states_of(run.track, run.params, run.vehicle), receipts]
    written = [topics.STATE, topics.RECEIPT]
    if run.truth is not None:
        streams.append(truth_messages(run.truth))
        written.append(topics.TRUTH)
    info: dict[str, object] = {
        'smoothing_of': str(run.path),
        'engine_version': ENGINE_VERSION,
        'configuration': run.params.configuration,
        'parameters': to_mapping(run.params),
        'smoothing': summary(run.found),
    }
    with BagWriter(path, info) as writer:
        for topic in written:
            writer.add_topic(f'/{run.vehicle}/{topic}', topics.TYPES[topic])
        for stamp_ns, topic, data in heapq.merge(*streams, key=lambda row: row[0]):
            writer.write(f'/{run.vehicle}/{topic}', data, stamp_ns)
    return path
