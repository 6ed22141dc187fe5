"""Common parts of all figures: their type, the time axis, lines with their band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ..decimate import envelope
from ..style import color

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Picture:
    """One figure of the report."""

    key: str  # id in the page
    title: str
    caption: str  # text beside it
    alt: str  # text for screen readers
    svg: str
    width: str = 'full'  # 'full' or 'half'


@dataclass(frozen=True)
class Clock:
    """Mission time for axes: zero at the start of the truth."""

    start_ns: int
    end_ns: int

    @property
    def unit(self) -> str:
        """Unit of the axis: s up to 3 minutes, min up to 3 hours, then h."""
        seconds = (self.end_ns - self.start_ns) * 1e-9
        return 's' if seconds <= 180.0 else 'min' if seconds <= 3 * 3600.0 else 'h'

    def __call__(self, stamp_ns: Ints | int) -> Floats:
        """Mission time of stamps, in `unit`."""
        scale = {'s': 1.0, 'min': 60.0, 'h': 3600.0}[self.unit]
        since_ns = np.asarray(stamp_ns, dtype=np.int64) - self.start_ns
        return np.asarray(since_ns * (1e-9 / scale), dtype=np.float64)

    @property
    def span(self) -> tuple[float, float]:
        """First and last mission time, in `unit`."""
        return 0.0, float(self(self.end_ns))

    def axis(self, ax: Axes, *, label: bool = True) -> None:
        """Set limits and ticks of a time axis."""
        low, high = self.span
        pad = 0.01 * (high - low) or 1.0
        ax.set_xlim(low - pad, high + pad)
        steps = [1, 2, 3, 5, 6, 10] if self.unit == 'min' else [1, 2, 3, 4, 6, 8, 10]
        ax.xaxis.set_major_locator(MaxNLocator(6, steps=steps))
        if label:
            ax.set_xlabel(f'mission time [{self.unit}]')


def line(ax: Axes, t: Floats, y: Floats, *, columns: int, **style: Any) -> None:  # noqa: ANN401
    """Line over time with at most the points that pixels can show."""
    rows = envelope(t, y, columns)
    ax.plot(t[rows], y[rows], **style)


def band(ax: Axes, t: Floats, half_width: Floats, token_color: str, *, columns: int) -> None:
    """Area of +- half_width around zero with a thin edge."""
    rows = envelope(t, half_width, columns)
    t, w = t[rows], half_width[rows]
    ax.fill_between(t, -w, w, color=token_color, alpha=0.16, linewidth=0, zorder=1.5)
    for sign in (-1.0, 1.0):
        ax.plot(t, sign * w, color=token_color, alpha=0.55, linewidth=0.8, zorder=1.6)


def dots(ax: Axes, x: Floats, y: Floats, shade: str, size: float, **style: Any) -> None:  # noqa: ANN401
    """Round dots without edge as one path: a tenth of the text that as many markers take."""
    # Not quite zero in length: matplotlib leaves out strokes that are.
    low, high = ax.get_xlim()
    strokes(ax, x, y, x + 2e-5 * (high - low), y, shade, size, capstyle='round', **style)


def strokes(
    ax: Axes,
    x0: Floats,
    y0: Floats,
    x1: Floats,
    y1: Floats,
    shade: str,
    width: float,
    **style: Any,  # noqa: ANN401 - of a patch
) -> None:
    """Straight strokes from (x0, y0) to (x1, y1) as one path."""
    if len(x0) == 0:
        return
    vertices = np.stack([np.column_stack([x0, y0]), np.column_stack([x1, y1])], axis=1)
    codes = np.tile([Path.MOVETO, Path.LINETO], len(x0))
    path = Path(vertices.reshape(-1, 2), codes)
    # add_artist: limits of the axes are set by the caller.
    ax.add_artist(PathPatch(path, fill=False, edgecolor=shade, linewidth=width, **style))


def symmetric_limit(error: Floats, half_width: Floats, settle: float = 0.08) -> float:
    """Half height of an axis that shows error and band after the start values have worn off.

    The first `settle` of the samples may leave the figure (`outside` states it then); later ones
    do not.
    """
    start = int(len(error) * settle)
    e, w = np.abs(error[start:]), half_width[start:]
    e, w = e[np.isfinite(e)], w[np.isfinite(w)]
    if e.size == 0:
        return 1.0
    limit = float(e.max())
    if w.size:
        limit = max(limit, min(float(np.quantile(w, 0.98)), 25.0 * limit))
    return 1.12 * limit if limit > 0.0 else 1.0


def outside(error: Floats, limit: float, unit: str) -> str:
    """Text of the largest error outside of the axis; empty if the axis shows all."""
    finite = np.abs(error[np.isfinite(error)])
    if finite.size and finite.max() > limit:
        return f'start up to {finite.max():.3g} {unit}'
    return ''


def row_heading(ax: Axes, left: str, right: str) -> None:
    """Name of a small plot and a remark, on one line above."""
    low: dict[str, Any] = {'transform': ax.transAxes, 'va': 'bottom', 'fontsize': 11.5}
    ax.text(0.0, 1.025, left, color=color('ink'), ha='left', **low)
    ax.text(1.0, 1.025, right, color=color('muted'), ha='right', **low)


def shade_second_half(ax: Axes, clock: Clock) -> None:
    """Tint the second half of the run, as used by the scores."""
    low, high = clock.span
    ax.axvspan(0.5 * (low + high), high, color=color('muted'), alpha=0.07, linewidth=0, zorder=0)
