"""Statistics of runs over seeds: median and spread, pooled RMS, mean and deviation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...scoring.tables import MISSING, Column, Table, show
from ..jobs import RunResult
from ..summary import of, spread
from .paper import ALL, COUNT, MEAN, POOLED, QUANTITIES, Quantity


def values_of(runs: Sequence[RunResult], key: str) -> np.ndarray:
    """Values of one metric, of the runs that have it."""
    return np.array([r.metrics[key] for r in runs if key in r.metrics])


def pooled(runs: Sequence[RunResult], key: str) -> float:
    """Root mean square of an RMS over runs of equal length; NaN without any."""
    values = values_of(runs, key)
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def deviation(runs: Sequence[RunResult], key: str) -> float:
    """Standard deviation over the runs; NaN for fewer than two, or one that is infinite."""
    values = values_of(runs, key)
    if values.size < 2 or not np.isfinite(values).all():
        return math.nan
    return float(np.std(values, ddof=1))


def cell(runs: Sequence[RunResult], quantity: Quantity) -> str:
    """Table cell of one quantity of some runs."""
    values = values_of(runs, quantity.key)
    if not values.size:
        return MISSING
    if quantity.how == COUNT:
        return f'{np.count_nonzero(values)} of {values.size}'
    if quantity.how == POOLED:
        text = show(pooled(runs, quantity.key))
    elif quantity.how == MEAN:
        text = show(float(values.mean()))
        return text if values.size == 1 else f'{text} ± {show(deviation(runs, quantity.key), 2)}'
    else:
        text = show(float(np.median(values)))
    if values.size == 1:
        return text
    return f'{text} ({show(float(values.min()))} to {show(float(values.max()))})'


HOW = (
    'RMS: pooled over the seeds (lowest to highest of a seed); largest errors and times: median '
    '(lowest to highest); the rest: mean ± standard deviation over the seeds.'
)


@dataclass(frozen=True)
class Side:
    """A column of a table: runs, or the paper's claims."""

    title: str
    runs: Sequence[RunResult] = ()
    paper: Mapping[str, float] | None = None

    def text(self, quantity: Quantity) -> str:
        """Cell of a quantity."""
        if self.paper is None:
            return cell(self.runs, quantity)
        value = self.paper.get(quantity.key)
        return MISSING if value is None else f'{value:g}'


def comparison(
    title: str,
    sides: Sequence[Side],
    note: str,
    quantities: Sequence[Quantity] = QUANTITIES,
) -> Table:
    """Table with a row per quantity, a column per filter and for the paper."""
    columns = [Column('quantity', 'quantity'), Column('unit', 'unit')]
    columns += [Column(f's{i}', side.title) for i, side in enumerate(sides)]
    rows = []
    for q in quantities:
        row: dict[str, object] = {'quantity': q.title, 'unit': q.unit}
        row |= {f's{i}': side.text(q) for i, side in enumerate(sides)}
        rows.append(row)
    return Table(title, tuple(columns), tuple(rows), note)


def by_group(
    title: str,
    results: Sequence[RunResult],
    quantities: Sequence[Quantity],
    note: str,
    first: str = 'case',
) -> Table:
    """Table with a row per group and filter, a column per quantity."""
    columns = [Column('group', first), Column('filter', 'filter')]
    columns += [Column(q.key, q.title, q.unit) for q in quantities]
    rows = []
    for group, name in dict.fromkeys((r.group, r.column) for r in results):
        runs = of(results, group, name)
        row: dict[str, object] = {'group': group, 'filter': name}
        row |= {q.key: cell(runs, q) for q in quantities}
        rows.append(row)
    return Table(title, tuple(columns), tuple(rows), note)


def long_table(
    title: str,
    results: Sequence[RunResult],
    paper: Callable[[str, str], Mapping[str, float]] | None = None,
) -> Table:
    """Table for CSV, one row per group, filter and quantity."""
    names = (
        'group', 'filter', 'quantity', 'unit', 'runs', 'median', 'lowest', 'highest', 'mean',
        'deviation', 'pooled_rms', 'paper',
    )  # fmt: skip
    rows = []
    for group, name in dict.fromkeys((r.group, r.column) for r in results):
        runs = of(results, group, name)
        printed = paper(group, name) if paper else {}
        for q in ALL:
            values = values_of(runs, q.key)
            if not values.size:
                continue
            s = spread(runs, q.key)
            rows.append(
                {
                    'group': group,
                    'filter': name,
                    'quantity': q.key,
                    'unit': q.unit,
                    'runs': int(values.size),
                    'median': s.median,
                    'lowest': s.low,
                    'highest': s.high,
                    'mean': float(values.mean()),
                    'deviation': deviation(runs, q.key),
                    'pooled_rms': pooled(runs, q.key),
                    'paper': printed.get(q.key),
                }
            )
    return Table(title, tuple(Column(n, n) for n in names), tuple(rows))
