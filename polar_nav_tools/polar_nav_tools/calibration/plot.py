"""Draws innovations as stated and as calibrated, by sensor, in units of their sigma."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.innovations import Innovations

from ..report.style import FULL_PX, color, drawing, new_figure
from .estimate import Estimated
from .problem import SENSORS

_MOST_POINTS = 4000
"""Of a sensor; every n-th is drawn where there are more."""
_HEIGHT_PX = 190
_WIDEST = 8.0
"""Largest innovation that is drawn in its place, for calibrated ones stay within 4 [sigma]."""


def innovations_figure(path: Path, found: Estimated) -> None:
    """Write a figure, PNG or SVG by its name: innovations before and after, a row per sensor."""
    sensors = [(rank, name) for rank, name in SENSORS.items() if name in found.misfits()]
    with drawing('calibrate'):
        fig = new_figure(FULL_PX, 40 + _HEIGHT_PX * len(sensors))
        fig.patch.set_alpha(1.0)
        fig.patch.set_facecolor(color('card'))
        axes = fig.subplots(len(sensors), 1, sharex=True, squeeze=False)[:, 0]
        start_ns = int(found.before.stamps_ns[0])
        for ax, (rank, name) in zip(axes, sensors, strict=True):
            before, after = found.misfits()[name]
            ax.set_title(f'{name}: mean square {before:.3g} as stated, {after:.3g} calibrated')
            ax.set_ylabel('innovation [σ]')
            _dots(ax, found.before, rank, start_ns, 'run0', 'as stated')
            _dots(ax, found.after, rank, start_ns, 'run1', 'calibrated')
            ax.set_ylim(-_WIDEST, _WIDEST)
        axes[0].legend(loc='upper right', ncols=2, markerscale=4)
        axes[-1].set_xlabel('time [s]')
        fig.savefig(path, dpi=80, metadata={'Date': None} if path.suffix == '.svg' else None)


def _dots(ax: Axes, run: Innovations, rank: Rank, start_ns: int, token: str, label: str) -> None:
    """Dots of all rows of a sensor; what lies beyond the edge is drawn at the edge."""
    of = np.flatnonzero(run.ranks == rank)
    of = of[:: max(1, len(of) // _MOST_POINTS)]
    time_s = (run.stamps_ns[of] - start_ns) * 1e-9
    # Of a fix without height any of the three may be the empty one.
    rows = 3 if rank is Rank.FIX else int(run.sizes[of].max())
    white = np.clip(run.white[of, :rows], -_WIDEST, _WIDEST)
    ax.plot(
        np.repeat(time_s, rows),
        white.ravel(),
        '.',
        markersize=1.5,
        color=color(token),
        label=label,
    )
