"""Figure of consistency: NEES of position and NIS of every source, with chi-square bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from polar_nav_core.engine.outputs import LOCAL_DOF, NIS_SUM, UPDATES

from ...scoring import Score, chi_square_band, normalized_squared
from ...scoring.verdicts import FUSED
from ...series.vehicle import EstimateSeries, ReceiptRecord, last_revisions
from ..style import HALF_PX, color, drawing, new_figure, run_color
from ..svg import to_svg
from .base import Clock, Picture, line, row_heading

Floats = NDArray[np.float64]

_BINS = 40
_COLUMNS = 440
_FLOOR = 1.0 / 30.0  # smaller values are chance and may leave the picture


@dataclass(frozen=True)
class Bins:
    """Means of normalized squares per degree of freedom, over equal parts of the run.

    Attributes
    ----------
    edges : ndarray, shape (n + 1,)
        Mission time.
    mean, low, high : ndarray, shape (n,)
        Mean and the band that 95 % of an honest filter's means lie in; NaN in empty parts.
    """

    edges: Floats
    mean: Floats
    low: Floats
    high: Floats

    @property
    def share_inside(self) -> float:
        """Share of the parts, of those that are not empty; NaN if all are."""
        known = np.isfinite(self.mean)
        inside = (self.mean >= self.low) & (self.mean <= self.high)
        return float(np.mean(inside[known])) if known.any() else float('nan')


def binned(t: Floats, sums: Floats, dof: Floats, span: tuple[float, float]) -> Bins:
    """Sums of NIS at times `t` with the degrees of freedom that stand in each, in equal parts."""
    edges = np.linspace(*span, _BINS + 1)
    total, _ = np.histogram(t, edges, weights=sums)
    k, _ = np.histogram(t, edges, weights=dof)
    some = k > 0.0
    mean, low, high = (np.full(_BINS, np.nan) for _ in range(3))
    mean[some] = total[some] / k[some]
    low[some], high[some] = (b / k[some] for b in chi_square_band(k[some]))
    return Bins(edges, mean, low, high)


def honesty(
    score: Score,
    index: int,
    estimate: EstimateSeries,
    receipts: Sequence[ReceiptRecord],
    clock: Clock,
) -> Picture:
    """Figure of the NEES of position over time, and mean NIS of fixes, DVL and depth."""
    key = f'honesty-{index}'
    fused = [
        r
        for r in last_revisions(receipts)
        if r.verdict_text == FUSED and r.receive_ns is not None and np.isfinite(r.nis)
    ]
    rows = {
        'NIS of fixes': binned(
            clock(np.array([r.receive_ns for r in fused], dtype=np.int64)),
            np.array([r.nis for r in fused]),
            np.array([float(r.degrees_of_freedom) for r in fused]),
            clock.span,
        )
    }
    local = estimate.local_statistics
    for row, (source, dof) in enumerate(LOCAL_DOF.items()):
        name = {'dvl': 'DVL'}.get(source, source)
        if source == 'dvl' and np.isnan(estimate.dvl_scale_m).all():
            continue  # the filter has no errors of a DVL: there is none on board
        rows[f'NIS of {name}'] = binned(
            clock(estimate.stamp_ns),
            local[:, row, NIS_SUM],
            dof * local[:, row, UPDATES],
            clock.span,
        )
    nees = normalized_squared(score.errors.dr_G, score.errors.P_position_G) / 3.0
    words = ', '.join(
        f'{name} {100 * b.share_inside:.0f} %'
        for name, b in rows.items()
        if np.isfinite(b.share_inside)
    )
    alt = (
        f'Consistency of {score.name}. Parts of the run inside their 95 % band: {words or "none"}.'
    )
    shade = run_color(index)
    with drawing(key):
        fig = new_figure(HALF_PX, 66 + 112 * (1 + len(rows)))
        axes = fig.subplots(1 + len(rows), 1, sharex=True)
        _nees(axes[0], clock(score.errors.stamp_ns), nees, shade)
        for ax, (name, bins) in zip(axes[1:], rows.items(), strict=True):
            _bars(ax, name, bins, shade)
        for ax in axes:
            clock.axis(ax, label=ax is axes[-1])
        fig.suptitle(score.name, x=0.008, ha='left', fontsize=13, fontweight='bold', color=shade)
        svg = to_svg(fig, key, alt)
    return Picture(
        key=key,
        title='Is the covariance honest?',
        caption=(
            'Squared errors over what the filter claims, per degree of freedom: 1 is honest, more '
            'is too sure of itself. Top: position against truth, every estimate, with the band of '
            'a single one. Below: means over a fortieth of the run of the innovations of each '
            'source, of measurements that were used, with the 95 % band of such a mean.'
        ),
        alt=alt,
        svg=svg,
        width='half',
    )


def _nees(ax: Axes, t: Floats, nees: Floats, shade: str) -> None:
    low, high = (float(b) / 3.0 for b in chi_square_band(3.0))
    ax.axhspan(low, high, color=color('fused'), alpha=0.13, lw=0, zorder=1)
    known = np.isfinite(nees)
    share = float(np.mean((nees[known] >= low) & (nees[known] <= high))) if known.any() else np.nan
    line(ax, t, nees, columns=_COLUMNS, color=shade, lw=1.0, zorder=3)
    _finish(ax, np.r_[nees[known], high, low])
    row_heading(ax, 'NEES of position', f'{100 * share:.0f} % inside' if known.any() else 'none')


def _bars(ax: Axes, name: str, bins: Bins, shade: str) -> None:
    known = np.isfinite(bins.mean)
    if not known.any():
        row_heading(ax, name, 'none')
        _finish(ax, np.ones(1))
        return
    low, high = np.r_[bins.low, bins.low[-1]], np.r_[bins.high, bins.high[-1]]
    ax.fill_between(
        bins.edges, low, high, step='post', color=color('fused'), alpha=0.13, lw=0, zorder=1
    )
    middle = 0.5 * (bins.edges[1:] + bins.edges[:-1])
    ax.plot(
        middle[known], bins.mean[known], color=shade, lw=1.0, marker='o', ms=3.2, mew=0, zorder=3
    )
    _finish(ax, np.r_[bins.mean[known], bins.high[known], bins.low[known]])
    row_heading(ax, name, f'{100 * bins.share_inside:.0f} % inside')


def _finish(ax: Axes, values: Floats) -> None:
    """Logarithmic axis over the values, but not down to every small chance value."""
    ax.set_yscale('log')
    positive = values[np.isfinite(values) & (values > 0.0)]
    low = max(float(positive.min()), _FLOOR) if positive.size else 0.1
    high = float(positive.max()) if positive.size else 10.0
    ax.set_ylim(0.7 * min(low, 0.5), 1.4 * max(high, 2.0))
    ax.axhline(1.0, color=color('muted'), lw=0.8, ls=(0, (5, 3)), zorder=1.4)
    ax.yaxis.set_major_formatter(lambda value, _: f'{value:g}')
    ax.minorticks_off()
