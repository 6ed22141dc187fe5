"""The table of the experiment `mismatch`, and the counts around it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from ...scoring.tables import Column, Table
from ..jobs import RunResult
from ..request import Request, Size
from .judge import REPORT_WITHIN_S, SEVERITY, UNREPORTED, verdict_of
from .row import Row
from .rows import rows_named
from .runs import BEST, VISIBLE, MismatchResult

_COLUMNS = (
    Column('row', 'row'),
    Column('size', 'size'),
    Column('filter', 'filter'),
    Column('rms_m', 'RMS', 'm', doc='horizontal, second half, pooled over seeds'),
    Column('worst_m', 'worst', 'm', doc='RMS of the worst seed'),
    Column('end_m', 'end', 'm', doc='largest horizontal error at the end'),
    Column('said_m', 'said', 'm', doc='published horizontal sigma, pooled'),
    Column('nees', 'NEES p/h/v', doc='per degree of freedom: position, heading, velocity'),
    Column('beyond', 'beyond 4σ p/h/v', '%', doc='share of the second half'),
    Column('wrong', 'wrong', doc='seeds that are wrong'),
    Column('silent', 'beyond 4σ while OK', '%', doc='share of the second half, worst seed'),
    Column('wrong_s', 'wrong from', 's', doc='first seed, since the start of the run'),
    Column('refused', 'refused fix/DVL/depth', '%'),
    Column('visible_s', 'visible at', 's', doc='since the start of the run, median'),
    Column('sigmas', 'seen by', 'σ', doc='at the end, by a filter that knows the shape'),
    Column('reported', 'reported', doc='seeds that blamed a right culprit or nothing'),
    Column('after_s', 'after', 's', doc='median of the right reports, since visible'),
    Column('by', 'by', doc='first word of the first seed that spoke'),
    Column('verdict', 'verdict', doc='of the worst seed'),
    Column('x_best', 'x best', doc='RMS over that of the filter which knows the fault'),
)
_MOST_X_BEST = 3.0


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Fault-free counts, the table of rows and filters, and the counts of verdicts."""
    rows = rows_named(request.rows)
    by_key = _grouped(results)
    body = [line for row in rows for line in _lines(row, by_key)]
    first = request.first_seed
    seeds = f'seeds {first} to {first + size.seeds - 1}'
    return [
        _fault_free(rows, by_key),
        Table(f'Mismatch, {seeds}', _COLUMNS, tuple(body), _note(body)),
        _counts(body),
    ]


_Grouped = dict[tuple[str, str], list[MismatchResult]]


def _grouped(results: Sequence[RunResult]) -> _Grouped:
    out: _Grouped = {}
    for r in results:
        if isinstance(r, MismatchResult):
            out.setdefault((r.group, r.column), []).append(r)
    return out


def _filters(row: Row, by_key: _Grouped) -> Iterator[tuple[str, list[MismatchResult]]]:
    for (name, column), runs in by_key.items():
        if name == row.name and column != VISIBLE:
            yield column, runs


def _lines(row: Row, by_key: _Grouped) -> Iterator[dict[str, object]]:
    seen = by_key.get((row.name, VISIBLE), [])
    sigmas = _median([r.metrics['visible_sigmas'] for r in seen])
    best = by_key.get((row.name, BEST))
    least = _pooled(best, 'rms') if best else math.nan
    for column, runs in _filters(row, by_key):
        line = _line(row, column, runs, [_visible_s(row, r.seed, seen) for r in runs])
        rms = line.get('rms_m')
        if isinstance(rms, float) and least > 0.0 and column != BEST:
            line['x_best'] = rms / least
        if column != BEST and not math.isnan(sigmas):
            line['sigmas'] = sigmas
        yield line


def _visible_s(row: Row, seed: int, seen: Sequence[MismatchResult]) -> float:
    """When a row is visible at a seed [s]: at its own, where the seed draws the fault's shape."""
    if row.invisible:
        return math.nan
    at = {r.seed: r.metrics['visible_s'] for r in seen}
    return at.get(seed, seen[0].metrics['visible_s']) if at else 0.0


def _median(values: Sequence[float]) -> float:
    """Median of those that are numbers; NaN without any."""
    numbers = [x for x in values if not math.isnan(x)]
    return float(np.median(numbers)) if numbers else math.nan


def _line(
    row: Row, column: str, runs: Sequence[MismatchResult], visible_s: Sequence[float]
) -> dict[str, object]:
    """Cells of a filter in a row; ``visible_s`` of each run."""
    after = [
        r.metrics['named_s'] - at
        for r, at in zip(runs, visible_s, strict=True)
        if r.said_right is not None
    ]
    wrong_s = [x for x in (r.metrics['wrong_s'] for r in runs) if not math.isnan(x)]
    words = [r.said_first for r in runs if r.said_first is not None]
    out: dict[str, object] = {
        'row': row.name,
        'size': row.size,
        'filter': column,
        'rms_m': _pooled(runs, 'rms'),
        'worst_m': max((r.metrics.get('rms', math.inf) for r in runs), default=math.nan),
        'end_m': max((r.metrics.get('end', math.inf) for r in runs), default=math.nan),
        'said_m': _pooled(runs, 'said'),
        'nees': _triple(runs, ('nees_position', 'nees_heading', 'nees_velocity'), 1.0),
        'beyond': _triple(runs, ('beyond_position', 'beyond_heading', 'beyond_velocity'), 100.0),
        'wrong': f'{sum(r.metrics["wrong"] > 0 for r in runs)}/{len(runs)}',
        'refused': _triple(runs, ('refused_fix', 'refused_dvl', 'refused_depth'), 100.0),
    }
    if column == BEST:  # it has no watchdog
        return out
    out['silent'] = 100.0 * max(r.metrics.get('silent', 0.0) for r in runs)
    verdicts = [
        verdict_of_run(r, at, row.beyond_stated) for r, at in zip(runs, visible_s, strict=True)
    ]
    out['verdict'] = max(verdicts, key=SEVERITY.index)
    if not row.is_control and not math.isnan(_median(visible_s)):
        out['visible_s'] = _median(visible_s)
    if wrong_s:
        out['wrong_s'] = min(wrong_s)
    out['reported'] = f'{len(after)}/{len(runs)}'
    if not math.isnan(_median(after)):
        out['after_s'] = _median(after)
    if words:
        out['by'] = f'{("OK", "WARN", "ERROR")[words[0].level]}: {words[0].culprit}'
    return out


def verdict_of_run(run: MismatchResult, visible_s: float, beyond_stated: bool = False) -> str:
    """Verdict on one run; ``visible_s`` is NaN for an invisible fault."""
    m = run.metrics
    return verdict_of(
        wrong=m['wrong'] > 0,
        visible=not math.isnan(visible_s),
        covered=m['covered'] > 0,
        in_time=m['named_s'] <= visible_s + REPORT_WITHIN_S,
        named=run.said_right is not None,
        spoke=run.said_first is not None,
        beyond_stated=beyond_stated,
    )


def _pooled(runs: Sequence[RunResult], key: str) -> float:
    """RMS over seeds; NaN when a run has none."""
    values = np.array([r.metrics.get(key, math.nan) for r in runs])
    return float(np.sqrt(np.mean(values**2)))


def _triple(runs: Sequence[RunResult], keys: Sequence[str], unit: float) -> str:
    """Means over seeds as one cell."""
    found = []
    for key in keys:
        values = [r.metrics[key] for r in runs if key in r.metrics]
        found.append(f'{unit * float(np.mean(values)):.2g}' if values else '–')
    return ' / '.join(found)


def _note(body: Sequence[dict[str, object]]) -> str:
    ratio = [x for x in body if isinstance(x.get('x_best'), float)]
    far = [x for x in ratio if float(str(x['x_best'])) > _MOST_X_BEST and 'visible_s' in x]
    return (
        'Wrong: beyond 4 published sigmas for more than 5 % of the second half. Visible: 5 sigma '
        f'for a filter that knows the shape. Reported in time: within {REPORT_WITHIN_S:g} s of '
        f'visible. Visible rows beyond {_MOST_X_BEST:g} x the best filter: {len(far)}.'
    )


def _fault_free(rows: Sequence[Row], by_key: _Grouped) -> Table:
    """Table of WARN and ERROR in runs without any fault, by filter."""
    found: dict[str, Counter[str]] = {}
    length: Counter[str] = Counter()
    for row in rows:
        if row.is_control:
            for column, runs in _filters(row, by_key):
                length[column] += round(row.scene.duration_s * len(runs))
                counts = found.setdefault(column, Counter())
                for r in runs:
                    counts['warnings'] += round(r.metrics['warnings'])
                    counts['errors'] += round(r.metrics['errors'])
                    counts['wrong'] += r.metrics['wrong'] > 0
    columns = (
        Column('filter', 'filter'),
        Column('hours', 'hours', 'h'),
        Column('warnings', 'WARN or worse'),
        Column('errors', 'ERROR'),
        Column('wrong', 'wrong runs'),
    )
    body = [
        {'filter': name, 'hours': length[name] / 3600.0}
        | {key: counts[key] for key in ('warnings', 'errors', 'wrong')}
        for name, counts in found.items()
    ]
    return Table('Without any fault: times the level rose', columns, tuple(body))


def _counts(body: Sequence[dict[str, object]]) -> Table:
    """Table of the number of rows with each verdict, by filter."""
    filters = list(dict.fromkeys(str(x['filter']) for x in body if 'verdict' in x))
    counts = {
        name: Counter(str(x['verdict']) for x in body if 'verdict' in x and x['filter'] == name)
        for name in filters
    }
    columns = (Column('verdict', 'verdict'), *(Column(n, n) for n in filters))
    lines: list[dict[str, object]] = [
        {'verdict': v, **{n: counts[n][v] for n in filters}} for v in SEVERITY
    ]
    lines.append(
        {
            'verdict': 'wrong and unreported',
            **{n: sum(counts[n][v] for v in UNREPORTED) for n in filters},
        }
    )
    return Table('Rows by verdict', columns, tuple(lines))
