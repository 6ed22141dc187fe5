"""Figure of the mission on a polar stereographic map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ...scoring import Comparison
from ...series.vehicle import ReceiptRecord, TruthSeries, last_revisions
from ..decimate import simplified
from ..graticule import graticule
from ..input import ReportInput
from ..projection import PolarMap
from ..style import color, drawing, new_figure, run_color
from ..svg import to_svg
from .base import Picture
from .chart import (
    draw_graticule,
    draw_pole,
    draw_scale_bar,
    frame,
    length_label,
    overview,
    window,
)

Floats = NDArray[np.float64]

_POINTS = 20_000  # points of each series before it is simplified
_STILL = 1.0  # a vehicle that keeps within this is drawn as a place [m]
_DASHED = (0, (5, 2))
_STATION: dict[str, Any] = {
    'ls': '',
    'marker': 's',
    'ms': 9,
    'mew': 1.2,
    'mfc': color('leader'),
    'mec': color('sea'),
}
_BOX = (78.0, 34.0, 668.0, 540.0)  # left, bottom, width, height of the chart [px]


def polar_map(data: ReportInput, scores: Comparison) -> Picture:
    """Figure of follower, leader, estimates and fixes at their validity, with an overview."""
    truth = next(iter(data.runs.values()))[0]
    receipts = list(data.runs.values())[-1][2]
    chart = PolarMap.around(truth.latitude)
    follower = chart.from_ecef(_thinned(truth.r_e))
    leader = None
    if data.leader is not None and len(data.leader):
        leader = chart.from_ecef(_thinned(data.leader.r_e))
    shown = follower if leader is None else np.concatenate([follower, leader])
    low, high = window(_with_pole(shown), _BOX[2] / _BOX[3])
    pixel = float(high[0] - low[0]) / _BOX[2]
    who = truth.vehicle if data.leader is None else f'{truth.vehicle} and {data.leader.vehicle}'
    alt = (
        f'Polar stereographic map: {who}, '
        f'estimates of {", ".join(scores.scores)}, and fixes at their validity. '
        f'From {_place(truth, 0)} to {_place(truth, -1)}.'
    )
    with drawing('polar-map'):
        fig = new_figure(1080, 596, free=True)
        ax = frame(fig, _BOX, low, high)
        draw_graticule(ax, graticule(chart, low, high))
        fixes = _fixes(data, receipts, truth, chart)
        if len(fixes):
            fixes = fixes[((fixes > low) & (fixes < high)).all(1)]
            ax.plot(
                *fixes[:: _every(fixes, 11.0 * pixel)].T,
                ls='',
                marker='o',
                ms=5,
                mew=0.9,
                mfc=color('fix'),
                mec=color('sea'),
                zorder=7.5,
            )
        if leader is not None and _still(leader):
            ax.plot(*leader[-1], **_STATION, zorder=8)
        elif leader is not None:
            _path(ax, leader, pixel, color=color('leader'), lw=1.8, ls=_DASHED, zorder=3)
            _ends(ax, leader, 'leader')
        _path(ax, follower, pixel, color=color('ink'), lw=4.5, alpha=0.3, zorder=3)
        for index, one in enumerate(scores.scores.values()):
            r_e = one.pairs.estimate.r_e
            xy = chart.from_ecef(_thinned(r_e[np.isfinite(r_e).all(1)]))
            _path(ax, xy, pixel, color=run_color(index), lw=1.3, zorder=5 + index)
        _ends(ax, follower, 'ink')
        draw_scale_bar(ax)
        draw_pole(ax, chart)
        overview(fig, (776.0, 296.0, 300.0, 296.0), chart, follower)
        _legend(fig, data, scores, leader, _every(fixes, 11.0 * pixel), len(fixes))
        svg = to_svg(fig, 'polar-map', alt)
    return Picture(
        key='polar-map',
        title='The mission on a polar map',
        caption=(
            'Polar stereographic, true to scale at the track, drawn so that up is grid north. '
            'Each fix lies where the follower was when it replied, not where it was when the '
            'fix arrived. At this scale all lines are nearly one; the close-up below takes them '
            'apart.'
        ),
        alt=alt,
        svg=svg,
    )


def _still(xy: Floats) -> bool:
    """Whether a vehicle did not move."""
    return float(np.hypot(*(xy.max(0) - xy.min(0)))) < _STILL


def _with_pole(points: Floats) -> Floats:
    """Map points, and the pole if it is near."""
    extent = float(np.hypot(*(points.max(0) - points.min(0))))
    near = float(np.hypot(*points.T).min()) < 0.8 * extent
    return np.concatenate([points, np.zeros((1, 2))]) if near else points


def _thinned(r_e: Floats) -> Floats:
    """At most `_POINTS` of the positions, the last one included."""
    step = max(1, len(r_e) // _POINTS)
    last = r_e[-1:] if (len(r_e) - 1) % step else r_e[:0]
    return np.concatenate([r_e[::step], last])


def _path(ax: Axes, xy: Floats, pixel: float, **style: Any) -> None:  # noqa: ANN401 - a line's
    """Draw a line without the points that no pixel would show."""
    ax.plot(*xy[simplified(xy, 0.25 * pixel)].T, **style)


def _every(points: Floats, spacing: float) -> int:
    """Step between drawn points, for about this distance between neighbours."""
    if len(points) < 3:
        return 1
    between = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
    return max(1, round(spacing / between)) if between > 0.0 else 1


def _ends(ax: Axes, xy: Floats, token: str) -> None:
    """Ring at the start, arrow head along the last bit of the way."""
    ax.plot(*xy[0], ls='', marker='o', ms=8, mfc=color('sea'), mec=color(token), mew=1.8, zorder=8)
    low, high = ax.get_xlim()
    back = np.hypot(*(xy - xy[-1]).T) > 0.012 * (high - low)
    if not back.any():
        return
    tail = xy[np.flatnonzero(back)[-1]]
    ax.annotate(
        '',
        xy[-1],
        xytext=tail,
        arrowprops={
            'arrowstyle': '-|>,head_width=0.42,head_length=0.8',
            'color': color(token),
            'lw': 0,
            'shrinkA': 0,
            'shrinkB': 0,
        },
        zorder=8,
    )


def _fixes(
    data: ReportInput, receipts: Sequence[ReceiptRecord], truth: TruthSeries, chart: PolarMap
) -> Floats:
    """Map positions of the fixes at their validity: measured if known, else the truth then."""
    if data.fixes is not None:
        good = np.isfinite(data.fixes.r_e).all(1)
        return chart.from_ecef(data.fixes.r_e[good])
    stamps = np.array(
        [r.validity_ns for r in last_revisions(receipts) if r.validity_ns is not None], np.int64
    )
    stamps = stamps[(stamps >= truth.stamp_ns[0]) & (stamps <= truth.stamp_ns[-1])]
    if stamps.size == 0:
        return np.empty((0, 2))
    rows = np.minimum(np.searchsorted(truth.stamp_ns, stamps), len(truth) - 1)
    return chart.from_ecef(truth.r_e[rows])


def _legend(
    fig: Figure,
    data: ReportInput,
    scores: Comparison,
    leader: Floats | None,
    every: int,
    fixes: int,
) -> None:
    """Draw the legend at the lower right; distances below."""
    truth = next(iter(data.runs.values()))[0]
    entries = [
        Line2D([], [], color=color('ink'), lw=4.5, alpha=0.3, label=f'{truth.vehicle}, truth')
    ]
    entries += [
        Line2D([], [], color=run_color(i), lw=1.8, label=name)
        for i, name in enumerate(scores.scores)
    ]
    if leader is not None and data.leader is not None:
        style = (
            _STATION if _still(leader) else {'color': color('leader'), 'lw': 1.8, 'ls': _DASHED}
        )
        entries.append(Line2D([], [], label=data.leader.vehicle, **style))
    if fixes:
        label = 'fix, at its validity' if data.fixes is not None else 'validity of a fix'
        label += f' (1 in {every})' if every > 1 else ''
        entries.append(
            Line2D([], [], ls='', marker='o', ms=6, mew=0, color=color('fix'), label=label)
        )
    entries.append(
        Line2D(
            [], [], ls='', marker='o', ms=7, mfc='none', mec=color('ink'), mew=1.5, label='start'
        )
    )
    legend = fig.legend(
        handles=entries,
        loc='upper left',
        bbox_to_anchor=(782 / 1080, 284 / 596),
        fontsize=12.5,
        handlelength=1.9,
        labelspacing=0.55,
        borderaxespad=0,
    )
    for text in legend.get_texts():
        text.set_color(color('ink'))
    way = float(np.linalg.norm(np.diff(_thinned(truth.r_e), axis=0), axis=1).sum())
    lines = [
        f'{length_label(way)} travelled',
        f'from {_place(truth, 0)}',
        f'to {_place(truth, -1)}',
    ]
    fig.text(
        786 / 1080, 34 / 596, '\n'.join(lines), fontsize=11.5, color=color('muted'), va='bottom'
    )


def _place(truth: TruthSeries, row: int) -> str:
    """Latitude and longitude of one truth sample, to a thousandth of a minute of arc at most."""
    return f'{_minutes(truth.latitude[row], "NS")} {_minutes(truth.longitude[row], "EW")}'


def _minutes(angle: float, letters: str) -> str:
    thousandths = round(abs(float(np.rad2deg(angle))) * 60_000.0)
    degrees, rest = divmod(thousandths, 60_000)
    return f'{degrees}°{rest / 1000.0:06.3f}′{letters[0] if angle >= 0 else letters[1]}'
