"""Experiment `bluerov2`: a cheap vehicle through its mapping file, beside a simple filter.

Each seed is written as an MCAP bag of the drivers' own types and replayed as any bag is; errors
are against the vehicle's motion, which no code of the navigation had a part in.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from polar_nav_core.engine.health.conditions import Culprit
from polar_nav_core.engine.health.radius import radius_95
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.mapping import with_parameters

from ...foreign.replay import ForeignRun, replay
from ...foreign.sources import open_source
from ...scoring.tables import Column, Table
from ..choices import choices_from
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch.judge import WARN
from ..request import Request, Size
from ..suite import Paper, engine_suite
from . import baseline, recording, vehicle

BASELINE = 'baseline'
COVERAGE_GOAL, ERROR_GOAL = 0.9, 1.0
"""Share of the time within the stated 95 % radius; RMS over that of the simple filter."""
_WHITE = 'sigma: 2.5'
_SLOW = 'sigma: 1.2, slow_sigma: 2.0, correlation_s: 60'
COLUMNS: dict[str, str] = {'default': _SLOW, 'white': _WHITE, 'own_pings': _SLOW}
"""What the mapping states of the fixes, by column."""
_PING_SIGMA, _OWN_SIGMA = 0.03, 0.005
"""Sigma per ping that the mapping states, and that which the pings have [m/s]."""
PINGS: dict[str, float] = {'own_pings': _OWN_SIGMA}
"""What it states of the pings, where that is another sigma."""
_MAPPING = """
version: 2
vehicle: auv
imu: {{topic: {imu}, type: sensor_msgs/msg/Imu}}
dvl: {{topic: {dvl}, type: {dvl_type}, rotation: frd, lever_b: [-0.1, 0.0, -0.15], sigma: {pings}}}
depth: {{topic: {pressure}, type: sensor_msgs/msg/FluidPressure}}
fixes:
  - {{topic: {fix}, type: sensor_msgs/msg/NavSatFix, source: ugps, {fixes}}}
initial: {initial}
noise: {{imu: vn100, dvl: a50_standard}}
"""


@dataclass(frozen=True)
class CheapJob:
    """One run to make: a column at a seed."""

    column: str
    seed: int
    duration_s: float
    engine: Mapping[str, Any] = field(default_factory=dict)


@lru_cache(maxsize=1)
def _readings(seed: int, duration_s: float) -> recording.Readings:
    return recording.readings(seed, duration_s)


def mapping_text(
    r: recording.Readings, fixes: str = _SLOW, ping_sigma: float = _PING_SIGMA
) -> str:
    """Mapping file of the vehicle; it starts at the first fix with the heading of its AHRS.

    Parameters
    ----------
    r : Readings
    fixes : str
        What it states of the errors of its fixes.
    ping_sigma : float
        And of its pings [m/s].
    """
    yaw_deg = Rotation.from_quat(r.imu.quaternion_xyzw[0]).as_euler('ZYX', degrees=True)[0]
    heading = f'heading_deg: {90.0 - yaw_deg:.3f}'
    initial = f'{{from: topic, topic: {recording.FIX}, {heading}}}'
    return _MAPPING.format(
        imu=recording.IMU,
        dvl=recording.DVL,
        dvl_type=recording.DVL_TYPE,
        pressure=recording.PRESSURE,
        fix=recording.FIX,
        fixes=fixes,
        pings=ping_sigma,
        initial=initial,
    )


def run_job(job: CheapJob) -> RunResult:
    """Result of one run."""
    r = _readings(job.seed, job.duration_s)
    start = time.process_time()
    if job.column == BASELINE:
        track = baseline.run(r.imu, r.dvl, r.fixes, baseline.Tuning())
        metrics = _errors(r, track.time_s, track.position_n)
        metrics |= _jumps(r.fixes, ~track.refused, np.zeros(len(track.refused), dtype=bool))
        verdicts = Counter('REFUSED' if x else 'FUSED' for x in track.refused)
        return _result(job, metrics, '', verdicts, start)
    with tempfile.TemporaryDirectory() as folder:
        path = recording.write(Path(folder) / 'bag', r)
        text = mapping_text(r, COLUMNS[job.column], PINGS.get(job.column, _PING_SIGMA))
        mapping = mapping_file.parse(text, 'bluerov2')
        ran = replay(open_source(path), with_parameters(mapping, job.engine))
    return _result(job, _measured(r, ran), ran.divergence, Counter(ran.verdicts), start)


def _result(
    job: CheapJob, metrics: dict[str, float], reason: str, verdicts: Counter[str], start: float
) -> RunResult:
    return RunResult(
        'bluerov2',
        job.column,
        job.seed,
        metrics,
        math.nan,
        reason,
        dict(verdicts),
        time.process_time() - start,
    )


def _measured(r: recording.Readings, ran: ForeignRun) -> dict[str, float]:
    """Errors once a second, share within the stated radius, and what became of jumps."""
    e = ran.estimates
    rows = slice(None, None, 10)
    seconds = np.asarray((e.stamp_ns[rows] - recording.START_NS) * 1e-9, dtype=np.float64)
    position_n = vehicle.level_of(e.latitude[rows], e.longitude[rows])
    metrics = _errors(r, seconds, position_n)
    off = _off(r, seconds, position_n)
    radius = np.array([radius_95(P[:2, :2]) for P in e.P_position_G[rows]])
    yaw = np.interp(seconds, r.motion.time_s, r.motion.euler[:, 0])
    turned = np.angle(np.exp(1j * (e.true_heading[rows] - yaw)))
    metrics |= {
        'covered': float(np.mean(off <= radius)),
        'radius': float(np.median(radius)),
        'heading': float(np.degrees(np.sqrt(np.mean(turned**2)))),
        'misfits': float(len(ran.complaints())),
    }
    since_s = np.array([(h.stamp_ns - recording.START_NS) * 1e-9 for h in ran.health])
    of_fixes = [h.level >= WARN and bool(h.culprit & Culprit.FIXES) for h in ran.health]
    alarm_s = since_s[of_fixes]
    fused = _fused(r.fixes, ran.receipts)
    warned = np.array([np.any((alarm_s >= s) & (alarm_s < s + 30.0)) for s in r.fixes.time_s])
    return metrics | _jumps(r.fixes, fused, warned)


def _fused(fixes: vehicle.Fixes, receipts: Sequence[Receipt]) -> NDArray[np.bool_]:
    """Which fixes were fused; the one that the start was from was."""
    stamps_ns = recording.START_NS + np.round(fixes.time_s * 1e9).astype(np.int64)
    found = {x.validity_ns for x in receipts if x.source and x.verdict == Verdict.FUSED}
    fused = np.array([int(s) in found for s in stamps_ns])
    fused[0] = True
    return fused


def _off(
    r: recording.Readings, seconds: vehicle.Floats, position_n: vehicle.Floats
) -> vehicle.Floats:
    """Horizontal distance from the motion [m]."""
    m = r.motion
    true = np.column_stack([np.interp(seconds, m.time_s, m.position_n[:, i]) for i in range(2)])
    return np.asarray(np.hypot(*(position_n - true).T))


def _errors(
    r: recording.Readings, seconds: vehicle.Floats, position_n: vehicle.Floats
) -> dict[str, float]:
    off = _off(r, seconds, position_n)
    return {'rms': float(np.sqrt(np.mean(off**2))), 'worst': float(off.max())}


def _jumps(
    fixes: vehicle.Fixes, fused: NDArray[np.bool_], warned: NDArray[np.bool_]
) -> dict[str, float]:
    """Jumps, those of which a fix was fused, and those of them that nothing was said of."""
    starts = np.flatnonzero(fixes.jumped & ~np.concatenate([[False], fixes.jumped[:-1]]))
    ends = np.flatnonzero(fixes.jumped & ~np.concatenate([fixes.jumped[1:], [False]])) + 1
    spans = [slice(a, b) for a, b in zip(starts, ends, strict=True)]
    fell = [s for s in spans if fused[s].any()]
    silent = [s for s in fell if not warned[s].any()]
    return {'jumps': len(spans), 'jumps_fused': len(fell), 'jumps_silent': len(silent)}


_TABLE = (
    Column('filter', 'filter'),
    Column('rms', 'RMS, pooled', 'm'),
    Column('ratio', 'of the simple filter'),
    Column('rms_seeds', 'least to largest of the seeds', 'm'),
    Column('worst', 'largest', 'm'),
    Column('covered', 'within the 95 % radius', '%'),
    Column('covered_least', 'least of the seeds', '%'),
    Column('radius', 'radius, median', 'm'),
    Column('heading', 'heading, RMS', 'deg'),
    Column('jumps', 'jumps'),
    Column('jumps_fused', 'with a fix fused'),
    Column('jumps_silent', 'without a report'),
    Column('stopped', 'stopped'),
)


def _pooled(runs: Sequence[RunResult], key: str) -> float:
    return float(np.sqrt(np.mean([r.metrics[key] ** 2 for r in runs])))


def _tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    by: dict[str, list[RunResult]] = {}
    for result in results:
        by.setdefault(result.column, []).append(result)
    rows: list[dict[str, object]] = []
    for name, runs in by.items():
        rms = [r.metrics['rms'] for r in runs]
        row: dict[str, object] = {
            'filter': name,
            'rms': _pooled(runs, 'rms'),
            'rms_seeds': f'{min(rms):.2f} to {max(rms):.2f}',
            'worst': max(r.metrics['worst'] for r in runs),
            **{
                key: int(sum(r.metrics[key] for r in runs))
                for key in ('jumps', 'jumps_fused', 'jumps_silent')
            },
            'stopped': sum(r.stopped for r in runs),
        }
        if BASELINE in by:
            row['ratio'] = _pooled(runs, 'rms') / _pooled(by[BASELINE], 'rms')
        if name != BASELINE:
            covered = [100.0 * r.metrics['covered'] for r in runs]
            row |= {
                'covered': float(np.mean(covered)),
                'covered_least': min(covered),
                'radius': float(np.median([r.metrics['radius'] for r in runs])),
                'heading': _pooled(runs, 'heading'),
            }
        rows.append(row)
    first = request.first_seed
    note = (
        f'Seeds {first} to {first + size.seeds - 1}, runs of {size.duration_s:g} s. Goal: at least'
        f' {100 * COVERAGE_GOAL:g} % of the time within the stated 95 % radius, pooled RMS at most'
        f' {ERROR_GOAL:g} times that of the simple filter, no jump fused without a report.'
    )
    return [Table('A vehicle of the BlueROV2 kind, UGPS', _TABLE, tuple(rows), note)]


def _plan(request: Request, size: Size, columns: Sequence[str]) -> list[CheapJob]:
    seeds = range(request.first_seed, request.first_seed + size.seeds)
    engine = dict(request.choices.engine)
    return [CheapJob(c, seed, size.duration_s, engine) for seed in seeds for c in columns]


def _read(settings: Sequence[str], names: Sequence[str] | None) -> dict[str, Any]:
    for setting in settings:
        if not setting.strip().startswith('engine.'):
            raise ConfigError(f'--set {setting}: bluerov2 takes engine.PARAMETER only')
    known = (*COLUMNS, BASELINE)
    for name in names or ():
        if name not in known:
            raise ConfigError(f'--columns: no filter {name!r}; there are {", ".join(known)}')
    return {'choices': choices_from(settings)}


def _long_table(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    del paper
    keys = list(dict.fromkeys(k for r in results for k in r.metrics))
    columns = (Column('filter', 'filter'), Column('seed', 'seed'), Column('stopped', 'stopped'))
    rows = [
        {'filter': r.column, 'seed': r.seed, 'stopped': r.reason, **r.metrics} for r in results
    ]
    return Table(title, (*columns, *(Column(k, k) for k in keys)), tuple(rows))


def _describe(jobs: Sequence[CheapJob]) -> dict[str, Any]:
    return {
        'filters': {j.column: {'fixes': COLUMNS.get(j.column, ''), **j.engine} for j in jobs},
        'groups': {'bluerov2': {'mapping': _MAPPING, 'tuning': repr(baseline.Tuning())}},
    }


BLUEROV2 = Experiment(
    'bluerov2',
    'A cheap vehicle of AHRS, DVL and UGPS by its mapping file: error, stated radius, jumps',
    Size(1200.0, 20),
    Size(200.0, 1),
    (*COLUMNS, BASELINE),
    _plan,
    _tables,
    suite=engine_suite(_read, run_job, _long_table, _describe),
    selects=True,
)
