"""The paper's figures 4 to 10, the published system beside the default filter, one seed.

Also figures of the errors over losses, delays and other varied conditions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polar_nav_core.arrays import Array

from ...report.style import FULL_PX, color, drawing, new_figure, run_color
from ..jobs import RunResult
from .errors import ADAPTED_S, AFTER, AXES

_TRUE, _FIX = 'ink', 'fix'
_MINUTE = 60.0

Draw = Callable[[Axes, RunResult, str], None]


def _grid(
    runs: Sequence[RunResult], salt: str, draw: Draw, y_label: str, unit: str, *, height: int = 520
) -> Figure:
    """Figure and its panels over time, one column per run, one row per axis."""
    with drawing(salt):
        fig = new_figure(FULL_PX, height)
        axes = fig.subplots(2, len(runs), sharex=True, sharey='row', squeeze=False)
        for j, run in enumerate(runs):
            for i, axis in enumerate(AXES):
                ax = axes[i, j]
                draw(ax, run, axis)
                if j == 0:
                    ax.set_ylabel(f'{y_label.format(axis=axis)} [{unit}]')
            axes[0, j].set_title(run.column.replace('_', ' '))
            axes[1, j].set_xlabel('time [min]')
        handles, labels = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc='outside lower center', ncols=len(labels))
    return fig


def _minutes(run: RunResult, key: str = 'time_s') -> Array:
    return run.series[key] / _MINUTE


def _adaptation(ax: Axes) -> None:
    ax.axvline(ADAPTED_S / _MINUTE, color=color('muted'), linewidth=1.0, linestyle=':')


def coordinates(runs: Sequence[RunResult], name: str) -> Figure:
    """Figure 4: true, measured and estimated coordinates."""

    def draw(ax: Axes, run: RunResult, axis: str) -> None:
        s = run.series
        ax.plot(
            _minutes(run, 'fix_time_s'), s[f'fix_{axis}'], '.', color=color(_FIX), markersize=3.0,
            label='fixes of the station',
        )  # fmt: skip
        ax.plot(_minutes(run), s[f'true_{axis}'], color=color(_TRUE), linewidth=3, label='true')
        ax.plot(_minutes(run), s[axis], color=run_color(0), linewidth=1.1, label='estimate')
        _adaptation(ax)

    return _grid(runs, name, draw, '{axis}', 'm')


def position_errors(runs: Sequence[RunResult], name: str) -> Figure:
    """Figures 5 and 9: errors of fixes and estimate, and the published 3 sigma."""

    def draw(ax: Axes, run: RunResult, axis: str) -> None:
        s = run.series
        ax.plot(
            _minutes(run, 'fix_time_s'), s[f'fix_error_{axis}'], '.', color=color(_FIX),
            markersize=3.0, label='fixes of the station',
        )  # fmt: skip
        _band(ax, run, 3.0 * s[f'sigma_{axis}'])
        ax.plot(
            _minutes(run), s[f'error_{axis}'], color=color(_TRUE), linewidth=1.2, label='estimate'
        )
        _adaptation(ax)
        ax.set_ylim(-36.0, 36.0)

    return _grid(runs, name, draw, 'error of {axis}', 'm')


def _band(ax: Axes, run: RunResult, half: Array) -> None:
    ax.fill_between(
        _minutes(run), -half, half, color=run_color(1), alpha=0.18, linewidth=0,
        label='3σ of the filter',
    )  # fmt: skip


def tracks(runs: Sequence[RunResult], name: str) -> Figure:
    """Figure 6: measured track, and that of the model before and after the adaptation."""
    with drawing(name):
        fig = new_figure(FULL_PX, 480)
        axes = fig.subplots(1, 2)
        run = runs[0]
        s = run.series
        for ax, which, title in (
            (axes[0], 'before', 'before: nominal drag, no current'),
            (axes[1], 'after', 'after: as identified'),
        ):
            ax.plot(
                s['window_x'], s['window_y'], color=color(_FIX), linewidth=0.8, marker='.',
                markersize=2.5, label='fixes of the station',
            )  # fmt: skip
            ax.plot(
                s[f'model_{which}_x'], s[f'model_{which}_y'], color=color(_TRUE), label='model',
            )  # fmt: skip
            ax.set_title(title)
            ax.set_aspect('equal', adjustable='datalim')
            ax.set_xlabel('x [m]')
        axes[0].set_ylabel('y [m]')
        handles, labels = axes[0].get_legend_handles_labels()
        fig.legend(handles, labels, loc='outside lower center', ncols=2)
    return fig


def velocities(runs: Sequence[RunResult], name: str) -> Figure:
    """Figure 7: true and estimated velocity over ground, body axes."""

    def draw(ax: Axes, run: RunResult, axis: str) -> None:
        s = run.series
        ax.plot(_minutes(run), s[f'true_v{axis}'], color=color(_TRUE), label='true')
        ax.plot(_minutes(run), s[f'v{axis}'], color=run_color(1), linewidth=1.1, label='estimate')
        _adaptation(ax)

    return _grid(runs, name, draw, 'v_{axis}', 'm/s')


def velocity_errors(runs: Sequence[RunResult], name: str) -> Figure:
    """Figures 8 and 10: errors of the velocity after the adaptation; the paper's largest."""

    def draw(ax: Axes, run: RunResult, axis: str) -> None:
        late = run.series['time_s'] >= AFTER[0]
        ax.axhspan(
            -_PRINTED[axis], _PRINTED[axis], color=color('muted'), alpha=0.15, linewidth=0,
            label="the paper's largest",
        )  # fmt: skip
        ax.plot(
            _minutes(run)[late], run.series[f'error_v{axis}'][late], color=color(_TRUE),
            linewidth=1.1, label='estimate',
        )  # fmt: skip

    return _grid(runs, name, draw, 'error of v_{axis}', 'm/s')


_PRINTED = {'x': 0.02, 'y': 0.01}


def curves(
    panels: Sequence[tuple[str, Sequence[tuple[str, Sequence[float], Sequence[float]]]]],
    x_label: str,
    y_label: str,
    name: str,
    *,
    logarithmic: bool = False,
) -> Figure:
    """Figure of curves over a varied condition, one panel each."""
    markers = 'osD^vPX'
    with drawing(name):
        fig = new_figure(FULL_PX, 380)
        axes = np.atleast_1d(fig.subplots(1, len(panels)))
        for ax, (title, lines) in zip(axes, panels, strict=True):
            ax.set_title(title)
            for i, (label, x, y) in enumerate(lines):
                shade = run_color(i) if i < 5 else color('muted')
                ax.plot(x, y, color=shade, marker=markers[i % 7], markersize=5, label=label)
            ax.set_xlabel(x_label)
            if logarithmic:
                ax.set_yscale('log')
            else:
                ax.set_ylim(bottom=0.0)
        axes[0].set_ylabel(y_label)
        handles, labels = axes[0].get_legend_handles_labels()
        fig.legend(handles, labels, loc='outside lower center', ncols=min(5, len(labels)))
    return fig


def error_lines(
    runs: Sequence[tuple[str, RunResult]], name: str, *, limit_m: float, limit_mps: float
) -> Figure:
    """Figure of several filters' errors over time: position left, velocity right."""
    with drawing(name):
        fig = new_figure(FULL_PX, 520)
        axes = fig.subplots(2, 2, sharex=True)
        for i, axis in enumerate(AXES):
            for j, (key, unit, limit) in enumerate(
                ((axis, 'm', limit_m), (f'v{axis}', 'm/s', limit_mps))
            ):
                ax = axes[i, j]
                for k, (label, run) in enumerate(runs):
                    ax.plot(
                        _minutes(run), run.series[f'error_{key}'], color=run_color(k),
                        linewidth=1.1, label=label,
                    )  # fmt: skip
                ax.set_ylim(-limit, limit)
                ax.set_title(f'error of {key.replace("v", "v_")} [{unit}]')
                _adaptation(ax)
        for ax in axes[1]:
            ax.set_xlabel('time [min]')
        handles, labels = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc='outside lower center', ncols=len(labels))
    return fig
