"""Error, NEES and time per fix over delay strategy, delay, fix period and process noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from polar_nav_core.errors import ConfigError

from ..scoring.tables import MISSING, Column, Table, show
from .columns import CLAIRVOYANT, STRATEGIES, FilterColumn, pick
from .figures import ratio_figure
from .jobs import Job, RunResult
from .request import Request, Size
from .schedule import FixSpec
from .summary import of, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DELAYS_S = (0.0, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
PERIODS_S = (1.0, 10.0)
QUICK_DELAYS_S = (0.0, 5.0)
QUICK_PERIODS_S = (1.0,)
SENSORS = {
    '6.1': ('paper_6_1', True),
    '6.2': ('paper_6_2', True),
    '6.2 without DVL': ('paper_6_2', False),
    'tactical': ('tactical', True),
}
"""Process noise: IMU of a section of the paper, or a preset; whether there is a DVL."""
_PAPER_SENSORS = ('6.1', '6.2', '6.2 without DVL')
_QUICK_SENSORS = ('6.2',)
COLUMNS = (*STRATEGIES, CLAIRVOYANT)
_NO_FIXES = 'no fixes'


def _grid(request: Request) -> tuple[Sequence[str], Sequence[float], Sequence[float]]:
    sensors: Sequence[str] = _PAPER_SENSORS
    periods: Sequence[float] = PERIODS_S
    delays: Sequence[float] = DELAYS_S
    if request.quick:
        sensors, periods, delays = _QUICK_SENSORS, QUICK_PERIODS_S, QUICK_DELAYS_S
    unknown = [s for s in request.sensors or () if s not in SENSORS]
    if unknown:
        raise ConfigError(f'--sensors: {unknown[0]!r} is none of {", ".join(SENSORS)}')
    return request.sensors or sensors, request.periods_s or periods, request.delays_s or delays


def _group(sensors: str, period_s: float, delay_s: float) -> str:
    return f'{sensors}; fix every {period_s:g} s; delay {delay_s:g} s'


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[Job]:
    """Jobs of every combination, and for the time per fix of each sensor set without fixes."""
    c = request.choices
    sensors, periods, delays = _grid(request)
    jobs = []
    idle = FilterColumn(_NO_FIXES, 'no fix at all: time of all other work', {})
    for name in sensors:
        imu, dvl = SENSORS[name]
        more = {} if dvl else {'dvl_rate_hz': 0.0}
        world = c.world(size.duration_s, imu, **more)
        for seed in range(1, size.seeds + 1):
            none = FixSpec(first_s=size.duration_s + 1.0)
            jobs.append(Job(name, idle, seed, world, none, c.filter_changes(0.0)))
            for period_s in periods:
                for delay_s in delays:
                    fixes = FixSpec(
                        period_s=period_s,
                        first_s=1.0,
                        sigma=c.fix_sigma,
                        sigma_vertical=c.fix_sigma_vertical,
                        delay_s=delay_s,
                    )
                    jobs += [
                        Job(
                            _group(name, period_s, delay_s),
                            column,
                            seed,
                            world,
                            fixes,
                            c.filter_changes(delay_s),
                        )
                        for column in pick(c, columns)
                    ]
    return jobs


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of error, NEES and time per fix, one column per delay."""
    note = (
        f'{size.duration_s:g} s, seeds 1 to {size.seeds}, medians;'
        f' {request.choices.speed_mps:g} m/s, fixes of {request.choices.fix_sigma:g} m, second'
        ' half of each run. The clairvoyant filter gets the same fixes when they are valid.'
    )
    return [
        _table(
            'Horizontal position error, RMS [m]',
            results,
            request,
            note,
            lambda runs: _median(runs, 'r_half'),
        ),
        _table(
            'Normalized squared position error, 1 is honest',
            results,
            request,
            'e²/P per degree of freedom, mean over the second half.',
            lambda runs: _median(runs, 'nees_position_half'),
        ),
        _table(
            'Processor time per fix [ms]',
            results,
            request,
            'Of the run, less the time of the same run without fixes; on a shared machine only'
            ' orders of magnitude mean something, and a negative time is their noise.',
            lambda runs: _time_per_fix(runs, results),
            _grid(request)[1][:1],
        ),
    ]


def _table(
    title: str,
    results: Sequence[RunResult],
    request: Request,
    note: str,
    cell: Callable[[Sequence[RunResult]], str],
    periods: Sequence[float] | None = None,
) -> Table:
    sensors, all_periods, delays = _grid(request)
    periods = all_periods if periods is None else periods
    names = [n for n in dict.fromkeys(r.column for r in results) if n != _NO_FIXES]
    columns = [Column('sensors', 'sensors'), Column('period', 'fix every', 's')]
    columns += [Column('filter', 'filter')]
    columns += [Column(f'd{i}', f'{d:g} s') for i, d in enumerate(delays)]
    rows = []
    for s in sensors:
        for p in periods:
            for n in names:
                row: dict[str, object] = {'sensors': s, 'period': p, 'filter': n}
                for i, d in enumerate(delays):
                    row[f'd{i}'] = cell(of(results, _group(s, p, d), n))
                rows.append(row)
    return Table(title, tuple(columns), tuple(rows), note)


def _median(runs: Sequence[RunResult], key: str) -> str:
    s = spread(runs, key)
    if s.count == 0:
        return s.text()
    text = show(s.median) + (f'; {s.stopped} stopped' if s.stopped else '')
    received = sum(sum(r.verdicts.values()) for r in runs)
    refused = received - sum(r.verdicts.get('FUSED', 0) for r in runs)
    return text + (f'; {refused} of {received} fixes not fused' if refused else '')


def _time_per_fix(runs: Sequence[RunResult], results: Sequence[RunResult]) -> str:
    values = []
    for r in runs:
        idle = of(results, r.group.partition(';')[0], _NO_FIXES)
        base = [i.seconds for i in idle if i.seed == r.seed]
        fixes = sum(r.verdicts.values())
        if base and fixes:
            values.append(1e3 * (r.seconds - base[0]) / fixes)
    return show(float(np.median(values)), 2) if values else MISSING


def figures(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """Figures of the error over delay, one panel per sensors and fix period."""
    del size
    sensors, periods, delays = _grid(request)
    names = [n for n in dict.fromkeys(r.column for r in results) if n != _NO_FIXES]
    panels = []
    for s in sensors:
        curves = []
        for n in names:
            y = [spread(of(results, _group(s, periods[0], d), n), 'r_half').median for d in delays]
            curves.append((n, list(delays), y))
        panels.append((f'sensors {s}, fix every {periods[0]:g} s', curves))
    return {'ablation': ratio_figure(panels, 'delay [s]', 'horizontal error, RMS [m]')}
