"""Runs over seeds in tables: median and spread, beside the paper's numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..scoring.tables import MISSING, Column, Table, show
from .jobs import RunResult
from .paper import QUANTITIES, Quantity

EXTRA = (
    Quantity('r', 'r, horizontal', 'm'),
    Quantity('lag', 'r, behind the truth (mean)', 'm'),
    Quantity('nees', 'e²/P, all states', ''),
    Quantity('nees_position', 'e²/P, position', ''),
)
"""What the paper does not print."""


@dataclass(frozen=True)
class Spread:
    """One number of several runs."""

    count: int
    stopped: int
    median: float
    low: float
    high: float

    def text(self) -> str:
        """Median, and in brackets lowest and highest where there are several."""
        if self.count == 0:
            return MISSING
        body = show(self.median)
        if self.count > 1:
            body += f' ({show(self.low)} to {show(self.high)})'
        if self.stopped:
            body += f'; {self.stopped} of {self.count + self.stopped} stopped'
        return body


def spread(runs: Sequence[RunResult], key: str) -> Spread:
    """Median and range of one metric over the runs that did not stop."""
    values = np.array([r.metrics[key] for r in runs if key in r.metrics])
    stopped = sum(r.stopped for r in runs)
    if values.size == 0:
        nan = float('nan')
        return Spread(0, stopped, nan, nan, nan)
    return Spread(
        int(values.size),
        stopped,
        float(np.median(values)),
        float(values.min()),
        float(values.max()),
    )


def of(results: Sequence[RunResult], group: str, column: str) -> list[RunResult]:
    """Runs of one group and filter."""
    return [r for r in results if r.group == group and r.column == column]


@dataclass(frozen=True)
class Side:
    """A column of a table: the runs of one filter, or the paper's numbers."""

    title: str
    runs: Sequence[RunResult] = ()
    paper: Mapping[str, float] | None = None


def comparison(title: str, sides: Sequence[Side], note: str, *, half: bool = False) -> Table:
    """Quantities down, filters and the paper across.

    Parameters
    ----------
    half : bool
        Numbers of the second half of the run; the paper has only the whole.
    """
    suffix = '_half' if half else ''
    columns = [Column('quantity', 'RMS'), Column('unit', 'unit')]
    columns += [Column(f's{i}', side.title) for i, side in enumerate(sides)]
    rows = []
    for q in (*QUANTITIES, *EXTRA):
        row: dict[str, object] = {'quantity': q.title, 'unit': q.unit}
        for i, side in enumerate(sides):
            row[f's{i}'] = _cell(side, q.key, suffix)
        rows.append(row)
    row = {'quantity': 'stopped after', 'unit': 's'}
    for i, side in enumerate(sides):
        row[f's{i}'] = stops(side.runs)
    rows.append(row)
    return Table(title, tuple(columns), tuple(rows), note)


def stops(runs: Sequence[RunResult]) -> str:
    """When the runs that stopped did so, median [s], and how many."""
    times = [r.stopped_s for r in runs if r.stopped]
    if not times:
        return MISSING
    text = show(float(np.median(times)))
    return text if len(runs) == 1 else f'{text} ({len(times)} of {len(runs)} runs)'


def _cell(side: Side, key: str, suffix: str) -> str:
    if side.paper is not None:
        value = side.paper.get(key)
        return MISSING if value is None else f'{value:g}'
    return spread(side.runs, key + suffix).text()


def long_table(
    title: str,
    results: Sequence[RunResult],
    paper: Callable[[str, str], Mapping[str, float]] | None = None,
) -> Table:
    """One row per group, filter, window and quantity, for machines.

    Parameters
    ----------
    paper : callable, optional
        Paper's numbers for a group and a filter; empty where it has none.
    """
    columns = (
        Column('group', 'group'),
        Column('filter', 'filter'),
        Column('window', 'window'),
        Column('quantity', 'quantity'),
        Column('unit', 'unit'),
        Column('runs', 'runs'),
        Column('stopped', 'stopped'),
        Column('median', 'median'),
        Column('lowest', 'lowest'),
        Column('highest', 'highest'),
        Column('paper', 'paper'),
    )
    rows = []
    for group, name in dict.fromkeys((r.group, r.column) for r in results):
        runs = of(results, group, name)
        printed = paper(group, name) if paper else {}
        for window, suffix in (('whole', ''), ('second half', '_half')):
            for q in (*QUANTITIES, *EXTRA):
                s = spread(runs, q.key + suffix)
                rows.append(
                    {
                        'group': group,
                        'filter': name,
                        'window': window,
                        'quantity': q.key,
                        'unit': q.unit,
                        'runs': s.count + s.stopped,
                        'stopped': s.stopped,
                        'median': s.median,
                        'lowest': s.low,
                        'highest': s.high,
                        'paper': printed.get(q.key) if window == 'whole' else None,
                    }
                )
    return Table(title, columns, tuple(rows))
