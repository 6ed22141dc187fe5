"""Figures of estimated current and parameters: current as an arrow, parameters over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ...scoring.model import (
    CURRENT_X,
    CURRENT_Y,
    HEADING,
    LINEAR,
    QUADRATIC,
    TOTAL,
    ModelErrors,
    ModelScore,
    model_errors,
    true_current,
)
from ...scoring.tables import show
from ...series.model import Identified, ModelRun
from ...series.vehicle import TruthSeries
from ..decimate import envelope
from ..style import HALF_PX, color, drawing, new_figure, run_color
from ..svg import to_svg
from .base import Clock, Picture, line, row_heading, shade_second_half
from .chart import window

Floats = NDArray[np.float64]

_COLUMNS = 480
_ASPECT = 1.4  # width to height of the plane of the arrows
_SETTLED = 0.25  # share of the run after which an axis shows everything
_PARAMETERS = {
    LINEAR: 'drag_linear',
    QUADRATIC: 'drag_quadratic',
    TOTAL: '',
    HEADING: 'heading_bias',
}


def current_arrow(
    name: str, index: int, one: ModelScore, truth: TruthSeries, clock: Clock
) -> Picture:
    """Figure of the current at the end with its ellipses, beside the true one, and over time."""
    run, key = one.run, f'current-{index}'
    rows, shade = run.estimated, run_color(index)
    found = model_errors(rows, run.truth, truth)
    alt = (
        f'Current estimated by {name}: at the end {_vector(rows.current_G[-1])} m/s, '
        f'true {_vector(true_current(rows.stamp_ns[-1:], truth)[0])} m/s.'
    )
    with drawing(key):
        fig = new_figure(HALF_PX, 620)
        grid = fig.add_gridspec(3, 1, height_ratios=(2.6, 1.0, 1.0))
        _plane(fig.add_subplot(grid[0]), run, truth, shade)
        for k, what in enumerate((CURRENT_X, CURRENT_Y)):
            ax = fig.add_subplot(grid[1 + k])
            marks = _marks(run.identified, ('current_x', 'current_y')[k], 1.0)
            _over_time(ax, what, found[what], rows.stamp_ns, clock, shade, marks)
            _events(ax, marks, clock)
            clock.axis(ax, label=k == 1)
        fig.suptitle(name, x=0.008, ha='left', fontsize=13, fontweight='bold', color=shade)
        svg = to_svg(fig, key, alt)
    return Picture(
        key,
        'The current',
        'Where the water goes, grid axes: the arrow in colour is the estimate at the end of the '
        'run with the ellipses of its 1 and 3 sigma, the thin line the way the estimate took in '
        'the last three quarters, the thick arrow the truth at the end. Below, both components '
        'over time with the ±1 and ±3 sigma bands around the estimate and the truth dashed; '
        'diamonds with a bar of ±1 sigma are identifications, hollow ones were refused.',
        alt,
        svg,
        width='half',
    )


def model_parameters(
    name: str, index: int, one: ModelScore, truth: TruthSeries, clock: Clock
) -> Picture:
    """Figure of drag and heading bias over time with bands, truth and identifications."""
    run, key = one.run, f'model-{index}'
    rows, shade = run.estimated, run_color(index)
    found = model_errors(rows, run.truth, truth)
    words = ', '.join(
        f'{what} {_final(found[what])} {found[what].unit}, true {show(found[what].truth[-1])}'
        for what in _PARAMETERS
    )
    alt = f'Parameters estimated by {name} at the end of the run: {words}.'
    with drawing(key):
        fig = new_figure(HALF_PX, 66 + 138 * len(_PARAMETERS))
        axes = fig.subplots(len(_PARAMETERS), 1, sharex=True)
        for ax, (what, field) in zip(axes, _PARAMETERS.items(), strict=True):
            marks = _marks(run.identified, field, 180.0 / np.pi if what == HEADING else 1.0)
            title = what if what != TOTAL else f'drag at {rows.v_r_b[:, 0].mean():.2f} m/s'
            _over_time(ax, title, found[what], rows.stamp_ns, clock, shade, marks)
            _events(ax, marks, clock)
            clock.axis(ax, label=ax is axes[-1])
        fig.suptitle(name, x=0.008, ha='left', fontsize=13, fontweight='bold', color=shade)
        svg = to_svg(fig, key, alt)
    return Picture(
        key,
        'Drag and heading bias',
        'Estimates with the bands of ±1 and ±3 of their own sigma, the truth dashed, diamonds for '
        'identifications. d1x and d2x trade against each other: a speed that hardly changes '
        'determines only the drag at that speed, in the third row. A line without a band is a '
        'value that the filter assumes.',
        alt,
        svg,
        width='half',
    )


def _vector(v_G: Floats) -> str:
    return f'{v_G[0]:.3f} to grid east and {v_G[1]:.3f} to grid north'


def _plane(ax: Axes, run: ModelRun, truth: TruthSeries, shade: str) -> None:
    """Current as arrows from the origin; x is grid east, y is grid north."""
    rows = run.estimated
    settled = rows.rows(slice(int(len(rows) * _SETTLED), None))
    estimate, covariance = rows.current_G[-1, :2], rows.P_current_G[-1, :2, :2]
    true = true_current(rows.stamp_ns[-1:], truth)[0, :2]
    way = settled.current_G[:, :2]
    for times, alpha in ((3.0, 0.14), (1.0, 0.3)):
        _ellipse(ax, estimate, covariance, times, shade, alpha)
    ax.plot(*way.T, color=shade, lw=0.8, alpha=0.55, zorder=3)
    _arrow(ax, true, color('ink'), 3.2, 4)
    _arrow(ax, estimate, shade, 1.9, 5)
    ax.plot(0, 0, ls='', marker='o', ms=5, color=color('ink'), zorder=6)
    variance = np.diagonal(covariance)
    reach = 3.0 * np.sqrt(np.where(variance > 0.0, variance, 0.0))
    points = np.vstack([np.zeros(2), true, estimate + reach, estimate - reach, way])
    points = points[np.isfinite(points).all(1)]
    low, high = window(points, _ASPECT, least=1e-3)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect('equal')
    ax.xaxis.set_major_locator(MaxNLocator(6))
    ax.yaxis.set_major_locator(MaxNLocator(6))
    ax.set_xlabel('to grid east [m/s]')
    ax.set_ylabel('to grid north [m/s]')
    row_heading(
        ax,
        f'estimate {np.hypot(*estimate):.3f} m/s',
        f'truth {np.hypot(*true):.3f} m/s · off by {1000 * np.hypot(*(estimate - true)):.0f} mm/s',
    )


def _ellipse(
    ax: Axes, center: Floats, covariance: Floats, times: float, shade: str, alpha: float
) -> None:
    if not np.isfinite(covariance).all():
        return
    values, vectors = np.linalg.eigh(covariance)
    if values[0] <= 0.0:
        return
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    width, height = (2.0 * times * float(np.sqrt(v)) for v in values[::-1])
    patch = Ellipse(
        (float(center[0]), float(center[1])),
        width,
        height,
        angle=angle,
        facecolor=shade,
        edgecolor=shade,
        alpha=alpha,
        linewidth=1.0,
        zorder=2,
    )
    ax.add_patch(patch)


def _arrow(ax: Axes, tip: Floats, shade: str, width: float, layer: int) -> None:
    if not np.isfinite(tip).all():
        return
    ax.annotate(
        '',
        (float(tip[0]), float(tip[1])),
        xytext=(0.0, 0.0),
        arrowprops={
            'arrowstyle': '-|>,head_width=0.32,head_length=0.7',
            'color': shade,
            'lw': width,
            'shrinkA': 0,
            'shrinkB': 0,
        },
        zorder=layer,
    )


@dataclass(frozen=True)
class _Mark:
    """Result of an identification for one quantity."""

    stamp_ns: int
    value: float
    sigma: float
    accepted: bool


def _marks(identified: tuple[Identified, ...], field: str, factor: float) -> list[_Mark]:
    found = [
        _Mark(
            i.stamp_ns,
            i.values.get(field, np.nan) * factor,
            i.sigmas.get(field, np.nan) * factor,
            i.verdict == 'ACCEPTED',
        )
        for i in identified
    ]
    return [mark for mark in found if np.isfinite(mark.value)]


def _over_time(
    ax: Axes,
    what: str,
    e: ModelErrors,
    stamp_ns: NDArray[np.int64],
    clock: Clock,
    shade: str,
    marks: list[_Mark],
) -> None:
    t = clock(stamp_ns)
    shade_second_half(ax, clock)
    keep = envelope(t, e.estimate, _COLUMNS)
    for times, alpha in ((3.0, 0.12), (1.0, 0.24)):
        low, high = e.estimate - times * e.sigma, e.estimate + times * e.sigma
        ax.fill_between(
            t[keep], low[keep], high[keep], color=shade, alpha=alpha, linewidth=0, zorder=1.5
        )
    line(ax, t, e.estimate, columns=_COLUMNS, color=shade, lw=1.4, zorder=3)
    if np.isfinite(e.truth).any():
        style = {'color': color('ink'), 'lw': 1.2, 'ls': (0, (5, 3)), 'zorder': 4}
        line(ax, t, e.truth, columns=_COLUMNS, **style)
    settled_ns = int(stamp_ns[int(len(stamp_ns) * _SETTLED)])
    ax.set_ylim(*_limits(e, [m for m in marks if m.stamp_ns >= settled_ns]))
    ax.yaxis.set_major_locator(MaxNLocator(4, min_n_ticks=3))
    true = f', true {show(float(e.truth[-1]))}' if np.isfinite(e.truth[-1]) else ''
    row_heading(ax, f'{what} [{e.unit}]', _final(e) + true)


def _final(e: ModelErrors) -> str:
    """Text of the last estimate with its sigma, or of a value that is not estimated."""
    value, sigma = float(e.estimate[-1]), float(e.sigma[-1])
    spread = f'± {show(sigma)}' if np.isfinite(sigma) and sigma > 0.0 else '(assumed)'
    return f'{show(value)} {spread}'


def _limits(e: ModelErrors, marks: list[_Mark]) -> tuple[float, float]:
    """Limits of the axis: estimate, truth, most of the bands and marks after the start."""
    start = int(len(e.estimate) * _SETTLED)
    late = slice(start, None)
    width = 3.0 * e.sigma[late]
    values = np.concatenate(
        [e.estimate[late], e.truth[late], e.estimate[late] - width, e.estimate[late] + width]
    )
    values = values[np.isfinite(values)]
    if not values.size:
        return -1.0, 1.0
    low, high = (float(v) for v in np.quantile(values, [0.02, 0.98]))
    taken = [m.value + s * np.nan_to_num(m.sigma) for m in marks if m.accepted for s in (-1, 1)]
    exact = np.concatenate([e.estimate[late], e.truth[late], taken])
    exact = exact[np.isfinite(exact)]
    low, high = min(low, float(exact.min())), max(high, float(exact.max()))
    pad = max(0.08 * (high - low), 0.02 * abs(high + low), 1e-3)
    return low - pad, high + pad


def _events(ax: Axes, marks: list[_Mark], clock: Clock) -> None:
    """Draw diamonds at identifications of this quantity, hollow ones if refused."""
    for m in marks:
        t = float(clock(m.stamp_ns))
        if np.isfinite(m.sigma) and m.accepted:
            low, high = m.value - m.sigma, m.value + m.sigma
            ax.plot([t, t], [low, high], color=color('fix'), lw=1.4, zorder=5)
        ax.plot(
            t,
            m.value,
            ls='',
            marker='D',
            ms=6,
            mew=1.2,
            mfc=color('fix') if m.accepted else 'none',
            mec=color('fix'),
            zorder=6,
        )
