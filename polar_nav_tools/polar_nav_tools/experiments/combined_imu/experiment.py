"""Experiment `combined-imu`: GTSAM's CombinedImuFactor as shipped, beside our smoother.

Both get the same samples, pings, depths and fixes, each fix at its time of validity, the same
start and the same noises. Errors that GTSAM's factors have no states for are left out of the
world: what is compared is how the IMU is used.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polar_nav_core import attitude
from polar_nav_core.arrays import Array
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.track import Track
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid
from polar_nav_sim.sensors.imu import DPH

from ...scoring.errors import ARCMIN
from ...scoring.tables import Column, Table
from ..experiment import Experiment
from ..jobs import RunResult
from ..request import Request, Size, rows_matching
from ..schedule import FixSpec
from ..suite import Suite, one_filter_suite
from ..world import World, make_world
from ..world_spec import WorldSpec
from .graph import Solved, Use, gtsam_module, solve

OURS, DEFAULT = 'smoother', 'default'
NEGLECTED, LOOSE, CORIOLIS, CORRECTED = 'neglected', 'loose', 'coriolis', 'corrected'
WAYS: Mapping[str, str] = {
    OURS: 'ours, every measurement fused as stated, as GTSAM does it',
    DEFAULT: 'ours as it is: fixes weighted, verdicts with hindsight',
    NEGLECTED: 'GTSAM: the Earth does not turn, gravity is that of the start',
    LOOSE: 'the same, and the gyro may have a constant of 20 deg/h',
    CORIOLIS: 'GTSAM told of the rate of the Earth (setOmegaCoriolis)',
    CORRECTED: 'the first, of samples that are corrected for what it leaves out',
}
_AS_STATED: Mapping[str, Any] = {
    'configuration': 'custom',
    'gate_probability': 1.0,
    'robust_fixes': 'none',
    'reopen_after_s': 0.0,
}
_LOOSE_DPH = 20.0
_SETTLED = 0.25
"""Share of the run that is left out at its start."""
_NONE = 1e-9
_COMMON: Mapping[str, Any] = {
    'imu': 'tactical',
    'imu_vices': False,
    'constants': 'prior',
    'gyro_bias_dph': 5.0,
    'accel_bias_g': 7.5e-4,
    'speed_mps': 2.0,
    'imu_rate_hz': 100.0,
    'dvl_rate_hz': 1.0,
    'dvl_scale': _NONE,
    'dvl_markov_sigma': _NONE,
    'depth_rate_hz': 1.0,
}
_WALKS = {'gyro_bias_walk': 1e-7, 'accel_bias_walk': 2e-5}
"""Of both: what biases of this class wander. GTSAM cannot invert much smaller ones."""
_FIXES = FixSpec(period_s=10.0, first_s=10.0, delay_kind='uniform', delay_s=5.0)
_ROWS: Mapping[str, Mapping[str, Any]] = {
    'straight': {'latitude_deg': 45.0},
    'lawnmower': {'mission': 'ahrs'},
    'no_dvl': {'mission': 'ahrs', 'dvl_rate_hz': 0.0},
}


@dataclass(frozen=True)
class CombinedImuJob:
    """One world to be smoothed in all ways."""

    row: str
    duration_s: float
    column: str
    seed: int

    @property
    def group(self) -> str:
        """Name in tables."""
        return self.row


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[CombinedImuJob]:
    """Jobs of all rows and seeds.

    Raises
    ------
    ConfigError
        For a pattern of rows that matches none.
    """
    del columns
    rows = rows_matching(request.rows, _ROWS)
    seeds = range(request.first_seed, request.first_seed + size.seeds)
    return [CombinedImuJob(row, size.duration_s, OURS, seed) for row in rows for seed in seeds]


def run_job(job: CombinedImuJob) -> RunResult:
    """Result of one job: errors of all ways, and how far each is from ours."""
    begin = time.process_time()
    spec = WorldSpec(**{**_COMMON, 'duration_s': job.duration_s, **_ROWS[job.row]})
    world = make_world(spec, _FIXES, job.seed)
    params = world.params(configuration='default', output_period_s=1.0, **_WALKS)
    ours, default = (
        smoothing.smooth(p, world.inputs, covariances=True).track
        for p in (replace(params, **_AS_STATED), params)
    )
    tracks = {OURS: ours, DEFAULT: default, **_theirs(world, params, ours)}
    metrics: dict[str, float] = {}
    for name, track in tracks.items():
        found = _measured(world, track, ours)
        metrics |= {f'{name}.{key}': value for key, value in found.items()}
    seconds = time.process_time() - begin
    return RunResult(job.group, job.column, job.seed, metrics, math.nan, '', {}, seconds)


def _theirs(world: World, params: EngineParams, ours: Track) -> dict[str, Track]:
    """Tracks by GTSAM's factor, one for each way to use it."""
    coriolis = solve(world, params, Use(coriolis=True))
    found = {
        NEGLECTED: solve(world, params, Use()),
        LOOSE: solve(world, params, Use(gyro_bias_sigma=_LOOSE_DPH * DPH)),
        CORIOLIS: coriolis,
        CORRECTED: solve(world, params, Use(about=coriolis)),
    }
    return {name: _track(solved, ours) for name, solved in found.items()}


def _track(solved: Solved, like: Track) -> Track:
    """Return a solution as a track, at the stamps that it has in common with another."""
    rows = np.flatnonzero(np.isin(solved.stamps_ns, like.stamps_ns))
    plane = solved.plane
    r_e = plane.ecef(solved.r_n[rows])
    C_n_G = np.asarray(ecef_to_grid(r_e)) @ plane.C_e_n.T
    P = np.zeros((len(rows), X.size, X.size))
    P[:, X.dr_e, X.dr_e] = plane.C_e_n.T @ solved.P_n[rows] @ plane.C_e_n
    sensor_errors = np.zeros((len(rows), 15))
    sensor_errors[:, :3] = solved.gyro_bias_b[rows]
    sensor_errors[:, 3:6] = solved.accel_bias_b[rows]
    return replace(
        like,
        stamps_ns=solved.stamps_ns[rows],
        r_e=r_e,
        v_G=np.einsum('nij,nj->ni', C_n_G, solved.v_n[rows]),
        C_b_G=C_n_G @ solved.C_b_n[rows],
        P=P,
        sensor_errors=sensor_errors,
    )


def _measured(world: World, track: Track, ours: Track) -> dict[str, float]:
    """RMS of a track after a quarter of the run; angles in arc minutes, bias in deg/h."""
    start_ns, end_ns = (int(world.inputs.imu_stamps_ns[k]) for k in (0, -1))
    rows = np.isin(track.stamps_ns, ours.stamps_ns)
    rows &= track.stamps_ns > start_ns + _SETTLED * (end_ns - start_ns)
    truth = world.truth.state(track.stamps_ns[rows])
    C_e_G = truth.C_e_G
    dr_G = np.einsum('nij,nj->ni', C_e_G, track.r_e[rows] - truth.r_e)
    beside = ours.r_e[np.searchsorted(ours.stamps_ns, track.stamps_ns[rows])]
    apart_G = np.einsum('nij,nj->ni', C_e_G, track.r_e[rows] - beside)
    phi_G = -attitude.log(track.C_b_G[rows] @ np.swapaxes(truth.C_b_G, 1, 2)) * ARCMIN
    P_G = C_e_G @ track.P[rows][:, X.dr_e, X.dr_e] @ np.swapaxes(C_e_G, 1, 2)
    bias_b = track.sensor_errors[rows, :3] - world.constants.gyro_bias_b
    return {
        'rms': _rms(dr_G[:, :2]),
        'sigma': float(np.sqrt(np.mean(P_G[:, 0, 0] + P_G[:, 1, 1]))),
        'apart': _rms(apart_G[:, :2]),
        'heading': _rms(phi_G[:, 2:]),
        'tilt': _rms(phi_G[:, :2]),
        'velocity': 1e3 * _rms((track.v_G[rows] - truth.v_G)[:, :2]),
        'gyro_bias': _rms(bias_b) / DPH,
    }


def _rms(rows: Array) -> float:
    """Return the root mean square of the lengths of rows."""
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


_COLUMNS = (
    Column('row', 'world'),
    Column('way', 'track'),
    Column('rms', 'RMS', 'm', doc='horizontal, after a quarter of the run, all seeds'),
    Column('spread', 'of a seed', 'm', doc='least and most'),
    Column('sigma', '1-sigma', 'm', doc='stated, root mean square'),
    Column('ratio', 'RMS / 1-sigma'),
    Column('apart', 'from ours', 'm', doc='root mean square of the distance'),
    Column('heading', 'heading', '′', doc='RMS'),
    Column('tilt', 'tilt', '′', doc='RMS'),
    Column('velocity', 'velocity', 'mm/s', doc='horizontal RMS'),
    Column('gyro_bias', 'gyro bias', '°/h', doc='RMS of its error, three axes'),
)


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Table of all ways, a row each in each world."""
    body: list[dict[str, object]] = []
    for group in dict.fromkeys(r.group for r in results):
        runs = [r.metrics for r in results if r.group == group and r.metrics]
        body += [{'row': group, **_line(runs, way)} for way in WAYS if runs]
    last = request.first_seed + size.seeds - 1
    title = f'CombinedImuFactor and smoother, {size.duration_s:g} s, '
    title += f'seeds {request.first_seed} to {last}'
    return [Table(title, _COLUMNS, tuple(body))]


def _line(runs: Sequence[Mapping[str, float]], way: str) -> dict[str, object]:
    of_seeds = [run[f'{way}.rms'] for run in runs]
    keys = ('rms', 'sigma', 'apart', 'heading', 'tilt', 'velocity', 'gyro_bias')
    mean = {k: math.sqrt(sum(run[f'{way}.{k}'] ** 2 for run in runs) / len(runs)) for k in keys}
    return {
        'way': way,
        'spread': f'{min(of_seeds):.2f} to {max(of_seeds):.2f}',
        'ratio': mean['rms'] / mean['sigma'],
        **mean,
    }


def _describe(jobs: Sequence[CombinedImuJob]) -> dict[str, Any]:
    return {
        'filters': {name: {'about': doc} for name, doc in WAYS.items()},
        'groups': {job.group: {**_COMMON, **_ROWS[job.row]} for job in jobs},
    }


def _suite() -> Suite:
    """Suite that asks for GTSAM before anything is run."""
    suite = one_filter_suite('combined-imu', run_job, _describe)

    def read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
        gtsam_module()
        return suite.read(settings, columns)

    return replace(suite, read=read)


COMBINED_IMU = Experiment(
    'combined-imu',
    "GTSAM's CombinedImuFactor as shipped, and our smoother (needs gtsam); --rows PATTERN",
    Size(300.0, 20),
    Size(120.0, 2),
    (OURS,),
    plan,
    tables,
    suite=_suite(),
    selects=True,
)
