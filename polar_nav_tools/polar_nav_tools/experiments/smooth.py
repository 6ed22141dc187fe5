"""Experiment `smooth`: errors of filter and smoother, against their stated sigmas.

Errors of a track are correlated in time: of its normalized squares one is counted in each
correlation time, so that the band of a chi-square distribution holds for them.

Rows `exact_*` are worlds drawn from the model itself, with a filter without reserve, gate and
weights: there a stated sigma has to be the error. The IMU of `tactical` has vices that nobody
states; that of `exact_tactical` has none. Rows `mems` and `wrong_*` are vehicles of the
experiments `tune` and `calibrate`, the latter with a constant that is not as stated: both tracks
are wrong, and that has to be said.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.smoothed import Smoothed
from polar_nav_core.engine.track import StationTrack, Track
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid
from polar_nav_ros.adapters.noise_classes import imu_noise
from polar_nav_sim.offline_station import StationScenario

from ..scoring.tables import Column, Table
from ..series.estimates import EstimateRows
from ..series.run import FILTER, SMOOTHER
from ..series.vehicle import EstimateSeries
from ..smoothing.doubts import doubts_of
from .calibrate.rows import params_of, world_of
from .errors import track_errors
from .evidence.price import EXACT
from .experiment import Experiment
from .jobs import RunResult
from .mismatch.dvl_faults import DvlGain, DvlPlace
from .mismatch.faults import Fault, FixClock, FixLever
from .request import Request, Size, rows_matching
from .schedule import FixSpec
from .station.world import make_world as make_station_world
from .station_choices import StationChoices
from .suite import one_filter_suite
from .tune.rows import LATE, mems_world
from .world import World, make_world
from .world_spec import WorldSpec

_BAND = 0.999
_SETTLED = 0.25
"""Share of the run that is left out at its start: the filter is learning."""
_SAID = 'said.'
_LEAST = 0.05
"""Correlation at which the sum over the correlation function ends."""
_FIXES = FixSpec(period_s=10.0, first_s=2.0, delay_kind='uniform', delay_s=20.0)
_ROWS: Mapping[str, Mapping[str, Any]] = {
    '6_1': {'imu': 'paper_6_1'},
    '6_2': {'imu': 'paper_6_2'},
    'tactical': {'imu': 'tactical', 'gyro_bias_dph': 1.0, 'accel_bias_g': 5e-4},
    'no_dvl': {'imu': 'paper_6_1', 'dvl_rate_hz': 0.0},
}
_EXACT = {f'exact_{name}': {**world, 'imu_vices': False} for name, world in _ROWS.items()}
_STATIONS: Mapping[str, Mapping[str, Any]] = {
    'station': {},
    'station_changing': {'current_change': 0.3, 'current_turn': 0.6},
}
"""Vehicles without DVL that a station locates, in a current that stays and in one that turns."""
_WRONG: Mapping[str, Fault] = {
    'right': Fault(),
    'delay_0.5s': FixClock(offset_s=0.5),
    'delay_1.5s': FixClock(offset_s=1.5),
    'delay_5s': FixClock(offset_s=5.0),
    'dvl_lever_1m': DvlPlace(lever_b=(1.0, 0.0, 0.0)),
    'dvl_lever_2m': DvlPlace(lever_b=(0.0, 2.0, 0.0)),
    'dvl_yaw_3deg': DvlGain(turn_deg=-3.0),
    'fix_lever_3m': FixLever(lever_b=(0.0, 3.0, 0.0)),
}
"""Constants that are not as stated."""
_FAULTS: Mapping[str, tuple[str, Fault]] = {
    f'wrong_{name}_{scene}': (scene, fault)
    for name, fault in _WRONG.items()
    for scene in ('lawnmower', 'circle')
}
_MEMS = 'mems'
_ALL: Mapping[str, Mapping[str, Any]] = {
    **_ROWS, **_EXACT, **_STATIONS, _MEMS: {}, **{name: {} for name in _FAULTS},
}  # fmt: skip


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
        For a pattern of rows that matches none.
    """
    del columns
    seeds = range(request.first_seed, request.first_seed + size.seeds)
    return [
        SmoothJob(row, size.duration_s, SMOOTHER, seed)
        for row in rows_matching(request.rows, _ALL)
        for seed in seeds
    ]


def run_job(job: SmoothJob) -> RunResult:
    """Result of one job: errors and sigmas of both tracks."""
    begin = time.process_time()
    found, metrics = (_station if job.row in _STATIONS else _strapdown)(job)
    metrics |= {'passes': float(found.passes), 'revisions': float(len(found.revisions))}
    reason = found.divergence
    stopped_s = job.duration_s if reason else math.nan
    seconds = time.process_time() - begin
    return RunResult(job.group, job.column, job.seed, metrics, stopped_s, reason, {}, seconds)


def _world(job: SmoothJob) -> tuple[World, EngineParams]:
    """World of a row of mode sins, and parameters of its filter."""
    if job.row in _FAULTS:
        scene, fault = _FAULTS[job.row]
        world = fault.applied(world_of(scene, job.duration_s, job.seed, LATE), 1.0)
        return world, replace(params_of(world), output_period_s=1.0)
    if job.row == _MEMS:
        world = mems_world(job.duration_s, job.seed)
        stated: Mapping[str, Any] = {'configuration': 'default', **imu_noise('bmi088')}
        return world, world.params(**stated, output_period_s=1.0)
    spec = WorldSpec(
        **{
            'duration_s': job.duration_s,
            'constants': 'prior',
            'speed_mps': 2.0,
            'imu_rate_hz': 100.0,
            'dvl_rate_hz': 5.0,
            'depth_rate_hz': 2.0,
            **_ALL[job.row],
        }
    )
    world = make_world(spec, _FIXES, job.seed)
    stated = EXACT if job.row in _EXACT else {'configuration': 'default'}
    return world, world.params(**stated, output_period_s=1.0)


def _strapdown(job: SmoothJob) -> tuple[Smoothed[Track], dict[str, float]]:
    world, params = _world(job)
    found = smoothing.smooth(params, world.inputs, covariances=True)
    filtered = engine_run.run(params, world.inputs).track
    metrics: dict[str, float] = {}
    for name, track in ((FILTER, filtered), (SMOOTHER, found.track)):
        errors = track_errors(world, track)
        rows = errors.time_s > _SETTLED * job.duration_s
        C_e_G = np.asarray(ecef_to_grid(track.r_e[rows]))
        own = errors.rows(rows)
        P = C_e_G @ own.P[:, X.dr_e, X.dr_e] @ np.swapaxes(C_e_G, 1, 2)
        metrics |= {f'{name}.{key}': value for key, value in _measured(own.dr_G, P).items()}
    return found, metrics | _doubts(params, world, found.track)


def _doubts(params: EngineParams, world: World, track: Track) -> dict[str, float]:
    """What `./polar smooth` says of constants: by name, and whether it ends with status 1."""

    def series(track: Track) -> EstimateSeries:
        rows = EstimateRows(params, len(track.stamps_ns))
        rows.append(track)
        return rows.series('follower')

    def again(params: EngineParams, inputs: Inputs) -> EstimateSeries:
        return series(smoothing.smooth(params, inputs, passes=1).track)

    found = doubts_of(params, world.inputs, series(track), again)
    return {
        **{f'{_SAID}{d.constant.name}': d.value for d in found.found},
        'status': float(bool(found.complaint)),
        'moved': found.moved_sigma,
    }


def _station(job: SmoothJob) -> tuple[Smoothed[StationTrack], dict[str, float]]:
    scenario = StationScenario(duration_s=job.duration_s, **_STATIONS[job.row])
    choices = StationChoices()
    world = make_station_world(scenario, job.seed, choices.depth_sigma, 0.0)
    params = replace(world.params(choices, 0.0), output_period_s=1.0)
    found = smoothing.smooth(params, world.inputs)
    filtered = engine_run.run(params, world.inputs).track
    run = world.run
    metrics: dict[str, float] = {}
    for name, track in ((FILTER, filtered), (SMOOTHER, found.track)):
        time_s = (track.stamps_ns - run.start_ns) * 1e-9
        at = np.searchsorted(run.t_s, time_s - 1e-6).clip(max=len(run.t_s) - 1)
        rows = time_s > _SETTLED * job.duration_s
        e = ((track.r_e - world.origin_e) @ world.C_e_S.T - run.p[at])[rows]
        P = world.C_e_S @ track.P[rows, X.dr_e, X.dr_e] @ world.C_e_S.T
        metrics |= {f'{name}.{key}': value for key, value in _measured(e, P).items()}
    return found, metrics


def _measured(e: Array, P: Array) -> dict[str, float]:
    """RMS and stated 1-sigma of the horizontal position [m], NEES, and samples that count.

    ``e`` (k, 3) and ``P`` (k, 3, 3) are position errors and their covariances, the horizontal
    axes first.
    """
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
    Column('said', 'said', doc='constants that are said to be wrong: runs, and median'),
    Column('status', 'status 1', doc='runs that end so for them'),
)


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Table of filter and smoother, a row each in each world."""
    body = []
    for group in dict.fromkeys(r.group for r in results):
        runs = [r for r in results if r.group == group and r.metrics]
        body += [{'row': group, **_line(runs, track)} for track in (FILTER, SMOOTHER) if runs]
        if runs and 'status' in runs[0].metrics:
            body[-1] |= _said(runs)
    last = request.first_seed + size.seeds - 1
    title = f'Smoothing, {size.duration_s:g} s, seeds {request.first_seed} to {last}'
    return [Table(title, _COLUMNS, tuple(body))]


def _said(runs: Sequence[RunResult]) -> dict[str, object]:
    names = sorted({k for r in runs for k in r.metrics if k.startswith(_SAID)})
    values = {k: [r.metrics[k] for r in runs if k in r.metrics] for k in names}
    return {
        'said': ', '.join(
            f'{k.removeprefix(_SAID)} {len(v)} ({float(np.median(v)):.3g})'
            for k, v in values.items()
        )
        or 'nothing',
        'status': f'{sum(r.metrics["status"] for r in runs):.0f} of {len(runs)}',
    }


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
        'filters': {
            SMOOTHER: {'engine': {'configuration': 'default'}},
            'exact': {'engine': EXACT},
        },
        'groups': {
            job.group: {**_ALL[job.row], 'fault': repr(_FAULTS.get(job.row, ''))} for job in jobs
        },
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
