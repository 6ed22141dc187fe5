"""Jobs of the experiment `mismatch`, in the form of all experiments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams
from polar_nav_core.errors import ConfigError

from ...scoring.tables import Column, Table
from ..choices import Choices, choices_from
from ..columns import filter_columns
from ..experiment import Experiment
from ..jobs import RunResult
from ..request import Request, Size
from ..station.columns import COLUMNS as STATION_COLUMNS
from ..suite import Paper, engine_suite
from .row import Row
from .rows import rows_named
from .runs import BEST, VISIBLE, MismatchJob, run_job
from .table import tables

COLUMNS = ('default', 'modified_akf', 'published', BEST)
"""Filters by default; a row runs those of its mode."""
_BEST_DOC = 'exact late fixes; its inputs are free of the fault, or its parameters state it'


def _known(mode: str, choices: Choices) -> dict[str, tuple[str, dict[str, Any]]]:
    """Text and engine parameters of the filters of a mode, by name."""
    if mode == 'station':
        found = {name: (c.doc, c.changes) for name, c in STATION_COLUMNS.items()}
    else:
        found = {
            name: (c.doc, c.changes)
            for name, c in filter_columns(choices).items()
            if not c.clairvoyant
        }
    return found


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[MismatchJob]:
    """Jobs of all rows, columns and seeds, and of the time at which a fault is visible.

    Raises
    ------
    ConfigError
        For a duration: rows have their own.
    """
    if request.duration_s is not None:
        raise ConfigError('--duration: every row of mismatch has its own')
    first = request.first_seed
    jobs = []
    for row in rows_named(request.rows):
        if not row.is_control:
            visible = 'when the fault is visible'
            stated = {**reserve(row.mode), **row.scene.changes}
            jobs += [
                MismatchJob(row, VISIBLE, visible, seed, stated)
                for seed in range(first, first + (size.seeds if row.fault.is_drawn() else 1))
            ]
        for seed in range(first, first + size.seeds):
            jobs += _row_jobs(row, seed, columns, request.choices)
    # Rows of one scene have the world of a seed in common, which takes longer to make than to run.
    return sorted(jobs, key=lambda job: (repr(job.row.scene), job.seed))


def as_stated(mode: str) -> dict[str, Any]:
    """Engine parameters of a user who states the classes of the sensors only.

    A world states that its sensors have no common error and that biases are constant; a user
    cannot know that, and has the defaults.
    """
    usual = EngineParams()
    names = NO_COMMON_ERRORS if mode == 'station' else (*NO_COMMON_ERRORS, *NO_RESERVE)
    return {name: getattr(usual, name) for name in names}


def reserve(mode: str) -> dict[str, Any]:
    """Engine parameters of the same user that change gains, not the published covariance only."""
    return {} if mode == 'station' else {n: getattr(EngineParams(), n) for n in NO_RESERVE}


def _row_jobs(row: Row, seed: int, columns: Sequence[str], choices: Choices) -> list[MismatchJob]:
    known = _known(row.mode, choices)
    engine = dict(choices.engine)
    known[BEST] = (_BEST_DOC, dict(row.scene.best))
    return [
        MismatchJob(
            row,
            name,
            known[name][0],
            seed,
            # The filter that knows the fault is a reference: it keeps its settings in all engines.
            known[name][1]
            if name == BEST
            else {**as_stated(row.mode), **row.scene.changes, **known[name][1], **engine},
        )
        for name in columns
        if name in known
    ]


def _read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
    for setting in settings:
        if not setting.strip().startswith('engine.'):
            raise ConfigError(f'--set {setting}: mismatch takes engine.PARAMETER only')
    choices = choices_from(settings)
    known = {*_known('sins', choices), *STATION_COLUMNS, BEST}
    for name in columns or ():
        if name not in known:
            raise ConfigError(f'--columns: no filter {name!r}; there are {", ".join(known)}')
    return {'choices': choices}


def _long_table(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    """Table of every number of every run, one row each."""
    del paper
    keys = list(dict.fromkeys(k for r in results for k in r.metrics))
    columns = (Column('row', 'row'), Column('filter', 'filter'), Column('seed', 'seed'))
    rows = [{'row': r.group, 'filter': r.column, 'seed': r.seed, **r.metrics} for r in results]
    return Table(title, (*columns, *(Column(k, k) for k in keys)), tuple(rows))


def _describe(jobs: Sequence[MismatchJob]) -> dict[str, Any]:
    rows = {job.row.name: job.row for job in jobs}
    return {
        'filters': {
            f'{job.row.mode}/{job.column}': {'about': job.doc, 'engine': dict(job.changes)}
            for job in jobs
        },
        'groups': {
            name: {
                'about': row.doc,
                'mode': row.mode,
                'size': row.size,
                'kind': type(row.fault).__name__,
                'fault': _finite(asdict(row.fault)),
                'culprits': list(row.culprits),
                'invisible': row.invisible,
                'duration_s': row.scene.duration_s,
            }
            for name, row in rows.items()
        },
    }


def _finite(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a fault, None for one that never ends: JSON has no infinity."""
    return {
        name: _finite(value)
        if isinstance(value, Mapping)
        else None
        if isinstance(value, float) and math.isinf(value)
        else value
        for name, value in fields.items()
    }


MISMATCH = Experiment(
    'mismatch',
    'Faults that the filter does not know: wrong, visible, reported? --rows PATTERN',
    Size(1200.0, 20),
    Size(1200.0, 1),
    COLUMNS,
    plan,
    tables,
    suite=engine_suite(_read, run_job, _long_table, _describe),
    selects=True,
)
