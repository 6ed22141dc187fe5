"""The paper's tables 1, 2 and 3, and its figures 8, 9 and 11, with our filters' numbers.

Table 1: the conventional AKF under four ranges of random delay, 1 h. Table 2: Algorithm 1 (knows
the delay) against Algorithm 2 (ignores it), 12 h. Table 3: the same with the noise of a real IMU,
of section 6.2 or of a bag. Each figure shows the errors of the first seed's runs over time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from ..scoring.tables import Column, Table
from .columns import pick
from .figures import Line, errors_figure
from .jobs import Job, RunResult
from .paper import PAPER
from .recorded import load_recorded
from .request import Request, Size
from .schedule import FixSpec
from .summary import Side, comparison, of, spread, stops
from .world_spec import WorldSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RANGES = ('D1', 'D2', 'D3', 'D4')
COMPARED = (
    'conventional_akf_published',
    'modified_akf_published',
    'conventional_akf',
    'modified_akf',
    'clone',
    'rewind',
    'clairvoyant',
)
PAIR = ('modified_akf', 'conventional_akf')
"""Working forms of Algorithm 1 and 2; the published forms are in the tables."""


def _steps(request: Request, group: str) -> int:
    c = request.choices
    return {'D1': c.d1, 'D2': c.d2, 'D3': c.d3, 'D4': c.d4, 'D': c.d}[group]


def _world(request: Request, size: Size, imu: str) -> WorldSpec:
    if request.recorded is None:
        return request.choices.world(size.duration_s, imu)
    rate_hz = load_recorded(request.recorded).rate_hz
    return request.choices.world(size.duration_s, 'recorded', imu_rate_hz=rate_hz)


def _jobs(
    request: Request, size: Size, columns: Sequence[str], groups: Sequence[str], imu: str
) -> list[Job]:
    world = _world(request, size, imu)
    jobs = []
    for seed in range(1, size.seeds + 1):
        for group in groups:
            fixes = request.choices.fixes(_steps(request, group))
            changes = request.choices.filter_changes(fixes.longest_delay_s)
            jobs += [
                Job(group, c, seed, world, fixes, changes, request.recorded, series=seed == 1)
                for c in pick(request.choices, columns)
            ]
    return jobs


def _names(results: Sequence[RunResult]) -> list[str]:
    return list(dict.fromkeys(r.column for r in results))


def _about(size: Size, request: Request, fixes: FixSpec | None = None) -> str:
    c = request.choices
    seeds = 'seed 1' if size.seeds == 1 else f'seeds 1 to {size.seeds}: median (lowest to highest)'
    delay = '' if fixes is None else f', mean delay {fixes.mean_delay_s:.2f} s'
    return (
        f'{size.duration_s:g} s, {seeds}; {c.speed_mps:g} m/s, fixes of {c.fix_sigma:g} m every'
        f' {c.fix_period_s:g} s{delay}; estimates against truth every {c.output_period_s:g} s.'
    )


# -- table 1, figure 8 ----------------------------------------------------------------------------


def plan_table1(request: Request, size: Size, columns: Sequence[str]) -> list[Job]:
    """Jobs of all filters under all four ranges."""
    return _jobs(request, size, columns, RANGES, 'paper_6_1')


def tables_table1(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of the paper beside each filter that ignores the delay, then of all filters."""
    out = []
    printed = [Side(f'paper {g}', paper=PAPER['table1'][g]) for g in RANGES]
    longest = [_steps(request, g) * 0.1 for g in RANGES]
    for name in _names(results):
        lasted = any(r.metrics for r in results if r.column == name)
        if lasted and (name.startswith('conventional_akf') or name == 'ignore'):
            ours = [
                Side(f'{g}, up to {s:g} s', of(results, g, name))
                for g, s in zip(RANGES, longest, strict=True)
            ]
            title = f'Table 1: {name} under delays of different range, RMS of the whole run'
            sides = [side for pair in zip(printed, ours, strict=True) for side in pair]
            out.append(comparison(title, sides, _about(size, request)))
    out.append(_by_range(results, size, request))
    return out


def _by_range(results: Sequence[RunResult], size: Size, request: Request) -> Table:
    columns = [Column('filter', 'filter')]
    rows: list[dict[str, object]] = []
    for g in RANGES:
        fixes = request.choices.fixes(_steps(request, g))
        columns.append(Column(g, f'{g}: mean delay {fixes.mean_delay_s:.2f} s'))
    columns.append(Column('lag', 'D1: behind the truth [m]'))
    for name in _names(results):
        row: dict[str, object] = {'filter': name}
        for g in RANGES:
            runs = of(results, g, name)
            row[g] = spread(runs, 'r_half').text()
            if all(r.stopped for r in runs):
                row[g] = f'stopped, s: {stops(runs)}'
        row['lag'] = spread(of(results, 'D1', name), 'lag_half').text()
        rows.append(row)
    title = 'Horizontal position error, RMS of the second half [m]'
    return Table(title, tuple(columns), tuple(rows), _about(size, request))


def paper_table1(group: str, column: str) -> Mapping[str, float]:
    """Paper's numbers of table 1, for the conventional AKF."""
    return PAPER['table1'][group] if column.startswith('conventional_akf') else {}


def figure8(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """Figure of the errors of the conventional AKF under the four ranges."""
    names = [n for n in _names(results) if n == 'conventional_akf'] or _names(results)[:1]
    lines = [
        Line(f'{g}: up to {_steps(request, g) * 0.1:g} s', r)
        for g in RANGES
        for r in of(results, g, names[0])
        if r.series
    ]
    return {'figure8': errors_figure(lines, size.duration_s, f'{names[0]}, seed 1')}


# -- tables 2 and 3, figures 9 and 11 -------------------------------------------------------------


def plan_table2(request: Request, size: Size, columns: Sequence[str]) -> list[Job]:
    """Jobs of all filters, sensors of section 6.1."""
    return _jobs(request, size, columns, ('D',), 'paper_6_1')


def plan_table3(request: Request, size: Size, columns: Sequence[str]) -> list[Job]:
    """Jobs of all filters, IMU of section 6.2 or of a recording."""
    return _jobs(request, size, columns, ('D',), 'paper_6_2')


Tables = Callable[[Sequence[RunResult], Size, Request], list[Table]]


def tables_of(table: str, about: str) -> Tables:
    """Tables of table 2 or 3: whole run beside the paper, and second half."""

    def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
        sides = [Side(f'paper {name}', paper=row) for name, row in PAPER[table].items()]
        sides += [Side(name, of(results, 'D', name)) for name in _names(results)]
        note = _about(size, request, request.choices.fixes(request.choices.d))
        if request.recorded is not None:
            length = load_recorded(request.recorded).duration_s
            note += f' IMU errors recorded at rest, {length:.0f} s'
            note += ', used again and again.' if length < size.duration_s else '.'
        return [
            comparison(f'{about}, RMS of the whole run', sides, note),
            comparison(f'{about}, RMS of the second half', sides[2:], note, half=True),
        ]

    return tables


def paper_of(table: str) -> Callable[[str, str], Mapping[str, float]]:
    """Paper's numbers of table 2 or 3 for a filter."""

    def paper(group: str, column: str) -> Mapping[str, float]:
        del group
        for start, name in (('modified_akf', 'Algorithm 1'), ('conventional_akf', 'Algorithm 2')):
            if column.startswith(start):
                return PAPER[table][name]
        return {}

    return paper


def pair_figure(name: str) -> Callable[[Sequence[RunResult], Size, Request], dict[str, Figure]]:
    """Figure of the errors of Algorithm 1 and 2 over time."""

    def figure(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
        del request
        wanted = [n for n in PAIR if n in _names(results)] or _names(results)
        lines = [Line(n, r) for n in wanted for r in of(results, 'D', n) if r.series]
        return {name: errors_figure(lines, size.duration_s, 'seed 1')}

    return figure
