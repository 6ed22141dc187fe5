"""Jobs, tables and figures of the experiments `has-*`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from polar_nav_sim.offline_station import StationScenario

from ...scoring.tables import Table
from ..jobs import RunResult
from ..summary import of
from . import figures
from .columns import pick
from .errors import AFTER, BEFORE
from .paper import (
    CLAIMED,
    CLAIMED_UNCOMPENSATED,
    IDENTIFIED,
    QUANTITIES,
)
from .runs import StationJob
from .summary import HOW, Side, by_group, comparison, pooled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..request import Request, Size

FULL, HALF = 'full noise', 'half noise'
COMPARED = (
    'published',
    'published_uncompensated',
    'published_robust',
    'augmented_1e-6',
    'augmented_restarted',
    'default',
)
SHOWN = ('published', 'published_uncompensated', 'default')
"""Of the figures."""
_AFTER = tuple(
    replace(q, title=q.title.replace(', RMS', ''))
    for q in QUANTITIES
    if q.key in {'rms_x_after', 'rms_y_after', 'rms_vx_after', 'rms_vy_after', 'nees_after'}
)
_BRIEF = (
    *(
        replace(q, title=q.title.replace(', largest error', ' at most'))
        for q in QUANTITIES
        if q.key in {'max_x_before', 'max_y_before'}
    ),
    *_AFTER,
)

_LATE = (
    *(
        replace(q, title=q.title.replace(', largest error', ' at most'))
        for q in QUANTITIES
        if q.key in {'max_x_after', 'max_y_after'}
    ),
    *_AFTER,
)
"""The paper's number for an uncompensated delay is a largest error."""

Groups = Mapping[str, StationScenario]


def _jobs(
    request: Request,
    size: Size,
    columns: Sequence[str],
    groups: Groups,
    later_s: Mapping[str, float] | None = None,
) -> list[StationJob]:
    """Jobs of all filters in all groups; those of one seed and group follow one another."""
    return [
        StationJob(
            group,
            column,
            seed,
            scenario,
            request.station,
            later_s=(later_s or {}).get(group, 0.0),
            series=seed == 1,
        )
        for seed in range(1, size.seeds + 1)
        for group, scenario in groups.items()
        for column in pick(columns)
    ]


def _names(results: Sequence[RunResult]) -> list[str]:
    return list(dict.fromkeys(r.column for r in results))


def _groups(results: Sequence[RunResult]) -> list[str]:
    return list(dict.fromkeys(r.group for r in results))


def _note(size: Size, request: Request, text: str = '') -> str:
    seeds = 'seed 1' if size.seeds == 1 else f'seeds 1 to {size.seeds}'
    noise = (
        '' if request.station.noise == 1.0 else f' error amplitudes x {request.station.noise:g};'
    )
    return (
        f'{size.duration_s:g} s, {seeds};{noise} before: {BEFORE[0]:g} to {BEFORE[1]:g} s, after:'
        f' {AFTER[0]:g} to {AFTER[1]:g} s. {HOW}' + (f' {text}' if text else '')
    )


# -- has-table, has-figures -----------------------------------------------------------------------


def plan_table(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs of all filters at full and at half noise."""
    full = request.station.scenario(size.duration_s)
    groups = {FULL: full, HALF: replace(full, noise=0.5 * full.noise)}
    return _jobs(request, size, columns, groups)


def tables_table(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of the paper's claims beside all filters, and of identified parameters."""
    out = []
    for group in _groups(results):
        sides = [*_CLAIMS]
        sides += [Side(name, of(results, group, name)) for name in _names(results)]
        out.append(comparison(f'Claims of the paper, {group}', sides, _note(size, request)))
    for group in _groups(results):
        sides = [Side('paper', paper=CLAIMED), Side('truth', paper=_TRUTH)]
        sides += [Side(n, of(results, group, n)) for n in _names(results)]
        note = (
            'At 750 s; of filters that identify nothing, their estimate then. '
            f'{size.duration_s:g} s, {size.seeds} seeds: mean ± standard deviation over the seeds.'
        )
        out.append(comparison(f'Drag and current, {group}', sides, note, IDENTIFIED))
    return out


_CLAIMS = (
    Side('paper', paper=CLAIMED),
    Side('paper, not compensated', paper=CLAIMED_UNCOMPENSATED),
)
_TRUTH = {'drag_linear': 25.0, 'drag_quadratic': 19.0, 'current_x': 0.4, 'current_y': 0.25}


def paper_of(group: str, column: str) -> Mapping[str, float]:
    """The paper's claims for a group and a filter: for published ones at full noise."""
    if group != FULL:
        return {}
    return {'published': CLAIMED, 'published_uncompensated': CLAIMED_UNCOMPENSATED}.get(column, {})


def figures_table(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """Figures of the errors of all filters over time, seed 1."""
    del size, request
    wanted = [n for n in ('published', 'published_robust', 'default') if n in _names(results)]
    runs = [(n, r) for n in wanted for r in of(results, FULL, n) if r.series]
    if not runs:
        return {}
    return {'has_table': figures.error_lines(runs, 'has_table', limit_m=35.0, limit_mps=0.8)}


def plan_figures(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs of the published filter with and without compensation, and of the default."""
    return _jobs(request, size, columns, {FULL: request.station.scenario(size.duration_s)})


def tables_figures(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of the numbers in the figures."""
    sides = [*_CLAIMS]
    sides += [Side(name, of(results, FULL, name)) for name in _names(results)]
    return [
        comparison(
            'Numbers of the figures', sides, _note(size, request), (*QUANTITIES, *IDENTIFIED)
        )
    ]


def figures_figures(
    results: Sequence[RunResult], size: Size, request: Request
) -> dict[str, Figure]:
    """Figures 4 to 10."""
    del size, request
    runs = {r.column: r for r in results if r.seed == 1 and r.series}
    pair = [runs[n] for n in ('published', 'default') if n in runs]
    without = [runs[n] for n in ('published_uncompensated', 'published') if n in runs]
    out: dict[str, Figure] = {}
    if pair:
        out['has_figure4'] = figures.coordinates(pair, 'has_figure4')
        out['has_figure5'] = figures.position_errors(pair, 'has_figure5')
        with_tracks = [r for r in pair if 'model_after_x' in r.series]
        if with_tracks:
            out['has_figure6'] = figures.tracks(with_tracks, 'has_figure6')
        out['has_figure7'] = figures.velocities(pair, 'has_figure7')
        out['has_figure8'] = figures.velocity_errors(pair, 'has_figure8')
    if 'published_uncompensated' in runs:
        out['has_figure9'] = figures.position_errors(without, 'has_figure9')
        out['has_figure10'] = figures.velocity_errors(without, 'has_figure10')
    return out


# -- varied conditions ----------------------------------------------------------------------------


def plan_loss(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs with losses of 0, 10, 30 and 50 % of the packets."""
    scenario = request.station.scenario(size.duration_s)
    return _jobs(
        request, size, columns, {f'{p:g} % lost': replace(scenario, loss=p / 100) for p in LOSSES}
    )


LOSSES = (0.0, 10.0, 30.0, 50.0)


def tables_loss(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Errors over losses."""
    title = 'Packets lost'
    return [by_group(title, results, _BRIEF, _note(size, request), 'losses')]


def figures_loss(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """Errors over losses."""
    del size, request
    return {'has_loss': _curves(results, LOSSES, 'packets lost [%]', 'has_loss')}


def _curves(results: Sequence[RunResult], x: Sequence[float], x_label: str, name: str) -> Figure:
    groups = _groups(results)
    panels = []
    for title, kind in (('position', ''), ('velocity', 'v')):
        lines = []
        for column in _names(results):
            y = [
                sum(pooled(of(results, g, column), f'rms_{kind}{a}_after') ** 2 for a in 'xy')
                ** 0.5
                for g in groups
            ]
            lines.append((column.replace('_', ' '), x[: len(y)], y))
        unit = 'm' if title == 'position' else 'm/s'
        panels.append((f'{title}, horizontal RMS [{unit}]', lines))
    return figures.curves(panels, x_label, 'RMS after adaptation', name)


def plan_current(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs with a current that changes slowly."""
    c = request.station
    changing = replace(
        c.scenario(size.duration_s),
        current_change=c.current_change,
        current_turn=c.current_turn,
        current_period_s=c.current_period_s,
    )
    return _jobs(request, size, columns, {CHANGING: changing})


CHANGING = 'changing'


def tables_current(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of the errors in the changing current."""
    c = request.station
    text = (
        f'Speed by {100 * c.current_change:g} %, direction by {c.current_turn:g} rad,'
        f' sines of {c.current_period_s / 60:g} min.'
    )
    return [
        by_group('Slowly changing current', results, _AFTER, _note(size, request, text), 'current')
    ]


def figures_current(
    results: Sequence[RunResult], size: Size, request: Request
) -> dict[str, Figure]:
    """Figures of the errors over time in the changing current, seed 1."""
    del size, request
    wanted = [n for n in ('published', 'augmented_1e-6', 'default') if n in _names(results)]
    runs = [(n, r) for n in wanted for r in of(results, CHANGING, n) if r.series]
    if not runs:
        return {}
    return {'has_current': figures.error_lines(runs, 'has_current', limit_m=60.0, limit_mps=0.8)}


def plan_excitation(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs with thrust that hardly varies."""
    c = request.station
    low = c.scenario(size.duration_s, excitation=c.low_excitation)
    return _jobs(request, size, columns, {f'varied x {c.low_excitation:g}': low})


def tables_excitation(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of the errors, and of the identified parameters."""
    note = _note(size, request)
    return [
        by_group('Thrust that hardly varies', results, _AFTER, note, 'thrust'),
        by_group('Drag and current at 750 s', results, IDENTIFIED, note, 'thrust'),
    ]


def plan_heading(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs with a constant error of heading."""
    bias = request.station.heading_bias_deg
    scenario = request.station.scenario(size.duration_s, heading_bias=math.radians(bias))
    return _jobs(request, size, columns, {f'{bias:g} deg off': scenario})


def tables_heading(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of the errors, and of the identified parameters."""
    note = _note(size, request)
    return [
        by_group('Heading bias', results, _AFTER, note, 'heading'),
        by_group('Drag and current at 750 s', results, IDENTIFIED, note, 'heading'),
    ]


LATER_S = (0.0, 2.0, 8.0)


def plan_delay(request: Request, size: Size, columns: Sequence[str]) -> list[StationJob]:
    """Jobs with later packets: beyond the period in the last case, in order still."""
    scenario = request.station.scenario(size.duration_s)
    names = {f'{s:g} s later': s for s in LATER_S}
    return _jobs(request, size, columns, dict.fromkeys(names, scenario), names)


def tables_delay(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Errors over delays."""
    text = (
        'Delay without the addition: 1.3 to 1.7 s. The period is 2.5 s in all rows: a packet may'
        ' leave the station while the next interrogation is under way.'
    )
    return [by_group('Later packets', results, _LATE, _note(size, request, text), 'packets')]


def figures_delay(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """Errors over delays."""
    del size, request
    return {'has_delay': _curves(results, LATER_S, 'packets later by [s]', 'has_delay')}
