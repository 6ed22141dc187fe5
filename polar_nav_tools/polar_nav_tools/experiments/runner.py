"""Results of jobs as tasks: in this process, in others, or by a Dask scheduler; kept as rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, get_type_hints

from ..tasks.attempt import Task
from ..tasks.execution import Workers, execute
from ..tasks.keys import key_of
from ..tasks.packing import unpack
from ..tasks.rows import Row
from ..tasks.store import Store
from .jobs import RunResult, run_job

Update = Callable[[float, float], None]
RunJob = Callable[[Any], RunResult]


def tasks_of(jobs: Sequence[Any], run: RunJob) -> list[Task]:
    """Tasks of jobs, in their order.

    Jobs in one world should follow one another, so that a process that keeps its last world does
    them all; those that follow one another with one seed are taken for such.
    """
    what = f'{run.__module__}.{run.__qualname__}'
    return [
        Task(key_of(what, job), _names_of(job), job, getattr(job, 'seed', None)) for job in jobs
    ]


def _names_of(job: object) -> dict[str, str | int | float]:
    """Group, filter and seed, as far as a job has them: a run without a result is named, too."""
    row, column = getattr(job, 'row', None), getattr(job, 'column', None)
    found = {
        'group': getattr(job, 'group', getattr(row, 'name', None)),
        'filter': getattr(column, 'name', column),
        'seed': getattr(job, 'seed', None),
    }
    return {name: value for name, value in found.items() if isinstance(value, (str, int))}


def result_of(row: Row, run: RunJob) -> RunResult:
    """Result that a row holds, of the kind that the function returns."""
    kind: type[RunResult] = get_type_hints(run)['return']
    return replace(unpack(kind, row.content), seconds=row.processor_s)


def run_jobs(
    tasks: Sequence[Task],
    workers: Workers,
    store: Store,
    update: Update,
    run: RunJob = run_job,
) -> list[RunResult]:
    """Results of all jobs, in their order.

    Parameters
    ----------
    tasks : sequence of Task
        Of jobs (`tasks_of`).
    workers : Workers
    store : Store
        Rows that it has are not made again; the others are added as they come.
    update : callable
        Called with the number of finished jobs and the total.
    run : callable
        Runs one job; a function of a module.
    """
    rows = execute(
        tasks,
        run,
        store,
        workers,
        lambda done, total, _: update(float(done), float(total)),
    )
    return [result_of(row, run) for row in rows]
