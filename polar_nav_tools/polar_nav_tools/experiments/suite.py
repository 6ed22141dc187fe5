"""Suite of the experiments of one published system, and that of the polar one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from polar_nav_core.errors import ConfigError

from ..scoring.tables import Column, Table
from .choices import choices_from
from .columns import pick, present
from .jobs import Job, RunResult, run_job
from .summary import long_table

if TYPE_CHECKING:
    from .request import Request

Paper = Callable[[str, str], Mapping[str, float]]
"""The paper's numbers for a group and a filter."""


@dataclass(frozen=True)
class Suite:
    """Suite of experiments: functions that make, run and describe jobs.

    Attributes
    ----------
    read : callable
        Fields of the request from ``--set`` and ``--columns``.
    present : callable
        Those of a list of filters that there are.
    run_job : callable
        Runs one job; a function of a module, for other processes run it.
    long_table : callable
        Every number of an experiment, for the CSV.
    choices : callable
        What a request chose, for the manifest.
    describe : callable
        Filters and groups of a plan, for the manifest.
    """

    read: Callable[[Sequence[str], Sequence[str] | None], dict[str, Any]]
    present: Callable[[Sequence[str]], list[str]]
    run_job: Callable[[Any], RunResult]
    long_table: Callable[[str, Sequence[RunResult], Paper | None], Table]
    choices: Callable[[Request], dict[str, Any]]
    describe: Callable[[Sequence[Any]], dict[str, Any]]


def _read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
    choices = choices_from(settings)
    pick(choices, columns or ())
    return {'choices': choices}


def _describe(plan: Sequence[Job]) -> dict[str, Any]:
    return {
        'filters': {
            job.column.name: {
                'about': job.column.doc,
                'engine': {**job.changes, **job.column.changes},
                'clairvoyant': job.column.clairvoyant,
            }
            for job in plan
        },
        'groups': {
            job.group: {'world': asdict(job.world), 'fixes': asdict(job.fixes)} for job in plan
        },
    }


def engine_suite(
    read: Callable[[Sequence[str], Sequence[str] | None], dict[str, Any]],
    run_job: Callable[[Any], RunResult],
    long_table: Callable[[str, Sequence[RunResult], Paper | None], Table],
    describe: Callable[[Sequence[Any]], dict[str, Any]],
) -> Suite:
    """Suite of an experiment of the engine, chosen by ``engine.PARAMETER``; all filters exist."""
    return Suite(
        read,
        list,
        run_job,
        long_table,
        lambda request: {'engine': dict(request.choices.engine)},
        describe,
    )


def one_filter_suite(
    name: str,
    run_job: Callable[[Any], RunResult],
    describe: Callable[[Sequence[Any]], dict[str, Any]],
) -> Suite:
    """Suite of an experiment of one filter, which takes no settings; its CSV has every number."""

    def read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
        if settings or columns:
            raise ConfigError(f'{name} has one filter and takes no --set, no --columns')
        return {'choices': choices_from([])}

    return engine_suite(read, run_job, _every_number, describe)


def _every_number(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    del paper
    keys = list(dict.fromkeys(k for r in results for k in r.metrics))
    columns = (Column('row', 'row'), Column('what', 'what'), Column('seed', 'seed'))
    rows = [{'row': r.group, 'what': r.column, 'seed': r.seed, **r.metrics} for r in results]
    return Table(title, (*columns, *(Column(k, k) for k in keys)), tuple(rows))


POLAR = Suite(
    _read, present, run_job, long_table, lambda request: asdict(request.choices), _describe
)
"""Of the polar cooperative navigation paper."""
