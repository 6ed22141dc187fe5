"""Scores of many bags: one bag with one configuration is one task, and one row of a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.errors import ConfigError, PolarNavError

from ..analysis.judged import judged_of
from ..scoring.honesty import HEADLINE_COLUMNS
from ..scoring.tables import Column, Table
from ..tasks.attempt import Task, failed
from ..tasks.execution import Update, Workers, execute, missing
from ..tasks.keys import key_of
from ..tasks.packing import unpack
from ..tasks.rows import DONE, FAILED, STOPPED, Row
from ..tasks.store import Store, begin, opened
from .named import NamedBag, expanded, has_pattern, named
from .task import BagScore, ScoreJob, score_job

_WHAT = f'{score_job.__module__}.{score_job.__qualname__}'
_MOST_SHOWN = 40
"""Rows from which on bags are not shown one by one."""


@dataclass(frozen=True)
class Order:
    """What somebody wants scored.

    Attributes
    ----------
    words : tuple of Path
        Bags and patterns.
    configurations : tuple of str
    out : Path
        File of the rows, which ends with ``.parquet``.
    vehicle : str or None
    workers : Workers
    resume, failed : bool
        Go on with the rows that are there; do those again that failed.
    """

    words: tuple[Path, ...]
    configurations: tuple[str, ...]
    out: Path
    vehicle: str | None = None
    workers: Workers = field(default_factory=Workers)
    resume: bool = False
    failed: bool = False


@dataclass(frozen=True)
class Scored:
    """One row: bag, configuration, and its score, None if there is none."""

    bag: str
    configuration: str
    row: Row
    score: BagScore | None


@dataclass(frozen=True)
class Outcome:
    """Result of scoring a fleet.

    Attributes
    ----------
    scored : list of Scored
        In the order of the bags and configurations.
    kept : int
        Rows that were there before.
    out : Path
    judged : tuple of str
        Configurations that decide whether all is well.
    uncertain : int
        Bags whose content is known by address and size only.
    """

    scored: list[Scored]
    kept: int
    out: Path
    judged: tuple[str, ...]
    uncertain: int = 0

    @property
    def bags(self) -> int:
        """Number of bags."""
        return len({one.bag for one in self.scored})

    @property
    def failed(self) -> list[Scored]:
        """Rows without a score."""
        return [one for one in self.scored if one.score is None]

    def complaints(self) -> list[str]:
        """Sentences about what is not well, one for each bag or run; empty if all is."""
        return list(dict.fromkeys(text for one in self.scored for text in self._of(one)))

    def _of(self, one: Scored) -> Iterator[str]:
        if one.score is None:
            yield f'{one.bag}, {one.configuration}: {one.row.reason}'
            return
        yield from _first(one.score.problems)
        if one.configuration in self.judged:
            yield from (f'{one.bag}: {text}' for text in _first(one.score.complaints))


def _first(texts: Sequence[str]) -> list[str]:
    """The first of several sentences, and how many follow."""
    if len(texts) <= 1:
        return list(texts)
    return [f'{texts[0]} (and {len(texts) - 1} more)']


def run(order: Order, update: Update, waiting: Callable[[], None]) -> Outcome:
    """Outcome of scoring bags, with the file of rows written.

    Parameters
    ----------
    order : Order
    update : callable
        Called with the number of finished rows, of all, and of failed ones.
    waiting : callable
        Called now and then while a scheduler has no worker.

    Raises
    ------
    ConfigError
        For a bag that does not exist, a pattern without a match, a file of another kind, or rows
        of an interrupted run that would be lost.
    """
    if order.out.suffix != '.parquet':
        raise ConfigError(f'--out: {order.out} does not end with .parquet')
    bags, broken = _named(order)
    tasks = tasks_of(bags, order.configurations, order.vehicle)
    with opened(order.out.parent, order.out.stem) as store:
        begin(store, resume=order.resume or order.failed)
        if order.failed:
            _forget_failed(store, tasks)
        kept = sum(task.key in store.rows for task in tasks)
        rows = execute(
            tasks, score_job, store, order.workers, update, failures=True, waiting=waiting
        )
        lost = [failed(task, error).row for task, error in broken]
        store.add(lost)
        everything = [
            *zip(tasks, rows, strict=True),
            *zip([t for t, _ in broken], lost, strict=True),
        ]
        store.finish([task.key for task, _ in everything])
    return Outcome(
        [_scored(task, row) for task, row in everything],
        kept,
        order.out,
        judged_of(order.configurations),
        sum(not bag.is_certain for _, bag in bags),
    )


def tasks_of(
    bags: Sequence[tuple[Path, NamedBag]], configurations: Sequence[str], vehicle: str | None
) -> list[Task]:
    """Tasks of bags; those of one bag follow one another."""
    return [
        Task(
            key_of(_WHAT, job := ScoreJob(bag, name, vehicle)),
            {'bag': str(path), 'configuration': name},
            job,
            str(path),
        )
        for path, bag in bags
        for name in configurations
    ]


def _named(
    order: Order,
) -> tuple[list[tuple[Path, NamedBag]], list[tuple[Task, PolarNavError]]]:
    """Bags by their contents, and tasks of those that a pattern names and nobody can look at."""
    bags, broken = [], []
    single = {p for w in order.words if not has_pattern(w) for p in expanded([w])}
    for path in expanded(order.words):
        try:
            bags.append((path, named(path)))
        except PolarNavError as error:
            if path in single:
                raise
            for name in order.configurations:
                names = {'bag': str(path), 'configuration': name}
                key = key_of(_WHAT, (str(path), name, order.vehicle))
                broken.append((Task(key, names, None), error))
    return bags, broken


def _forget_failed(store: Store, tasks: Sequence[Task]) -> None:
    """Forget the failed rows of these tasks, so that they are missing."""
    bad = missing(tasks, store, failed=True)
    if not bad:
        raise ConfigError(f'--failed: no row of these bags in {store.path} failed')
    for task in bad:
        store.rows.pop(task.key, None)


def _scored(task: Task, row: Row) -> Scored:
    score = None
    if row.status != FAILED:
        score = replace(unpack(BagScore, row.content), seconds=row.processor_s)
    return Scored(str(task.names['bag']), str(task.names['configuration']), row, score)


# -- tables

_BAG = Column('bag', 'bag')
_CONFIGURATION = Column('configuration', 'configuration')
_FIGURES = (
    Column('r_x', 'x', 'm', doc='RMS over the run, along grid east'),
    Column('r_y', 'y', 'm', doc='RMS over the run, along grid north'),
    Column('horizontal_second_half', '2-D, 2nd half', 'm', doc='RMS of the second half'),
)
_HONESTY = ('honesty', 'worst_per_dof')
_SEEN = (
    Column('fused', 'fused', doc='fixes used'),
    Column('received', 'of', doc='fixes with a verdict'),
    Column('available_percent', 'available', '%', 4, 'share of the run with an estimate'),
)


def tables(outcome: Outcome) -> list[Table]:
    """Tables of an outcome: bags, unless they are many, and configurations over all bags."""
    out = [_over_bags(outcome)]
    if len(outcome.scored) <= _MOST_SHOWN:
        out.insert(0, _of_bags(outcome))
    return out


def _of_bags(outcome: Outcome) -> Table:
    columns = (
        _BAG,
        _CONFIGURATION,
        *_FIGURES,
        *(c for c in HEADLINE_COLUMNS if c.key in _HONESTY),
        *_SEEN,
        Column('status', 'status', doc='done, stopped (the filter lost definiteness) or failed'),
    )
    keys = {c.key for c in columns}
    rows = []
    for one in outcome.scored:
        summary = {} if one.score is None else one.score.summary
        rows.append(
            {
                **{k: v for k, v in summary.items() if k in keys and v is not None},
                'bag': one.bag,
                'configuration': one.configuration,
                'status': one.row.status,
            }
        )
    return Table('Bags', columns, tuple(rows))


def _over_bags(outcome: Outcome) -> Table:
    columns = (
        _CONFIGURATION,
        *(Column(status, status, doc='bags') for status in (DONE, STOPPED, FAILED)),
        Column('median', '2-D, 2nd half, median', 'm', doc='of RMS of the second half, over bags'),
        Column('p90', '90 %', 'm', doc='quantile of the same'),
        Column('largest', 'largest', 'm', doc='of the same'),
        Column('worst', 'worst bag'),
        Column('honest', 'honest', doc='bags with an honest covariance'),
    )
    rows: list[dict[str, Any]] = []
    for name in dict.fromkeys(one.configuration for one in outcome.scored):
        own = [one for one in outcome.scored if one.configuration == name]
        counts = {s: sum(one.row.status == s for one in own) for s in (DONE, STOPPED, FAILED)}
        rows.append({'configuration': name, **counts, **_quantiles(own)})
    return Table('All bags', columns, tuple(rows))


def _quantiles(own: Sequence[Scored]) -> dict[str, Any]:
    scores = [(one.bag, one.score.summary) for one in own if one.score is not None]
    key = 'horizontal_second_half'
    errors = {bag: float(s[key]) for bag, s in scores if s.get(key) is not None}
    if not errors:
        return {}
    values = np.array(list(errors.values()))
    worst = max(errors, key=lambda bag: errors[bag])
    return {
        'median': float(np.median(values)),
        'p90': float(np.quantile(values, 0.9)),
        'largest': errors[worst],
        'worst': worst,
        'honest': sum(s.get('honesty') == 'honest' for _, s in scores),
    }
