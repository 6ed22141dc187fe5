"""Experiment `calibrate`: error of each constant against its sigma and the Cramér-Rao bound.

The bound is made without the calibration's own rows: innovations of the filter in worlds in which
the constant is a little more and a little less off, all states being nuisance.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from polar_nav_core.engine.innovations import innovations

from ...calibration.constants import chosen
from ...calibration.estimate import estimate
from ...calibration.problem import in_common, prepared
from ...calibration.verdicts import Verdict, lines_of, problems
from ...scoring.tables import Column, Table
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch.faults import FixClock
from ..request import Request, Size, rows_matching
from ..suite import one_filter_suite
from .rows import ROWS, SCENES, Row, params_of, world_of

CALIBRATED, BOUND = 'calibrated', 'bound'
LARGEST_RATIO = 1.25
_BAND = 0.999
_PART, _PART_OF_CLOCK = 0.1, 1.0
"""Part of a fault whose effect is differenced; of a clock large against a step of the filter."""
_VERDICTS = tuple(Verdict)


@dataclass(frozen=True)
class CalibrateJob:
    """One run to make: a calibration, or with the column `BOUND` the bound of its row."""

    row: str
    scene: str
    duration_s: float
    column: str
    seed: int

    @property
    def group(self) -> str:
        """Name in tables."""
        return f'{self.row}_{self.scene}'


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[CalibrateJob]:
    """Jobs of all rows, scenes and seeds.

    Raises
    ------
    ConfigError
        For a pattern of rows that matches none.
    """
    del columns
    names = rows_matching(request.rows, (f'{r.name}_{s}' for s in SCENES for r in ROWS))
    jobs = []
    for scene in SCENES:
        for row in ROWS:
            job = CalibrateJob(row.name, scene, size.duration_s, BOUND, request.first_seed)
            if job.group not in names:
                continue
            jobs += [job] if len(row.off) == 1 else []
            jobs += [
                CalibrateJob(row.name, scene, size.duration_s, CALIBRATED, seed)
                for seed in range(request.first_seed, request.first_seed + size.seeds)
            ]
    return jobs


def run_job(job: CalibrateJob) -> RunResult:
    """Result of one job: errors, sigmas and verdicts of the constants, or the bound."""
    begin = time.process_time()
    row = next(r for r in ROWS if r.name == job.row)
    reason = ''
    if job.column == BOUND:
        (name,) = row.off
        metrics = {f'{name}.bound': bound(row, job.scene, job.duration_s, job.seed)}
    else:
        world = row.world(job.scene, job.duration_s, job.seed)
        params = params_of(world)
        constants = chosen(params, world.inputs, tuple(row.off))
        found = estimate(params, world.inputs, constants)
        reason = '; '.join(problems(found))
        metrics = {}
        for line in lines_of(found):
            name = line.constant.name
            metrics[f'{name}.error'] = line.value - row.off[name]
            metrics[f'{name}.sigma'] = line.sigma
            metrics[f'{name}.verdict'] = float(_VERDICTS.index(line.verdict))
    stopped_s = job.duration_s if reason else math.nan
    seconds = time.process_time() - begin
    return RunResult(job.group, job.column, job.seed, metrics, stopped_s, reason, {}, seconds)


def bound(row: Row, scene: str, duration_s: float, seed: int) -> float:
    """Cramér-Rao bound of a row's constant, in its unit: least sigma of an unbiased estimate."""
    (off,) = row.off.values()
    (fault,) = row.faults
    part = _PART_OF_CLOCK if isinstance(fault, FixClock) else _PART
    right = world_of(scene, duration_s, seed)
    params = prepared(params_of(right), ())
    more, less = (
        innovations(params, fault.applied(right, sign * part).inputs) for sign in (1.0, -1.0)
    )
    up, down = in_common(more, less)
    slope = (more.white[up] - less.white[down]) / (2.0 * part * off)
    return float(1.0 / np.sqrt(np.sum(slope**2)))


_COLUMNS = (
    Column('group', 'off, scene'),
    Column('constant', 'constant'),
    Column('off', 'off by'),
    Column('rms', 'RMS'),
    Column('sigma', '1-sigma', doc='stated, root mean square'),
    Column('bound', 'bound', doc='Cramér-Rao, of the first seed'),
    Column('ratio', 'RMS / bound', doc='or, of several constants at once, / 1-sigma'),
    Column('nees', 'NEES', doc='mean of (error / 1-sigma)²'),
    Column('band', 'band', doc=f'{100 * _BAND:g} % of that, for so many seeds'),
    Column('unit', 'unit'),
    Column('verdicts', 'verdicts'),
    Column('well', 'well', doc=f'ratio at most {LARGEST_RATIO:g}, NEES in the band; or not shown'),
)
_UNITS = {
    'delay': 's', 'dvl_yaw': 'deg', 'dvl_scale': '%', 'dvl_lever_x': 'm', 'dvl_latency': 's',
    'array_yaw': 'deg', 'range_scale': '%',
}  # fmt: skip


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Table of the constants, a row for each in each scene."""
    bounds = {r.group: r.metrics for r in results if r.column == BOUND}
    body = []
    for group in dict.fromkeys(r.group for r in results):
        runs = [r for r in results if r.group == group and r.column == CALIBRATED]
        row = next(r for r in ROWS if r.name == group.rsplit('_', 1)[0])
        for name in row.off:
            found = bounds.get(group, {}).get(f'{name}.bound', math.nan)
            body.append({'group': group, **_line(row, name, runs, found)})
    first = request.first_seed
    title = f'Calibration, {size.duration_s:g} s, seeds {first} to {first + size.seeds - 1}'
    return [Table(title, _COLUMNS, tuple(body))]


def _line(row: Row, name: str, runs: Sequence[RunResult], least_sigma: float) -> dict[str, object]:
    def all_of(key: str) -> np.ndarray:
        return np.array([r.metrics[f'{name}.{key}'] for r in runs if r.metrics])

    error, sigma = all_of('error'), all_of('sigma')
    verdicts = [_VERDICTS[int(v)] for v in all_of('verdict')]
    n = len(error)
    rms, stated = float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(sigma**2)))
    ratio = rms / (least_sigma if math.isfinite(least_sigma) else stated)
    nees = float(np.mean((error / sigma) ** 2))
    low, high = chi2.ppf([0.5 - 0.5 * _BAND, 0.5 + 0.5 * _BAND], n) / n
    shown = any(v is Verdict.ESTIMATED for v in verdicts) or name == 'array_yaw'
    well = (ratio <= LARGEST_RATIO and low <= nees <= high) if shown else True
    line: dict[str, object] = {
        'constant': name,
        'off': row.off[name],
        'rms': rms,
        'sigma': stated,
        'ratio': ratio,
        'nees': nees,
        'band': f'{low:.2f} to {high:.2f}',
        'unit': _UNITS[name],
        'verdicts': ', '.join(f'{k} {v}' for v, k in Counter(verdicts).items()),
        'well': 'yes' if well and not any(r.reason for r in runs) else 'no',
    }
    if math.isfinite(least_sigma):
        line['bound'] = least_sigma
    return line


def _describe(jobs: Sequence[CalibrateJob]) -> dict[str, Any]:
    return {
        'filters': {CALIBRATED: {'engine': {'configuration': 'default'}}},
        'groups': {
            job.group: {'scene': job.scene, 'off': dict(row.off)}
            for job in jobs
            for row in ROWS
            if row.name == job.row
        },
    }


CALIBRATE = Experiment(
    'calibrate',
    'Constants that are off, found by `./polar calibrate`: error against sigma and bound',
    Size(600.0, 20),
    Size(300.0, 2),
    (CALIBRATED,),
    plan,
    tables,
    suite=one_filter_suite('calibrate', run_job, _describe),
    selects=True,
)
