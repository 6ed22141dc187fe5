"""Report of a campaign: distributions, NEES and its bands, the worst runs, what failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polar_nav_core.arrays import Array

from ..experiments.figures import Band, band_figure
from ..experiments.jobs import RunResult
from ..experiments.mismatch.judge import KINDS
from ..report.style import color, drawing
from ..scoring.consistency import chi_square_band
from ..scoring.tables import Column, Table
from ..tasks.rows import Row

_PROBABILITIES = (0.99, 0.9999)
_QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
_DISTRIBUTED = (
    ('rms', 'horizontal error, RMS of the second half', 'm'),
    ('end', 'horizontal error at the end', 'm'),
    ('said', 'published horizontal sigma', 'm'),
    *((f'nees_{k}', f'NEES of {k}', '') for k in KINDS),
    *((f'beyond_{k}', f'share of {k} beyond 4 sigma', '') for k in KINDS),
)
_WORST = 10
_MOST_LINES = 8
"""Combinations in the figure."""


@dataclass(frozen=True)
class Run:
    """One run: its row, and its result if it did not fail."""

    row: Row
    group: str
    seed: int
    result: RunResult | None


def tables(runs: Sequence[Run], again: str) -> list[Table]:
    """Tables of a campaign.

    Parameters
    ----------
    runs : sequence of Run
    again : str
        Command that makes them; with ``--only KEY`` it makes one.
    """
    groups = list(dict.fromkeys(r.group for r in runs))
    found = [_overview(runs, groups), _distributions(runs, groups), _bands(runs, groups)]
    worst = sorted(_lasted(runs), key=lambda r: -_rms(r))[:_WORST]
    found.append(
        _named(
            'Worst runs',
            [(r, f'{_rms(r):.4g} m', r.row.processor_s) for r in worst],
            again,
            'horizontal error, RMS',
        )
    )
    bad = [r for r in runs if r.result is None]
    if bad:
        found.append(_reasons(bad))
        lines = [(r, f'{r.row.reason} ({r.row.where})', None) for r in bad[:_WORST]]
        found.append(_named('Runs that failed', lines, again, 'reason'))
    return found


def _rms(run: Run) -> float:
    return run.result.metrics['rms'] if run.result is not None else float('nan')


def _lasted(runs: Iterable[Run]) -> list[Run]:
    """Runs that have errors to count: neither failed nor stopped."""
    return [r for r in runs if r.result is not None and 'rms' in r.result.metrics]


def _values(runs: Iterable[Run], key: str) -> Array:
    found = [r.result.metrics for r in _lasted(runs) if r.result is not None]
    return np.array([m[key] for m in found if key in m and np.isfinite(m[key])])


def _overview(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = (
        Column('group', 'runs of'),
        Column('runs', 'runs'),
        Column('failed', 'failed'),
        Column('stopped', 'filter stopped'),
        Column('rms', 'RMS, median', 'm'),
        Column('rms_95', '95 % of runs', 'm'),
        Column('said', 'said, median', 'm'),
        Column('wrong', 'wrong', doc='beyond 4 published sigmas for more than 5 % of the time'),
        Column('warned', 'with a WARN or ERROR'),
        Column('processor_s', 'processor time of a filter', 's'),
    )
    rows = []
    for group in groups:
        of = [r for r in runs if r.group == group]
        results = [r.result for r in of if r.result is not None]
        row: dict[str, object] = {
            'group': group,
            'runs': len(of),
            'failed': len(of) - len(results),
            'stopped': sum(r.stopped for r in results),
            'wrong': int(_values(of, 'wrong').sum()),
            'warned': int(np.sum(_values(of, 'warnings') + _values(of, 'errors') > 0.0)),
        }
        if len(rms := _values(of, 'rms')):
            row |= {'rms': float(np.median(rms)), 'rms_95': float(np.quantile(rms, 0.95))}
            row['said'] = float(np.median(_values(of, 'said')))
            row['processor_s'] = float(np.median([r.seconds for r in results]))
        rows.append(row)
    return Table('Runs', columns, tuple(rows), 'Errors are those of the second half of a run.')


def _distributions(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = [Column('group', 'runs of'), Column('what', 'what'), Column('unit', 'unit')]
    columns += [Column(f'q{100 * q:g}', f'{100 * q:g} %') for q in _QUANTILES]
    rows = []
    for group in groups:
        of = [r for r in runs if r.group == group]
        for key, title, unit in _DISTRIBUTED:
            if len(values := _values(of, key)):
                found = np.quantile(values, _QUANTILES)
                row: dict[str, object] = {'group': group, 'what': title, 'unit': unit}
                row |= {f'q{100 * q:g}': float(v) for q, v in zip(_QUANTILES, found, strict=True)}
                rows.append(row)
    return Table('Quantiles over runs', tuple(columns), tuple(rows))


def minutes(runs: Sequence[Run], kind: str) -> tuple[Array, Array, float]:
    """Mean NEES per degree of freedom over runs at the end of each minute.

    Returns
    -------
    time_s, mean : (m,) arrays
        Of the minutes that all runs have.
    dof : float
        Degrees of freedom of all runs together; 0 without any run.
    """
    found = [r.result for r in _lasted(runs) if r.result is not None and not r.result.stopped]
    found = [r for r in found if len(r.series.get('time_s', ()))]
    if not found:
        return np.empty(0), np.empty(0), 0.0
    length = min(len(r.series['time_s']) for r in found)
    mean = np.mean([r.series[f'nees_{kind}'][:length] for r in found], axis=0)
    dof = sum(r.metrics[f'dof_{kind}'] for r in found)
    return found[0].series['time_s'][:length], np.asarray(mean), dof


def _bands(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = (
        Column('group', 'runs of'),
        Column('kind', 'NEES of'),
        Column('minutes', 'minutes'),
        Column('mean', 'mean, 1 is honest'),
        Column('inside', 'inside the 99 % band', '%'),
        Column('outside', 'outside the 99.99 % band'),
    )
    rows = []
    for group in groups:
        of = [r for r in runs if r.group == group]
        for kind in KINDS:
            _, mean, dof = minutes(of, kind)
            mean = mean[len(mean) // 2 :]
            if len(mean) and np.isfinite(mean).all():
                bands = [chi_square_band(dof, p) for p in _PROBABILITIES]
                inside = [(mean * dof >= low) & (mean * dof <= high) for low, high in bands]
                rows.append(
                    {
                        'group': group,
                        'kind': kind,
                        'minutes': len(mean),
                        'mean': float(mean.mean()),
                        'inside': 100.0 * float(np.mean(inside[0])),
                        'outside': int(np.count_nonzero(~inside[1])),
                    }
                )
    note = (
        'Means over the runs at the end of each minute of the second half; runs are independent.'
    )
    return Table('Normalized squared error', columns, tuple(rows), note)


def _named(
    title: str, lines: Sequence[tuple[Run, str, float | None]], again: str, what: str
) -> Table:
    columns = (
        Column('key', 'key'),
        Column('group', 'run of'),
        Column('seed', 'seed'),
        Column('what', what),
        Column('command', 'command'),
    )
    rows = tuple(
        {
            'key': run.row.key,
            'group': run.group,
            'seed': run.seed,
            'what': text,
            'command': f'{again} --only {run.row.key[:12]}',
        }
        for run, text, _ in lines
    )
    return Table(title, columns, rows)


def _reasons(bad: Sequence[Run]) -> Table:
    counts = Counter((r.row.reason, r.row.where) for r in bad)
    columns = (Column('runs', 'runs'), Column('reason', 'reason'), Column('where', 'where'))
    rows = [{'runs': n, 'reason': why, 'where': at} for (why, at), n in counts.most_common()]
    return Table('Reasons of failures', columns, tuple(rows))


def figures(runs: Sequence[Run], out: Path) -> list[Path]:
    """Write the figure of NEES over time with its bands; none without a minute of runs."""
    groups = list(dict.fromkeys(r.group for r in runs))[:_MOST_LINES]
    panels = []
    for kind in KINDS:
        lines, bands = [], []
        for group in groups:
            time_s, mean, dof = minutes([r for r in runs if r.group == group], kind)
            if len(mean) and np.isfinite(mean).all():
                lines.append((group, time_s / 60.0, mean))
                found = [(p, *chi_square_band(dof, p)) for p in _PROBABILITIES]
                bands = [
                    Band(f'{100 * p:g} %', float(a) / dof, float(b) / dof) for p, a, b in found
                ]
        if lines:
            panels.append((kind, lines, bands))
    if not panels:
        return []
    paths = []
    figure = band_figure(panels, 'time [min]', 'mean e²/P, 1 is honest')
    for suffix in ('png', 'svg'):
        path = out / f'campaign.{suffix}'
        with drawing('campaign'):
            metadata = {'Date': None} if suffix == 'svg' else None
            figure.savefig(path, dpi=80, facecolor=color('card'), metadata=metadata)
        paths.append(path)
    return paths


def _band(dof: float, probability: float) -> Band:
    """Band of a mean per degree of freedom."""
    low, high = chi_square_band(dof, probability)
    return Band(f'{100 * probability:g} %', float(low) / dof, float(high) / dof)
