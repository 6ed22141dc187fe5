"""Figures of errors over time in the report's style: attitude, velocity, position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polar_nav_core.arrays import Array

from ..report.style import FULL_PX, color, drawing, new_figure, run_color
from .jobs import RunResult
from .paper import QUANTITIES

_SETTLED = 0.05
"""Initial share of the run that the vertical scale ignores: start errors decay in it."""


@dataclass(frozen=True)
class Line:
    """One run in a figure."""

    label: str
    run: RunResult


def errors_figure(lines: Sequence[Line], duration_s: float, caption: str) -> Figure:
    """Figure of seven small plots, one per row of the paper's tables.

    Parameters
    ----------
    lines : sequence of Line
        Runs with their series.
    duration_s : float
        Length of the runs.
    caption : str
        What all lines share.
    """
    unit, scale = _unit(duration_s)
    with drawing('experiment'):
        fig = new_figure(FULL_PX, 760)
        axes = fig.subplots(3, 3, sharex=True)
        rows = {'phi': 0, 'v': 1, 'r': 2}
        for q in QUANTITIES:
            kind, axis = q.key.split('_')
            ax = axes[rows[kind], 'xyz'.index(axis)]
            ax.set_title(f'{q.title} [{q.unit}]')
            for i, line in enumerate(lines):
                _draw(ax, line.run, q.key, scale, run_color(i))
            limit = _limit([line.run for line in lines], q.key, duration_s)
            ax.set_ylim(-limit, limit)
        for ax in axes[2]:
            ax.set_xlabel(f'time [{unit}]')
            ax.tick_params(labelbottom=True)
        axes[1, 2].axis('off')
        axes[2, 2].axis('off')
        axes[1, 2].legend(
            handles=[
                axes[1, 2].plot([], [], color=run_color(i), label=_label(line))[0]
                for i, line in enumerate(lines)
            ],
            loc='upper left',
            title=caption,
            alignment='left',
        )
    return fig


def _draw(ax: Axes, run: RunResult, key: str, scale: float, shade: str) -> None:
    t, y = run.series['time_s'] * scale, run.series[key]
    ax.plot(t, y, color=shade, linewidth=1.1)
    if run.stopped and len(t):
        ax.plot(t[-1:], y[-1:], color=shade, marker='x', markersize=7, clip_on=False)


def _label(line: Line) -> str:
    return (
        f'{line.label}: stopped at {line.run.stopped_s:.0f} s' if line.run.stopped else line.label
    )


def _limit(runs: Sequence[RunResult], key: str, duration_s: float) -> float:
    """Half height of a plot that contains all errors after the start."""
    largest = 0.0
    for run in runs:
        settled = run.series['time_s'] > _SETTLED * duration_s
        late = np.abs(run.series[key][settled])
        largest = max(largest, float(late.max()) if late.size else 0.0)
    return 1.15 * largest or 1.0


def _unit(duration_s: float) -> tuple[str, float]:
    if duration_s <= 180.0:
        return 's', 1.0
    return ('min', 1.0 / 60.0) if duration_s <= 3 * 3600.0 else ('h', 1.0 / 3600.0)


@dataclass(frozen=True)
class Band:
    """A horizontal band in a figure."""

    label: str
    low: float
    high: float


def band_figure(
    panels: Sequence[tuple[str, Sequence[tuple[str, Array, Array]], Sequence[Band]]],
    x_label: str,
    y_label: str,
) -> Figure:
    """Figure of curves over time in front of bands, one panel each.

    Parameters
    ----------
    panels : sequence of (title, curves, bands)
        A curve is (label, x, y).
    """
    with drawing('consistency'):
        fig = new_figure(FULL_PX, 360)
        axes = np.atleast_1d(fig.subplots(1, len(panels)))
        for ax, (title, curves, bands) in zip(axes, panels, strict=True):
            ax.set_title(title)
            for band in bands:
                ax.axhspan(band.low, band.high, color=color('muted'), alpha=0.13, linewidth=0)
                ax.annotate(
                    band.label,
                    (1.0, band.high),
                    xycoords=ax.get_yaxis_transform(),
                    ha='right',
                    va='bottom',
                    fontsize=10,
                    color=color('muted'),
                )
            for i, (label, x, y) in enumerate(curves):
                ax.plot(x, y, color=run_color(i), linewidth=1.3, label=label)
            ax.axhline(1.0, color=color('rule'), linewidth=1.0)
            ax.set_xlabel(x_label)
        axes[0].set_ylabel(y_label)
        if panels and panels[0][1]:
            axes[0].legend(loc='lower right')
    return fig


def ratio_figure(
    panels: Sequence[tuple[str, Sequence[tuple[str, Sequence[float], Sequence[float]]]]],
    x_label: str,
    y_label: str,
) -> Figure:
    """Figure of curves over delay in panels, both axes logarithmic above the smallest delay.

    Parameters
    ----------
    panels : sequence of (title, curves)
        A curve is (label, x, y).
    """
    with drawing('ablation'):
        fig = new_figure(FULL_PX, 400)
        axes = np.atleast_1d(fig.subplots(1, len(panels), sharey=True))
        labels = list(dict.fromkeys(label for _, curves in panels for label, _, _ in curves))
        markers = 'osD^vP'
        for ax, (title, curves) in zip(axes, panels, strict=True):
            ax.set_title(title)
            for label, x, y in curves:
                i = labels.index(label)
                shade = run_color(i) if i < 5 else color('muted')
                ax.plot(x, y, color=shade, marker=markers[i % 6], markersize=4.5, label=label)
            ax.set_xscale('symlog', linthresh=1.0)
            ax.set_yscale('log')
            ax.set_xlabel(x_label)
        axes[0].set_ylabel(y_label)
        handles, names = axes[0].get_legend_handles_labels()
        fig.legend(handles, names, loc='outside lower center', ncols=6)
    return fig
