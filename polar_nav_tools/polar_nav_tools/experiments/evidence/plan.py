"""Experiments of cases, in the form of all experiments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from polar_nav_core.errors import ConfigError

from ...scoring.tables import Column, Table
from ..choices import choices_from
from ..experiment import Experiment
from ..jobs import RunResult
from ..request import Request, Size, rows_matching
from ..suite import Paper, engine_suite
from .case import Case
from .runs import EvidenceJob, run_job

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MakeCases = Callable[[float], Sequence[Case]]
"""Cases of runs of a length [s]."""
MakeTables = Callable[[Sequence[Case], Sequence[RunResult], Size], list[Table]]
_PACE_S = 60.0


def experiment_of(
    name: str,
    doc: str,
    sizes: tuple[Size, Size],
    cases: MakeCases,
    tables: MakeTables,
    *,
    apart: bool = False,
) -> Experiment:
    """Return the experiment of some cases; ``sizes`` are the full and the quick one.

    Cases of a seed share its noise, which compares them. ``apart``: each has seeds of its own, so
    that what chance does once is not counted in every case.
    """
    columns = tuple(dict.fromkeys(c for case in cases(_PACE_S) for c in case.columns))

    def plan(request: Request, size: Size, chosen: Sequence[str]) -> list[EvidenceJob]:
        engine = dict(request.choices.engine)
        made = cases(size.duration_s)
        wanted = {case.name for case in _chosen(made, request.rows)}
        firsts = [request.first_seed + k * size.seeds * apart for k in range(len(made))]
        return [
            EvidenceJob(case, column, seed, {} if column in case.fixed else engine)
            for case, first in zip(made, firsts, strict=True)
            if case.name in wanted
            for seed in range(first, first + size.seeds)
            for column in chosen
            if column in case.columns
        ]

    def all_tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
        first = request.first_seed
        made = cases(size.duration_s)
        last = first + size.seeds * (len(made) if apart else 1) - 1
        own = f', {size.seeds} of its own for each case' if apart else ''
        seeds = f'Seeds {first} to {last}{own}, runs of {size.duration_s:g} s. '
        found = tables(_chosen(made, request.rows), results, size)
        return [replace(table, note=seeds + table.note) for table in found]

    def read(settings: Sequence[str], names: Sequence[str] | None) -> dict[str, Any]:
        for setting in settings:
            if not setting.strip().startswith('engine.'):
                raise ConfigError(f'--set {setting}: {name} takes engine.PARAMETER only')
        for column in names or ():
            if column not in columns:
                raise ConfigError(f'--columns: no filter {column!r}; there are {columns}')
        return {'choices': choices_from(settings)}

    suite = engine_suite(read, run_job, _long_table, _describe)
    return Experiment(name, doc, *sizes, columns, plan, all_tables, suite=suite, selects=True)


def _chosen(cases: Sequence[Case], pattern: str | None) -> list[Case]:
    names = rows_matching(pattern, (c.name for c in cases))
    return [c for c in cases if c.name in names]


def of(results: Sequence[RunResult], case: Case, column: str) -> list[RunResult]:
    """Runs of a column of a case, by seed."""
    return [r for r in results if r.group == case.name and r.column == column]


def _long_table(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    """Table of every number of every run, one row each."""
    del paper
    keys = list(dict.fromkeys(k for r in results for k in r.metrics))
    columns = (Column('case', 'case'), Column('filter', 'filter'), Column('seed', 'seed'))
    rows = [
        {'case': r.group, 'filter': r.column, 'seed': r.seed, 'stopped': r.reason, **r.metrics}
        for r in results
    ]
    all_columns = (*columns, Column('stopped', 'stopped'), *(Column(k, k) for k in keys))
    return Table(title, all_columns, tuple(rows))


def _describe(jobs: Sequence[EvidenceJob]) -> dict[str, Any]:
    cases = {job.case.name: job.case for job in jobs}
    return {
        'filters': {
            f'{case.name}/{column}': dict(changes)
            for case in cases.values()
            for column, changes in case.columns.items()
        },
        'groups': {
            name: {'scene': asdict(case.scene), 'world': repr(case.shape)}
            for name, case in cases.items()
        },
    }


def _no_figures(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    del results, size, request
    return {}
