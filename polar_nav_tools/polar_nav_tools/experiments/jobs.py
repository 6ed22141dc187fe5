"""One run of one filter in one world, and its metrics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict

from ..scoring.errors import ARCMIN
from .columns import FilterColumn
from .errors import TrackErrors, track_errors
from .recorded import load_recorded
from .schedule import FixSpec
from .world import World, make_world
from .world_spec import WorldSpec

_SERIES_ROWS = 1200
"""Number of points of a thinned time series: more than the pixels across one panel."""


R = TypeVar('R')


@dataclass(frozen=True)
class RowJob(Generic[R]):
    """One run to make of a table of faults: a row, a column, a seed.

    Attributes
    ----------
    row : R
        Fault and scene.
    column, doc : str
    seed : int
    changes : mapping
        Engine parameters of the column.
    """

    row: R
    column: str
    doc: str
    seed: int
    changes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Job:
    """One run to make: filter, world, fixes, seed.

    Attributes
    ----------
    group : str
        Group of the run besides the filter, e.g. ``D1``.
    column : FilterColumn
        The filter.
    seed : int
    world, fixes : WorldSpec, FixSpec
    changes : dict
        Further parameters of the engine.
    recorded : Path or None
        Errors of a real IMU (experiments/recorded.py).
    series : bool
        Whether errors over time are stored.
    """

    group: str
    column: FilterColumn
    seed: int
    world: WorldSpec
    fixes: FixSpec
    changes: dict[str, Any] = field(default_factory=dict)
    recorded: Path | None = None
    series: bool = False


@dataclass(frozen=True)
class RunResult:
    """Result of one run.

    Attributes
    ----------
    group, column, seed : str, str, int
    metrics : dict
        Metrics of the whole run (``phi_x`` ...) and its second half (``phi_x_half`` ...): RMS; see
        :func:`measure`. Empty when the filter stopped.
    stopped_s : float
        When the filter stopped, NaN if it did not.
    reason : str
        Why it stopped.
    verdicts : dict
        Number of fixes by verdict.
    seconds : float
        Processor time of the filter.
    series : dict of arrays
        ``time_s`` and errors over time, if requested.
    """

    group: str
    column: str
    seed: int
    metrics: dict[str, float]
    stopped_s: float
    reason: str
    verdicts: dict[str, int]
    seconds: float
    series: dict[str, Array] = field(default_factory=dict)

    @property
    def names(self) -> dict[str, str | int | float]:
        """Group, filter and seed, as columns of a row."""
        return {'group': self.group, 'filter': self.column, 'seed': self.seed}

    @property
    def stopped(self) -> bool:
        """Whether the filter stopped before the end."""
        return bool(self.reason)


@lru_cache(maxsize=1)
def _world(spec: WorldSpec, fixes: FixSpec, seed: int, recorded: Path | None) -> World:
    """World of a run, shared by filters that run one after another."""
    return make_world(spec, fixes, seed, None if recorded is None else load_recorded(recorded))


@lru_cache(maxsize=64)
def _warm(configuration: str, delay_handling: str) -> None:
    """Run a few seconds once per process and kind of filter, to load compiled code."""
    world = make_world(WorldSpec(duration_s=6.0), FixSpec(period_s=0.5, delay_s=1.0), 1)
    engine_run.run(
        world.params(configuration=configuration, delay_handling=delay_handling), world.inputs
    )


def run_job(job: Job) -> RunResult:
    """Result of one run of a filter."""
    world = _world(job.world, job.fixes, job.seed, job.recorded)
    if job.column.clairvoyant:
        world = world.clairvoyant()
    params = world.params(**{**job.changes, **job.column.changes})
    _warm(params.configuration, params.delay_handling)
    start = time.process_time()
    result = engine_run.run(params, world.inputs)
    seconds = time.process_time() - start
    fixes = [r for r in result.receipts if r.source == 'leader']
    verdicts = Counter(Verdict(r.verdict).name for r in fixes)
    stopped_s = _stopped_s(result, fixes, world.truth.start_ns)
    metrics: dict[str, float] = {}
    series: dict[str, Array] = {}
    if len(result.track.stamps_ns):
        errors = track_errors(world, result.track)
        if not result.divergence:
            metrics = {**measure(errors), 'nees_dof': float(errors.nees_dof())}
        if job.series:
            series = _series(errors)
    run = job.group, job.column.name, job.seed
    return RunResult(*run, metrics, stopped_s, result.divergence, dict(verdicts), seconds, series)


def _stopped_s(
    result: engine_run.Result[engine_run.Track], fixes: Sequence[Receipt], start_ns: int
) -> float:
    """Time [s] at which a filter stopped: the first unused fix, or else the last estimate."""
    if not result.divergence:
        return float('nan')
    refused = [r.stamp_ns for r in fixes if r.verdict == Verdict.NOT_READY]
    stamps = refused[:1] or [int(s) for s in result.track.stamps_ns[-1:]] or [start_ns]
    return (stamps[0] - start_ns) / 1e9


def measure(errors: TrackErrors) -> dict[str, float]:
    """Metrics of one run.

    RMS of ``phi_x``, ``phi_y``, ``phi_z`` [arc min], ``v_x``, ``v_y`` [m/s], ``r_x``, ``r_y`` [m],
    ``r`` (horizontal) [m]; ``lag``: mean of the position error against the direction of travel
    [m]; ``nees``, ``nees_position``: means per degree of freedom, 1 for an honest covariance. The
    same of the second half with ``_half``.
    """
    late = errors.time_s > 0.5 * errors.time_s[-1]
    return {**_window(errors, ''), **_window(errors.rows(late), '_half')}


def _window(e: TrackErrors, suffix: str) -> dict[str, float]:
    out = {f'phi_{axis}': _rms(e.phi_G[:, i]) * ARCMIN for i, axis in enumerate('xyz')}
    out |= {f'v_{axis}': _rms(e.dv_G[:, i]) for i, axis in enumerate('xy')}
    out |= {f'r_{axis}': _rms(e.dr_G[:, i]) for i, axis in enumerate('xy')}
    out['r'] = _rms(e.horizontal)
    out['lag'] = -float(np.mean(e.along))
    out['nees'] = float(np.mean(e.nees())) / max(1, e.nees_dof())
    out['nees_position'] = float(np.mean(e.nees_position())) / 3.0
    return {key + suffix: value for key, value in out.items()}


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x * x)))


def _series(e: TrackErrors) -> dict[str, Array]:
    """Errors over time, thinned by an odd stride to sample the attitude sines at all phases."""
    stride = max(1, len(e.time_s) // _SERIES_ROWS) | 1
    out = {'time_s': e.time_s[::stride]}
    out |= {f'phi_{axis}': e.phi_G[::stride, i] * ARCMIN for i, axis in enumerate('xyz')}
    out |= {f'v_{axis}': e.dv_G[::stride, i] for i, axis in enumerate('xy')}
    out |= {f'r_{axis}': e.dr_G[::stride, i] for i, axis in enumerate('xy')}
    thin = e.rows(np.arange(len(e.time_s)) % stride == 0)
    return {**out, 'nees': thin.nees(), 'nees_position': thin.nees_position()}
