"""Consistency of the filter: NEES over many runs with states drawn from its prior.

Initial errors, constant biases, DVL scale and the slow DVL error are drawn from the filter's own
prior; delays are uniform up to 10 s and 30 % of the fixes are lost. In each minute the mean over
the runs, which are independent, has the band of chi-square with (runs x states) degrees of
freedom, however slowly errors change within one run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from polar_nav_core.arrays import Array

from ..scoring.consistency import chi_square_band
from ..scoring.tables import Column, Table
from .columns import pick
from .figures import Band, band_figure
from .jobs import Job, RunResult
from .request import Request, Size
from .schedule import FixSpec
from .summary import of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ('default', 'rewind')
GROUP = 'prior'
CONVERGED_S = 600.0
"""First counted minute; before it, start errors exceed the linear model."""
_KINDS = (('nees', 'all states'), ('nees_position', 'position'))
_PROBABILITIES = (0.99, 0.9999)


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[Job]:
    """Jobs with fixes of 1 m every 2 s, 0 to 10 s late, three in ten lost."""
    c = request.choices
    world = c.world(size.duration_s, constants='prior')
    fixes = FixSpec(
        period_s=2.0,
        first_s=2.0,
        sigma=c.fix_sigma,
        sigma_vertical=c.fix_sigma_vertical,
        delay_kind='uniform',
        delay_s=10.0,
        loss=0.3,
    )
    changes = c.filter_changes(fixes.longest_delay_s)
    return [
        Job(GROUP, column, seed, world, fixes, changes, series=True)
        for seed in range(1, size.seeds + 1)
        for column in pick(c, columns)
    ]


def minutes(runs: Sequence[RunResult], kind: str) -> tuple[Array, Array, float]:
    """Mean NEES per degree of freedom over the runs, at the end of each minute.

    Returns
    -------
    time_s, mean : (m,) arrays
    dof : float
        Degrees of freedom of all runs together.
    """
    lasted = [r for r in runs if not r.stopped]
    if not lasted:
        return np.empty(0), np.empty(0), 0.0
    dof = lasted[0].metrics['nees_dof'] if kind == 'nees' else 3.0
    time_s = lasted[0].series['time_s']
    ends = np.searchsorted(time_s, np.arange(60.0, time_s[-1] + 1e-6, 60.0))
    ends = np.unique(np.minimum(ends, len(time_s) - 1))
    mean = np.mean([r.series[kind][ends] for r in lasted], axis=0) / dof
    return time_s[ends], mean, dof * len(lasted)


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of mean NEES and the share of the minutes inside the bands."""
    del request
    columns = (
        Column('filter', 'filter'),
        Column('kind', 'NEES of'),
        Column('runs', 'runs'),
        Column('stopped', 'stopped'),
        Column('minutes', 'minutes'),
        Column('mean', 'mean, 1 is honest'),
        Column('inside', 'inside the 99 % band', '%'),
        Column('outside', 'outside the 99.99 % band'),
    )
    rows = []
    for name in dict.fromkeys(r.column for r in results):
        runs = of(results, GROUP, name)
        for kind, title in _KINDS:
            time_s, mean, dof = minutes(runs, kind)
            mean = mean[time_s > CONVERGED_S] if size.duration_s > CONVERGED_S else mean
            row: dict[str, object] = {'filter': name, 'kind': title, 'runs': len(runs)}
            row |= {'stopped': sum(r.stopped for r in runs), 'minutes': len(mean)}
            if len(mean):
                inside = [_inside(mean, dof, p) for p in _PROBABILITIES]
                row['mean'] = float(mean.mean())
                row['inside'] = 100.0 * float(np.mean(inside[0]))
                row['outside'] = int(np.count_nonzero(~inside[1]))
            rows.append(row)
    note = (
        f'{size.seeds} runs of {size.duration_s:g} s, fix every 2 s, delay 0 to 10 s, 30 % lost;'
        f' minutes after the first {CONVERGED_S:g} s.'
    )
    return [Table('Normalized squared error over runs', columns, tuple(rows), note)]


def _inside(mean: Array, dof: float, probability: float) -> np.ndarray:
    low, high = chi_square_band(dof, probability)
    return (mean * dof >= low) & (mean * dof <= high)


def figures(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """Figures of the mean NEES over time with its bands."""
    del size, request
    names = list(dict.fromkeys(r.column for r in results))
    panels = []
    for kind, title in _KINDS:
        found = [(n, *minutes(of(results, GROUP, n), kind)) for n in names]
        found = [f for f in found if len(f[1])]
        bands = []
        if found:
            dof = found[0][3]
            for p in _PROBABILITIES:
                low, high = chi_square_band(dof, p)
                bands.append(Band(f'{100.0 * p:g} %', float(low) / dof, float(high) / dof))
        panels.append((title, [(n, t / 60.0, m) for n, t, m, _ in found], bands))
    return {'consistency': band_figure(panels, 'time [min]', 'mean e²/P, 1 is honest')}
