"""Figures of the errors: horizontal of all configurations, each component in its sigma band."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ...scoring import Comparison, Score
from ...scoring.errors import ARCMIN
from ...scoring.tables import show
from ..style import HALF_PX, color, drawing, new_figure, run_color
from ..svg import to_svg
from .base import (
    Clock,
    Picture,
    band,
    line,
    outside,
    row_heading,
    shade_second_half,
    symmetric_limit,
)

Floats = NDArray[np.float64]

_COLUMNS = 480  # pixel columns of half a page; three samples per pixel are more than is seen
_FLOOR = 1e-3  # [m]; smaller errors are drawn here on the logarithmic axis


def horizontal_error(scores: Comparison, clock: Clock) -> Picture:
    """Figure of the distance of estimate and truth over time, all runs, logarithmic axis."""
    runs = scores.scores
    expected = next(iter(runs.values())).second_half.lag.expected
    words = '; '.join(f'{n} {show(s.second_half.rms("horizontal"))} m' for n, s in runs.items())
    alt = f'Horizontal position error over time. RMS of the second half: {words}.'
    with drawing('horizontal-error'):
        fig = new_figure(1080, 330)
        ax = fig.add_subplot()
        ax.set_yscale('log')
        shade_second_half(ax, clock)
        top, bottom = 0.0, np.inf
        ends = []
        for index, (name, score) in enumerate(runs.items()):
            error = np.maximum(score.errors.horizontal, _FLOOR)
            t = clock(score.errors.stamp_ns)
            shade, top_layer = run_color(index), 3 + index
            line(ax, t, error, columns=960, color=shade, lw=0.7, alpha=0.4, zorder=top_layer)
            smooth = np.maximum(moving_rms(t, error, 0.02 * clock.span[1]), _FLOOR)
            line(ax, t, smooth, columns=960, color=shade, lw=2.2, zorder=top_layer + 0.5)
            finite = error[np.isfinite(error)]
            top = max(top, float(finite.max(initial=_FLOOR)))
            bottom = min(bottom, float(np.quantile(finite, 0.02)) if finite.size else np.inf)
            rms = score.second_half.rms('horizontal')
            ends.append((rms, f'{name}\n{show(rms)} m RMS', shade))
        if np.isfinite(expected) and expected > 0.0:
            ax.axhline(expected, color=color('ink'), lw=1.2, ls=(0, (5, 3)), zorder=8)
            ends.append((expected, f'speed × mean delay\n{show(expected)} m', color('ink')))
            top = max(top, expected)
        ax.set_ylim(0.7 * (bottom if np.isfinite(bottom) else _FLOOR), 1.7 * max(top, _FLOOR))
        ax.yaxis.set_major_formatter(lambda value, _: f'{value:g}')
        ax.set_ylabel('horizontal error [m]')
        clock.axis(ax)
        _end_labels(ax, ends)
        row_heading(ax, '', 'second half')
        svg = to_svg(fig, 'horizontal-error', alt)
    return Picture(
        key='horizontal-error',
        title='Horizontal position error',
        caption=(
            'Distance from the truth of the same stamp, on a logarithmic axis; the bold line is '
            'its RMS over a moving fiftieth of the run. The dashed line is what theory says '
            'ignoring the delay costs: speed × mean delay of the fused fixes. The scores that '
            f'count are those of the tinted second half: {words}.'
        ),
        alt=alt,
        svg=svg,
    )


def moving_rms(t: Floats, values: Floats, width: float) -> Floats:
    """RMS of the values within +- width / 2 of each time; NaN where there is none."""
    good = np.isfinite(values)
    total = np.r_[0.0, np.cumsum(np.where(good, values, 0.0) ** 2)]
    count = np.r_[0, np.cumsum(good)]
    first = np.searchsorted(t, t - 0.5 * width, side='left')
    last = np.searchsorted(t, t + 0.5 * width, side='right')
    n = count[last] - count[first]
    mean = np.maximum(total[last] - total[first], 0.0) / np.maximum(n, 1)
    return np.where(n > 0, np.sqrt(mean), np.nan)


def _end_labels(ax: Axes, ends: list[tuple[float, str, str]]) -> None:
    """Names at the right of the lines, pushed apart where they would overlap."""
    low, high = np.log(ax.get_ylim())
    ends = sorted(ends)
    wanted = [(np.log(max(v, _FLOOR)) - low) / (high - low) for v, _, _ in ends]
    for place, (_, text, shade) in zip(spread(wanted, 0.16), ends, strict=True):
        ax.text(
            1.008,
            place,
            text,
            transform=ax.transAxes,
            color=shade,
            fontsize=12,
            fontweight='bold',
            va='center',
        )


def spread(places: list[float], gap: float) -> list[float]:
    """Places nearest to those wanted, in order and at least `gap` apart (isotonic regression)."""
    blocks: list[list[float]] = []  # [mean, count] of labels that stand in one heap
    for k, place in enumerate(places):
        blocks.append([place - k * gap, 1.0])
        while len(blocks) > 1 and blocks[-1][0] < blocks[-2][0]:
            mean, count = blocks.pop()
            blocks[-1][0] = (blocks[-1][0] * blocks[-1][1] + mean * count) / (
                blocks[-1][1] + count
            )
            blocks[-1][1] += count
    flat = [mean for mean, count in blocks for _ in range(int(count))]
    return [base + k * gap for k, base in enumerate(flat)]


def position_error(score: Score, index: int, clock: Clock) -> Picture:
    """Figure of the error along grid east, grid north and up with the 3-sigma band."""
    sigma = score.errors.sigma_position_G
    rows = [
        (name, 'm', score.errors.dr_G[:, k], 3.0 * sigma[:, k])
        for k, name in enumerate(('grid east', 'grid north', 'up'))
    ]
    return _bands(
        score,
        index,
        clock,
        key='position-error',
        title='Position error in grid axes',
        rows=rows,
        caption=(
            'Estimate minus truth; the band is ±3 of the filter’s own sigma. '
            'Each picture has its own scale.'
        ),
    )


def velocity_heading_error(score: Score, index: int, clock: Clock) -> Picture:
    """Figure of the errors of velocity in grid axes and heading with the 3-sigma band."""
    sigma_v, sigma_phi = score.errors.sigma_velocity_G, score.errors.sigma_attitude_G
    rows = [
        ('velocity, grid east', 'm/s', score.errors.dv_G[:, 0], 3.0 * sigma_v[:, 0]),
        ('velocity, grid north', 'm/s', score.errors.dv_G[:, 1], 3.0 * sigma_v[:, 1]),
        ('heading', '′', ARCMIN * score.errors.phi_G[:, 2], 3.0 * ARCMIN * sigma_phi[:, 2]),
    ]
    return _bands(
        score,
        index,
        clock,
        key='velocity-error',
        title='Velocity and heading error',
        rows=rows,
        caption='Heading is φz, in minutes of arc, about the vertical. Bands are ±3 sigma.',
    )


def tilt_error(score: Score, index: int, clock: Clock) -> Picture:
    """Figure of the tilt about the grid axes with the 3-sigma band."""
    sigma = score.errors.sigma_attitude_G
    rows = [
        (f'φ{axis}', '′', ARCMIN * score.errors.phi_G[:, k], 3.0 * ARCMIN * sigma[:, k])
        for k, axis in enumerate(('x, grid east', 'y, grid north'))
    ]
    return _bands(
        score,
        index,
        clock,
        key='tilt-error',
        title='Tilt error',
        rows=rows,
        caption='About the horizontal grid axes, in minutes of arc, with the ±3 sigma band.',
    )


def _bands(
    score: Score,
    index: int,
    clock: Clock,
    *,
    key: str,
    title: str,
    rows: list[tuple[str, str, Floats, Floats]],
    caption: str,
) -> Picture:
    """One small plot per component, errors in the run's colour inside a band of the same."""
    key = f'{key}-{index}'
    shade = run_color(index)
    t = clock(score.errors.stamp_ns)
    shares = [_inside(error, width) for _, _, error, width in rows]
    words = ', '.join(
        f'{name} {100 * share:.0f} %' for (name, *_), share in zip(rows, shares, strict=True)
    )
    alt = f'{title} of {score.name}. Samples inside the 3-sigma band: {words}.'
    with drawing(key):
        fig = new_figure(HALF_PX, 66 + 128 * len(rows))
        axes = fig.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (name, unit, error, width), share in zip(axes, rows, shares, strict=True):
            limit = symmetric_limit(error, width)
            shade_second_half(ax, clock)
            ax.axhline(0.0, color=color('muted'), lw=0.8, zorder=1.4)
            band(ax, t, width, shade, columns=_COLUMNS)
            line(ax, t, error, columns=_COLUMNS, color=shade, lw=1.3, zorder=3)
            ax.set_ylim(-limit, limit)
            ax.yaxis.set_major_locator(MaxNLocator(4, symmetric=True, min_n_ticks=3))
            notes = [f'{100 * share:.0f} % inside', outside(error, limit, unit)]
            row_heading(ax, f'{name} [{unit}]', ' · '.join(n for n in notes if n))
            clock.axis(ax, label=ax is axes[-1])
        fig.suptitle(score.name, x=0.008, ha='left', fontsize=13, fontweight='bold', color=shade)
        svg = to_svg(fig, key, alt)
    return Picture(key, title, caption, alt, svg, width='half')


def _inside(error: Floats, width: Floats) -> float:
    known = np.isfinite(error) & np.isfinite(width)
    return float(np.mean(np.abs(error[known]) <= width[known])) if known.any() else float('nan')
