"""Figure of `polar bench delay`: time of one late fix over its age, and of runs with many."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ..report.style import FULL_PX, color, drawing, new_figure
from .delay import DelayBenchmark
from .late_fixes import RUN_STRATEGIES

_MARKERS = {
    'ignore': ('muted', 'v'),
    'tagged': ('run3', 'D'),
    'back_propagate': ('run2', '^'),
    'clone': ('run1', 'o'),
    'rewind': ('run0', 's'),
}


def delay_figure(result: DelayBenchmark) -> Figure:
    """Figure with the time of one late fix over its age left, cost of many right."""
    with drawing('bench-delay'):
        fig = new_figure(FULL_PX, 420)
        left, right = fig.subplots(1, 2, width_ratios=(3, 2))
        _one_fix(left, result)
        _runs(right, result)
    return fig


def write_figure(result: DelayBenchmark, path: Path) -> None:
    """Write the figure in the format of the file extension.

    Raises
    ------
    ValueError
        For an unknown format of matplotlib.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = {'Date': None} if path.suffix.lower() == '.svg' else None
    with drawing('bench-delay'):
        delay_figure(result).savefig(path, dpi=144, facecolor=color('card'), metadata=metadata)


def _one_fix(ax: Axes, result: DelayBenchmark) -> None:
    ages = list(result.fix)
    for name, (shade, marker) in _MARKERS.items():
        us = [result.fix[age][name].median_us for age in ages]
        ax.plot(ages, us, color=color(shade), marker=marker, markersize=5, label=name)
    stone_soup = result.peer['stone_soup'].median_us
    ax.plot(
        [result.peer_age_s], [stone_soup], color=color('ink'), marker='*', markersize=12,
        linestyle='none', label='Stone Soup, stepped',
    )  # fmt: skip
    ax.set_xscale('log')
    ax.set_yscale('log')
    ax.xaxis.set_major_locator(FixedLocator(ages))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f'{x:g}'))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_title('One late fix')
    ax.set_xlabel('age [s]')
    ax.set_ylabel('time of the fix in the engine [us]')
    ax.legend(loc='upper left', ncols=2)


def _runs(ax: Axes, result: DelayBenchmark) -> None:
    rates = [rate for rate in result.runs if rate > 0.0]
    width = 0.8 / len(RUN_STRATEGIES)
    for i, name in enumerate(RUN_STRATEGIES):
        shade = color(_MARKERS[name][0])
        for k, rate in enumerate(rates):
            cost = result.cost(rate, name).median
            x = k + (i - 0.5 * (len(RUN_STRATEGIES) - 1)) * width
            ax.bar(
                [x], [cost - 1.0], 0.9 * width, bottom=1.0, color=shade,
                label=name if k == 0 else None,
            )  # fmt: skip
            ax.annotate(
                f'{cost:.3g}', (x, cost), xytext=(0, 2), textcoords='offset points', ha='center',
                fontsize=10, color=color('ink'),
            )  # fmt: skip
    ax.axhline(1.0, color=color('muted'), linewidth=1.0)
    ax.set_yscale('log')
    ax.set_xticks(range(len(rates)), [f'{rate:g} Hz' for rate in rates])
    ax.xaxis.grid(visible=False)
    ax.set_title(f'Run of {result.run_s:g} s, all fixes {result.run_age_s:g} s old')
    ax.set_xlabel('fixes')
    ax.set_ylabel('time over that of the run with none')
    ax.legend(loc='upper left')
