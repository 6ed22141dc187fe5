"""Tables of the experiment `faults`: one line per fault and filter, and counts of verdicts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from ...scoring.tables import Column, Table
from .judge import BROKEN, SEVERITY

_MOST_WORDS = 110


class Result(Protocol):
    """Judged run."""

    @property
    def group(self) -> str:
        """Row."""

    @property
    def column(self) -> str:
        """Filter."""

    @property
    def seed(self) -> int:
        """Seed."""

    @property
    def metrics(self) -> dict[str, float]:
        """Numbers of `Judged`."""

    @property
    def verdict(self) -> str:
        """One of `SEVERITY`."""

    @property
    def sentence(self) -> str:
        """First report."""

    @property
    def offline(self) -> str:
        """Verdict of the replayed recording; empty where it was not replayed."""

    @property
    def offline_sentence(self) -> str:
        """First report of the replay."""

    @property
    def equal(self) -> bool:
        """Whether the replay is equal bit for bit."""


_NUMBERS = (
    'recovered_s', 'reported_s', 'worst_m', 'end_m', 'unsaid_s', 'unsaid_since_s', 'shown_s',
    'shown_sigmas', 'sigma_ratio',
)  # fmt: skip


def tables(results: Sequence[Result]) -> list[Table]:
    """Table of all rows and filters, numbers of rows by verdict, and replays that differ."""
    groups: dict[tuple[str, str], list[Result]] = {}
    for r in results:
        groups.setdefault((r.group, r.column), []).append(r)
    lines = [_line(runs) for runs in groups.values()]
    columns = (
        Column('row', 'fault'),
        Column('filter', 'filter'),
        Column('verdict', 'verdict'),
        Column('offline', 'replayed'),
        Column('recovered_s', 'recovered after', 's'),
        Column('reported_s', 'reported after', 's'),
        Column('worst_m', 'worst', 'm'),
        Column('end_m', 'at the end', 'm'),
        Column('unsaid_s', 'beyond 5 sigma without ERROR', 's'),
        Column('unsaid_since_s', 'since fixes show it', 's'),
        Column('shown_s', 'fixes show it after', 's'),
        Column('shown_sigmas', 'evidence of fixes', 'sigma'),
        Column('sigma_ratio', 'sigma ratio'),
        Column('sentence', 'first report'),
    )
    note = (
        'Worst seed of each fault and filter. Recovered: from then after the end of the fault on, '
        'error within 3 times that without the fault plus 1 m and stated sigma within 3 times; '
        f'allowed are a minute and ten fixes. Breaking the rule: {", ".join(BROKEN)}. '
        'Fixes show it when the best of all tests of them has 5 sigma. '
        'Replayed: the recording of the first seed.'
    )
    return [
        Table('Injected faults', columns, tuple(lines), note),
        _counts(lines),
        _replays(results),
    ]


def _line(runs: Sequence[Result]) -> dict[str, object]:
    worst = max(runs, key=lambda r: (SEVERITY.index(r.verdict), _finite(r.metrics['worst_m'])))
    out: dict[str, object] = {
        'row': worst.group,
        'filter': worst.column,
        'verdict': worst.verdict,
        'offline': next((r.offline for r in runs if r.offline), ''),
        'sentence': worst.sentence[:_MOST_WORDS],
    }
    return out | {k: v for k in _NUMBERS if not math.isnan(v := worst.metrics[k])}


def _finite(value: float) -> float:
    return -math.inf if math.isnan(value) else value


def _counts(lines: Sequence[dict[str, object]]) -> Table:
    filters = list(dict.fromkeys(str(x['filter']) for x in lines))
    counts = {n: Counter(str(x['verdict']) for x in lines if x['filter'] == n) for n in filters}
    columns = (Column('verdict', 'verdict'), *(Column(n, n) for n in filters))
    rows: list[dict[str, object]] = [
        {'verdict': v, **{n: counts[n][v] for n in filters}} for v in SEVERITY
    ]
    return Table('Faults by verdict', columns, tuple(rows))


def _replays(results: Sequence[Result]) -> Table:
    """Table of the replays that are not the live run, or are judged differently."""
    replayed = [r for r in results if r.offline]
    rows = [
        {
            'row': r.group,
            'filter': r.column,
            'verdict': r.verdict,
            'offline': r.offline,
            'equal': 'yes' if r.equal else 'NO',
            'sentence': r.sentence[:_MOST_WORDS],
            'offline_sentence': r.offline_sentence[:_MOST_WORDS],
        }
        for r in replayed
        if r.offline != r.verdict or not r.equal
    ]
    columns = (
        Column('row', 'fault'),
        Column('filter', 'filter'),
        Column('verdict', 'live'),
        Column('offline', 'replayed'),
        Column('equal', 'equal bit for bit'),
        Column('sentence', 'first report, live'),
        Column('offline_sentence', 'first report, replayed'),
    )
    equal = sum(r.equal for r in replayed)
    note = f'{len(replayed)} recordings were replayed, {equal} of them equal bit for bit.'
    return Table('Replays that are judged differently, or differ', columns, tuple(rows), note)


def long_table(title: str, results: Sequence[Result]) -> Table:
    """Table of every number of every run, one line each."""
    names = (
        'row', 'filter', 'seed', 'verdict', *_NUMBERS, 'sentence', 'offline',
        *(f'offline_{name}' for name in _NUMBERS), 'offline_sentence', 'equal',
    )  # fmt: skip
    rows = [
        {'row': r.group, 'filter': r.column, 'seed': r.seed, 'verdict': r.verdict,
         'sentence': r.sentence, 'offline': r.offline, 'offline_sentence': r.offline_sentence,
         'equal': r.equal if r.offline else '', **r.metrics}
        for r in results
    ]  # fmt: skip
    return Table(title, tuple(Column(n, n) for n in names), tuple(rows))
