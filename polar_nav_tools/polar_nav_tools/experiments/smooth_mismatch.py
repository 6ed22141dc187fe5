"""Experiment `smooth-mismatch`: filter and smoother in the worlds of the mismatch table.

A smoother is surer than its filter, so that what a filter covers it may not. The rows, the faults
and the definition of a wrong estimate are those of `mismatch`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from polar_nav_core.engine.health.span import span_of_health
from polar_nav_core.errors import ConfigError

from ..scoring.tables import Column, Table
from ..series.run import FILTER, SMOOTHER
from .experiment import Experiment
from .jobs import RunResult
from .mismatch.judge import Course, errors_of, is_wrong, shares_beyond
from .mismatch.plan import as_stated
from .mismatch.row import Row
from .mismatch.rows import rows_named
from .request import Request, Size
from .suite import one_filter_suite

_BEYOND = 4.0


@dataclass(frozen=True)
class SmoothMismatchJob:
    """One world with a fault to be filtered and smoothed."""

    row: Row
    column: str
    seed: int

    @property
    def group(self) -> str:
        """Name in tables."""
        return self.row.name


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[SmoothMismatchJob]:
    """Jobs of all rows and seeds.

    Raises
    ------
    ConfigError
        For a duration: rows have their own.
    """
    del columns
    if request.duration_s is not None:
        raise ConfigError('--duration: every row of smooth-mismatch has its own')
    seeds = range(request.first_seed, request.first_seed + size.seeds)
    return [SmoothMismatchJob(row, SMOOTHER, s) for row in rows_named(request.rows) for s in seeds]


def run_job(job: SmoothMismatchJob) -> RunResult:
    """Result of one job: errors of both tracks in the second half."""
    begin = time.process_time()
    row = job.row
    scene: Any = row.scene
    world: Any = row.fault.applied(scene.make(job.seed), 1.0)
    changes = {
        **as_stated(row.mode),
        **scene.changes,
        'configuration': 'default',
        **row.fault.for_all,
    }
    ran = scene.run(world, changes)
    course, unsettled = scene.smoothed(world, changes)
    said = unsettled or ran.divergence or span_of_health(ran.health).any_word
    metrics = {'unsettled': float(bool(unsettled)), 'said': float(bool(said))}
    for name, of in ((FILTER, ran.course), (SMOOTHER, course)):
        metrics |= {f'{name}.{key}': value for key, value in _measured(of).items()}
    stopped_s = course.duration_s if ran.divergence else math.nan
    seconds = time.process_time() - begin
    return RunResult(
        job.group, job.column, job.seed, metrics, stopped_s, ran.divergence, {}, seconds
    )


def _measured(course: Course) -> dict[str, float]:
    found = errors_of(course)
    return {
        'rms': found.get('rms', math.inf),
        'said': found.get('said', math.nan),
        'beyond': max(shares_beyond(course, _BEYOND).values()),
        'wrong': float(is_wrong(course)),
    }


_COLUMNS = (
    Column('row', 'world'),
    Column('filter_rms', 'filter', 'm', doc='horizontal RMS, second half, median of the seeds'),
    Column('filter_wrong', 'wrong', doc='seeds beyond 4 sigma for more than 5 % of it'),
    Column('smoother_rms', 'smoother', 'm', doc='the same'),
    Column('smoother_wrong', 'wrong', doc='the same'),
    Column('beyond', 'beyond 4σ', doc='share of it, largest of position, heading, velocity; mean'),
    Column('silent', 'silent', doc='seeds whose smoother is wrong, and `./polar smooth` no word'),
    Column('unsettled', 'not settled', doc='seeds whose smoother says that it has not settled'),
)


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Table of filter and smoother, a row for each world."""
    body: list[dict[str, object]] = []
    for group in dict.fromkeys(r.group for r in results):
        runs = [r.metrics for r in results if r.group == group and r.metrics]
        n = len(runs)
        line: dict[str, object] = {'row': group}
        for name in (FILTER, SMOOTHER):
            line[f'{name}_rms'] = float(np.median([m[f'{name}.rms'] for m in runs]))
            line[f'{name}_wrong'] = f'{sum(m[f"{name}.wrong"] for m in runs):.0f} of {n}'
        line['beyond'] = float(np.mean([m[f'{SMOOTHER}.beyond'] for m in runs]))
        silent = sum(m[f'{SMOOTHER}.wrong'] and not m['said'] for m in runs)
        line['silent'] = f'{silent:.0f} of {n}'
        line['unsettled'] = f'{sum(m["unsettled"] for m in runs):.0f} of {n}'
        body.append(line)
    last = request.first_seed + size.seeds - 1
    title = f'Filter and smoother where the world differs, seeds {request.first_seed} to {last}'
    return [Table(title, _COLUMNS, tuple(body))]


def _describe(jobs: Sequence[SmoothMismatchJob]) -> dict[str, Any]:
    rows = {job.row.name: job.row for job in jobs}
    return {
        'filters': {SMOOTHER: {'engine': {'configuration': 'default'}}},
        'groups': {name: {'about': row.doc, 'size': row.size} for name, row in rows.items()},
    }


SMOOTH_MISMATCH = Experiment(
    'smooth-mismatch',
    'Filter and smoother in the worlds of mismatch: wrong? --rows PATTERN',
    Size(1200.0, 20),
    Size(1200.0, 1),
    (SMOOTHER,),
    plan,
    tables,
    suite=one_filter_suite('smooth-mismatch', run_job, _describe),
    selects=True,
)
