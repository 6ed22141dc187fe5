"""Experiment `smooth`: errors of filter and smoother, against their stated sigmas.

Errors of a track are correlated in time: of its normalized squares one is counted in each
correlation time, so that the band of a chi-square distribution holds for them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from scipy.stats import chi2

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.events import Array
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid

from ..scoring.tables import Column, Table
from .errors import TrackErrors, track_errors
from .experiment import Experiment
from .jobs import RunResult
from .request import Request, Size
from .schedule import FixSpec
from .suite import one_filter_suite
from .world import make_world
from .world_spec import WorldSpec

FILTER, SMOOTHER = 'filter', 'smoother'
_BAND = 0.999
_SETTLED = 0.25
"""Share of the run that is left out at its start: the filter is learning."""
_LEAST = 0.05
"""Correlation at which the sum over the correlation function ends."""
_FIXES = FixSpec(period_s=10.0, first_s=2.0, delay_kind='uniform', delay_s=20.0)
_ROWS: Mapping[str, Mapping[str, Any]] = {
    '6_1': {'imu': 'paper_6_1'},
    '6_2': {'imu': 'paper_6_2'},
    'tactical': {'imu': 'tactical', 'gyro_bias_dph': 1.0, 'accel_bias_g': 5e-4},
    'no_dvl': {'imu': 'paper_6_1', 'dvl_rate_hz': 0.0},
}


@dataclass(frozen=True)
class SmoothJob:
    """One world to be filtered and smoothed."""

    row: str
    duration_s: float
    column: str
    seed: int

    @property
    def group(self) -> str:
        """Name in tables."""
        return self.row


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[SmoothJob]:
    """Jobs of all rows and seeds.

    Raises
    ------
    ConfigError
        When no row has such a name.
    """
    del columns
    patterns = [p.strip() for p in (request.rows or '*').split(',')]
    seeds = range(request.first_seed, request.first_seed + size.seeds)
    jobs = [
        SmoothJob(row, size.duration_s, SMOOTHER, seed)
        for row in _ROWS
        if any(fnmatchcase(row, p) for p in patterns)
        for seed in seeds
    ]
    if not jobs:
        raise ConfigError(f'--rows {request.rows}: no such row; there are {", ".join(_ROWS)}')
    return jobs


def run_job(job: SmoothJob) -> RunResult:
    """Result of one job: errors and sigmas of both tracks."""
    begin = time.process_time()
    spec = WorldSpec(
        **{
            'duration_s': job.duration_s,
            'constants': 'prior',
            'speed_mps': 2.0,
            'imu_rate_hz': 100.0,
            'dvl_rate_hz': 5.0,
            'depth_rate_hz': 2.0,
            **_ROWS[job.row],
        }
    )
    world = make_world(spec, _FIXES, job.seed)
    params = world.params(configuration='default', output_period_s=1.0)
    found = smoothing.smooth(params, world.inputs, covariances=True)
    filtered = engine_run.run(params, world.inputs).track
    metrics = {'passes': float(found.passes), 'revisions': float(len(found.revisions))}
    for name, track in ((FILTER, filtered), (SMOOTHER, found.track)):
        errors = track_errors(world, track)
        rows = errors.time_s > _SETTLED * job.duration_s
        C_e_G = np.asarray(ecef_to_grid(track.r_e[rows]))
        measured = _measured(errors.rows(rows), C_e_G)
        metrics |= {f'{name}.{key}': value for key, value in measured.items()}
    reason = found.divergence
    stopped_s = job.duration_s if reason else math.nan
    seconds = time.process_time() - begin
    return RunResult(job.group, job.column, job.seed, metrics, stopped_s, reason, {}, seconds)


def _measured(errors: TrackErrors, C_e_G: Array) -> dict[str, float]:
    """RMS and stated 1-sigma of the horizontal position [m], NEES, and samples that count."""
    P = C_e_G @ errors.P[:, X.dr_e, X.dr_e] @ np.swapaxes(C_e_G, 1, 2)
    e = errors.dr_G
    white = np.linalg.solve(np.linalg.cholesky(P), e[:, :, None])[:, :, 0]
    return {
        'rms': float(np.sqrt(np.mean(np.sum(e[:, :2] ** 2, axis=1)))),
        'sigma': float(np.sqrt(np.mean(P[:, 0, 0] + P[:, 1, 1]))),
        'nees': float(np.mean(np.sum(white**2, axis=1))) / 3.0,
        'samples': len(white) / correlation_time(white),
    }


def correlation_time(white: Array) -> float:
    """Samples of whitened errors (k, 3) that count as one: 1 + 2 sum of their correlation."""
    n = len(white)
    square = float(np.mean(np.sum(white**2, axis=1)))
    total = 1.0
    for lag in range(1, n // 2):
        r = float(np.mean(np.sum(white[lag:] * white[:-lag], axis=1))) / square
        if r < _LEAST:
            break
        total += 2.0 * r
    return min(total, float(n))


_COLUMNS = (
    Column('row', 'world'),
    Column('track', 'track'),
    Column('rms', 'RMS', 'm', doc='horizontal, after a quarter of the run'),
    Column('sigma', '1-sigma', 'm', doc='stated, root mean square'),
    Column('ratio', 'RMS / 1-sigma'),
    Column('nees', 'NEES / dof', doc='of the position'),
    Column('samples', 'samples', doc='correlation times of all seeds'),
    Column('band', 'band', doc=f'{100 * _BAND:g} % of NEES, for so many samples'),
    Column('well', 'well', doc='NEES in the band'),
)


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Table of filter and smoother, a row each in each world."""
    body = []
    for group in dict.fromkeys(r.group for r in results):
        runs = [r for r in results if r.group == group and r.metrics]
        body += [{'row': group, **_line(runs, track)} for track in (FILTER, SMOOTHER) if runs]
    last = request.first_seed + size.seeds - 1
    title = f'Smoothing, {size.duration_s:g} s, seeds {request.first_seed} to {last}'
    return [Table(title, _COLUMNS, tuple(body))]


def _line(runs: Sequence[RunResult], track: str) -> dict[str, object]:
    def all_of(key: str) -> Array:
        return np.array([r.metrics[f'{track}.{key}'] for r in runs])

    rms, sigma = (float(np.sqrt(np.mean(all_of(key) ** 2))) for key in ('rms', 'sigma'))
    samples = float(all_of('samples').sum())
    nees = float(np.average(all_of('nees'), weights=all_of('samples')))
    dof = 3.0 * samples
    low, high = chi2.ppf([0.5 - 0.5 * _BAND, 0.5 + 0.5 * _BAND], dof) / dof
    well = low <= nees <= high and not any(r.reason for r in runs)
    return {
        'track': track,
        'rms': rms,
        'sigma': sigma,
        'ratio': rms / sigma,
        'nees': nees,
        'samples': samples,
        'band': f'{low:.2f} to {high:.2f}',
        'well': 'yes' if well else 'no',
    }


def _describe(jobs: Sequence[SmoothJob]) -> dict[str, Any]:
    return {
        'filters': {SMOOTHER: {'engine': {'configuration': 'default'}}},
        'groups': {job.group: dict(_ROWS[job.row]) for job in jobs},
    }


SMOOTH = Experiment(
    'smooth',
    'Filter and smoother: errors against stated sigmas, NEES once per correlation time',
    Size(1200.0, 20),
    Size(300.0, 2),
    (SMOOTHER,),
    plan,
    tables,
    suite=one_filter_suite('smooth', run_job, _describe),
    selects=True,
)
