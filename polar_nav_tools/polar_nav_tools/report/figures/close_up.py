"""Figure of one instant near the end: truth, estimates, place of the last fix's validity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from polar_nav_core.grid import ecef_to_grid

from ...scoring import Comparison, Score
from ...scoring.tables import show
from ...scoring.timeliness import TimedFix, timed_fixes
from ...scoring.verdicts import FUSED
from ...series.vehicle import ReceiptRecord, TruthSeries
from ..input import FixPositions, ReportInput
from ..style import color, drawing, new_figure, run_color, verdict_look
from ..svg import to_svg
from .base import Picture
from .chart import round_length

Floats = NDArray[np.float64]

_ASPECT = 2.3
_NEAR = 0.1
"""Share of the picture's width within which names would stand on one another."""
_AXES_PX = 1000.0
"""Width of the picture, about."""
_MEMORY_NS = 300_000_000_000  # of the drawn ways and fixes [ns]


@dataclass(frozen=True, eq=False)
class _Belief:
    """One run at the instant, in grid axes around the true position [m]."""

    name: str
    color: str
    at: Floats  # shape (2,)
    trail: Floats  # shape (n, 2)
    covariance: Floats  # horizontal, shape (2, 2)

    @property
    def distance(self) -> float:
        return float(np.hypot(*self.at))


def close_up(data: ReportInput, scores: Comparison) -> Picture:
    """Truth and estimates at the time when the last fix was fused, with 3-sigma ellipses."""
    truth, receipts = _reference(data, scores)
    now_ns, last = _instant(scores, receipts)
    row = int(np.argmin(np.abs(truth.stamp_ns - now_ns)))
    origin_e = truth.r_e[row]
    C_e_G = ecef_to_grid(origin_e)[:2]

    def local(r_e: Floats) -> Floats:
        return np.asarray((r_e - origin_e) @ C_e_G.T)

    found = [
        _belief(name, run_color(i), score, now_ns, local)
        for i, (name, score) in enumerate(scores.scores.items())
    ]
    beliefs = [b for b in found if b is not None]
    recent = (truth.stamp_ns >= now_ns - _MEMORY_NS) & (truth.stamp_ns <= now_ns + _MEMORY_NS // 5)
    way, way_ns = local(truth.r_e[recent]), truth.stamp_ns[recent]
    valid_at = None
    if last is not None:
        valid_at = way[np.argmin(np.abs(way_ns - last.validity_ns))]
    low, high = _window(beliefs, valid_at)
    v_G = truth.v_G[row, :2]
    speed = float(np.hypot(*v_G))
    ahead = v_G / speed if speed > 0.05 else np.zeros(2)
    distances = '; '.join(f'{b.name} {show(b.distance, 2)} m' for b in beliefs)
    alt = f'Close-up around the true position at one instant. Estimates are off by: {distances}.'
    with drawing('close-up'):
        fig = new_figure(1080, 490)
        ax = fig.add_subplot()
        ax.set_aspect('equal')
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        ax.set_xlabel('grid east of the true position [m]')
        ax.set_ylabel('grid north [m]')
        step = round_length((high[0] - low[0]) / 7.0)
        ax.xaxis.set_major_locator(MultipleLocator(step))
        ax.yaxis.set_major_locator(MultipleLocator(step))
        past = way_ns <= now_ns
        ax.plot(*way[past].T, color=color('ink'), lw=5.0, alpha=0.25, zorder=2)
        ax.plot(*way[~past].T, color=color('ink'), lw=1.2, ls=(0, (1, 3)), alpha=0.7, zorder=2)
        tips = _draw_fixes(ax, data.fixes, receipts, local, now_ns, low, high)
        size = float(high[0] - low[0])
        if last is not None and valid_at is not None:
            by_truth = float(np.hypot(*valid_at)) < _NEAR * size
            _draw_validity(ax, last, valid_at, (64.0 if by_truth else 28.0) * _left_of(ahead))
        offsets = _belief_offsets(beliefs, ahead, size)
        for belief, offset in zip(beliefs, offsets, strict=True):
            _draw_belief(ax, belief, size, offset)
        _draw_truth(ax, ahead)
        svg = to_svg(fig, 'close-up', alt, tips)
    return Picture(
        key='close-up',
        title='Close-up: one instant, several beliefs',
        caption=(
            'The instant at which the last fix was fused. A tie joins each estimate with the '
            'truth of the same instant; the ellipse is that filter’s own 3-sigma region. A filter '
            'that fuses a late fix as current is drawn back to the position at the validity of '
            'the fix, and its ellipse does not cover that. '
            f'Distance from the truth: {distances}.'
        ),
        alt=alt,
        svg=svg,
    )


def _reference(
    data: ReportInput, scores: Comparison
) -> tuple[TruthSeries, Sequence[ReceiptRecord]]:
    """Truth and receipts of the last run to which fixes came late; else of the last one.

    To a smoother each fix comes when it is valid.
    """
    names = list(reversed(scores.scores))
    late = (n for n in names if any(f.delay > 0.0 for f in timed_fixes(data.runs[n][2], (FUSED,))))
    truth, _, receipts = data.runs[next(late, names[0])]
    return truth, receipts


def _instant(scores: Comparison, receipts: Sequence[ReceiptRecord]) -> tuple[int, TimedFix | None]:
    """Last time with estimates of every run that has any, and the last fix fused by then."""
    spoke = [
        int(s.errors.stamp_ns[np.isfinite(s.errors.horizontal)][-1])
        for s in scores.scores.values()
        if np.isfinite(s.errors.horizontal).any()
    ]
    silent_ns = int(next(iter(scores.scores.values())).errors.stamp_ns[-1])
    end_ns = min(spoke, default=silent_ns)
    used = [f for f in timed_fixes(receipts, (FUSED,)) if f.receive_ns <= end_ns]
    return (used[-1].receive_ns, used[-1]) if used else (end_ns, None)


def _belief(
    name: str, shade: str, score: Score, now_ns: int, local: Callable[[Floats], Floats]
) -> _Belief | None:
    """Estimate of a run at the instant; None without any."""
    estimate = score.pairs.estimate
    finite = np.isfinite(estimate.r_e).all(1)
    stamp_ns, r_e = estimate.stamp_ns[finite], estimate.r_e[finite]
    P = estimate.P_position_G[finite]
    if len(stamp_ns) == 0:
        return None
    # The first estimate that the fix can be in.
    row = min(int(np.searchsorted(stamp_ns, now_ns)), len(stamp_ns) - 1)
    first = min(int(np.searchsorted(stamp_ns, now_ns - _MEMORY_NS)), row)
    # Its error is that of its own stamp, up to a second after the instant of the picture: by that
    # it stands beside the truth of the instant.
    then = local(score.pairs.truth.r_e[finite][row])
    trail = local(r_e[first : row + 1]) - then
    return _Belief(name, shade, trail[-1], trail, P[row][:2, :2].copy())


def _window(beliefs: list[_Belief], valid_at: Floats | None) -> tuple[Floats, Floats]:
    """Corners that show truth, estimates with their ellipses and the place of validity."""
    points = [np.zeros(2)]
    # A diverged filter must not make all others a dot: it may leave the figure.
    reach = 12.0 * max(float(np.median([b.distance for b in beliefs] or [0.0])), 2.0)
    for b in beliefs:
        if b.distance <= reach:
            r = 3.2 * float(np.sqrt(max(np.trace(b.covariance), 0.0)))
            points += [b.at - min(r, reach), b.at + min(r, reach)]
    if valid_at is not None:
        points.append(valid_at)
    cloud = np.array([p for p in points if np.isfinite(p).all()])
    low, high = cloud.min(0), cloud.max(0)
    size = np.maximum(1.45 * (high - low), 4.0)
    height = max(size[1], size[0] / _ASPECT)
    half = 0.5 * height * np.array([_ASPECT, 1.0])
    center = 0.5 * (low + high)
    return center - half, center + half


def _draw_truth(ax: Axes, ahead: Floats) -> None:
    if ahead.any():
        ax.annotate(
            '',
            xy=(0, 0),
            xytext=tuple(44.0 * ahead),
            textcoords='offset points',
            arrowprops={
                'arrowstyle': '<|-,head_width=0.3,head_length=0.6',
                'color': color('ink'),
                'lw': 1.8,
                'shrinkA': 0,
                'shrinkB': 0,
            },
            zorder=8,
        )
    ax.plot(0, 0, ls='', marker='o', ms=11, mfc=color('ink'), mec=color('card'), mew=1.8, zorder=9)
    _tag(ax, np.zeros(2), 'truth', color('ink'), 21.0 * _left_of(ahead))


def _draw_belief(ax: Axes, belief: _Belief, size: float, offset: Floats) -> None:
    """Way, tie to the truth, 3-sigma ellipse and name of one run."""
    keep = np.abs(belief.trail).max(1) < 3.0 * size
    ax.plot(*belief.trail[keep].T, color=belief.color, lw=1.6, alpha=0.9, zorder=4)
    ax.plot(
        [0, belief.at[0]], [0, belief.at[1]], color=belief.color, lw=1.2, ls=(0, (4, 2)), zorder=5
    )
    if np.isfinite(belief.covariance).all():
        values, vectors = np.linalg.eigh(belief.covariance)
        axes = 6.0 * np.sqrt(np.maximum(values, 0.0))  # full lengths of 3 sigma
        angle = float(np.rad2deg(np.arctan2(vectors[1, 1], vectors[0, 1])))
        x, y = (float(c) for c in belief.at)
        shape = {'width': axes[1], 'height': axes[0], 'angle': angle}
        ax.add_patch(Ellipse((x, y), **shape, fc=belief.color, alpha=0.15, lw=0, zorder=3))
        ax.add_patch(Ellipse((x, y), **shape, fc='none', ec=belief.color, lw=1.3, zorder=5))
    ax.plot(
        *belief.at,
        ls='',
        marker='o',
        ms=9,
        mfc=belief.color,
        mec=color('card'),
        mew=1.6,
        zorder=10,
    )
    _tag(ax, belief.at, f'{belief.name}, {show(belief.distance, 2)} m off', belief.color, offset)


def _belief_offsets(beliefs: list[_Belief], ahead: Floats, size: float) -> list[Floats]:
    """Where names stand [px]: right of the motion, further out for each one near the same spot."""
    out = -_left_of(ahead)
    per_metre = _AXES_PX / size
    offsets: list[Floats] = []
    for k, b in enumerate(beliefs):
        near = [o for o in beliefs if float(np.hypot(*(b.at - o.at))) < _NEAR * size]
        largest = max(float(np.nan_to_num(o.covariance).max()) for o in near)
        clear = min(12.0 + 3.0 * float(np.sqrt(max(largest, 0.0))) * per_metre, 90.0)
        before = sum(o in near for o in beliefs[:k])
        # Names of one spot stand above one another, whatever their points do.
        offset = out * clear + (near[0].at - b.at) * per_metre
        offsets.append(offset + np.array([0.0, np.sign(out[1]) * 18.0 * before]))
    return offsets


def _draw_validity(ax: Axes, last: TimedFix, at: Floats, offset: Floats) -> None:
    ax.plot(*at, ls='', marker='D', ms=10, mfc='none', mec=color('fix'), mew=2.2, zorder=8)
    text = f'fix {last.receipt.sequence} was valid here,\n{last.delay:.1f} s before it arrived'
    _tag(ax, at, text, color('fix'), offset)


def _left_of(ahead: Floats) -> Floats:
    """Unit vector to the left of the motion; up where there is none."""
    return np.array([-ahead[1], ahead[0]]) if ahead.any() else np.array([0.0, 1.0])


def _draw_fixes(
    ax: Axes,
    fixes: FixPositions | None,
    receipts: Sequence[ReceiptRecord],
    local: Callable[[Floats], Floats],
    now_ns: int,
    low: Floats,
    high: Floats,
) -> dict[str, list[str]]:
    """Measured fixes in the window, shaped by verdict, with a tooltip each."""
    if fixes is None:
        return {}
    verdicts = {
        r.sequence: r
        for r in receipts
        if r.source == fixes.source and r.verdict_text != 'DUPLICATE'
    }
    recent = (fixes.stamp_ns <= now_ns) & (fixes.stamp_ns >= now_ns - _MEMORY_NS)
    xy = local(fixes.r_e)
    inside = recent & ((xy > low) & (xy < high)).all(1)
    tips: dict[str, list[str]] = {}
    for row in np.flatnonzero(inside):
        receipt = verdicts.get(int(fixes.sequence[row]))
        if receipt is None:
            continue
        look = verdict_look(receipt.verdict_text)
        key = f'close-{receipt.sequence}'
        shade = color('fix') if receipt.verdict_text == 'FUSED' else color(look.token)
        ax.plot(
            *xy[row],
            ls='',
            marker=look.marker,
            ms=6.5,
            mfc=shade if look.filled else 'none',
            mec=color('card') if look.filled else shade,
            mew=0.8,
            zorder=7,
            gid=f'tips:{key}',
        )
        tips[key] = [f'fix {receipt.sequence}: {receipt.verdict_text}, {receipt.age_s:.2f} s old']
    return tips


def _tag(ax: Axes, at: Floats, text: str, shade: str, offset: Floats) -> None:
    """Bold text beside a place, on the side that `offset` points to [px]."""
    side = 'left' if offset[0] > 4.0 else 'right' if offset[0] < -4.0 else 'center'
    ax.annotate(
        text,
        (float(at[0]), float(at[1])),
        xytext=tuple(offset),
        textcoords='offset points',
        color=shade,
        fontsize=12.5,
        fontweight='bold',
        ha=side,
        va='center',
        gid='class:halo-card',
        zorder=12,
    )
