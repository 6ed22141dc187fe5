"""Figures of all fixes: ages, verdicts, innovations and NIS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ...scoring import Score, chi_square_band
from ...scoring.timeliness import TimedFix, timed_fixes
from ...scoring.verdicts import in_order
from ...series.vehicle import ReceiptRecord, last_revisions
from ..decimate import distinct, envelope
from ..input import ReportInput, SentPackets
from ..style import HALF_PX, color, drawing, new_figure, run_color, verdict_look
from ..svg import to_svg
from .base import Clock, Picture, dots, row_heading, strokes

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MOST_TIPS = 800  # markers with a tooltip of their own; beyond, a page gets heavy


def fix_delays(
    data: ReportInput, name: str, receipts: Sequence[ReceiptRecord], clock: Clock
) -> Picture:
    """Figure of the age of each fix at transmission and reception, over its validity."""
    final = [r for r in last_revisions(receipts) if r.receive_ns is not None]
    timed = timed_fixes(receipts)
    unread = [r for r in final if r.validity_ns is None]
    lost = _lost(data.sent, final)
    ages = np.array([f.delay for f in timed])
    mean = float(ages.mean()) if ages.size else float('nan')
    alt = (
        f'Delay of {len(timed)} fixes: mean {mean:.2f} s'
        + (f', from {ages.min():.2f} to {ages.max():.2f} s' if ages.size else '')
        + f'; {len(lost)} packets never arrived, {len(unread)} could not be read.'
    )
    tips: dict[str, list[str]] = {}
    with drawing('fix-delays'):
        fig = new_figure(1080, 380)
        ax, side = fig.subplots(1, 2, sharey=True, width_ratios=[5.2, 1.0])
        clock.axis(ax)
        _stems(ax, timed, clock)
        shown = in_order({f.receipt.verdict_text for f in timed})
        for verdict in shown:
            some = [f for f in timed if f.receipt.verdict_text == verdict]
            x = clock(np.array([f.validity_ns for f in some]))
            y = np.array([f.delay for f in some])
            texts = [_tip(f.receipt) for f in some]
            _marks(ax, x, y, verdict, 30, tips, f'delay-{verdict}', texts)
        top = 1.14 * float(ages.max(initial=0.0)) or 1.0
        floor = _bottom_lane(ax, clock, lost, unread, top, tips)
        if ages.size:
            for one in (ax, side):
                one.axhline(mean, color=color('ink'), lw=1.1, ls=(0, (5, 3)), zorder=5)
            side.hist(
                ages,
                bins=np.linspace(0.0, top, 29),
                orientation='horizontal',
                color=color('fused'),
                alpha=0.55,
                lw=0,
            )
            side.text(
                0.97,
                mean,
                f'mean {mean:.2f} s',
                transform=side.get_yaxis_transform(),
                ha='right',
                va='bottom',
                fontsize=11,
                gid='class:halo-card',
            )
        ax.set_ylim(floor, top)
        ax.set_ylabel('time since validity [s]')
        ax.set_xlabel(f'validity, mission time [{clock.unit}]')
        side.set_xlabel('fixes')
        side.tick_params(left=False)
        _delay_legend(fig, shown, len(lost) > 0, [r.verdict_text for r in unread])
        svg = to_svg(fig, 'fix-delays', alt, tips)
    return Picture(
        key='fix-delays',
        title='Delay of each fix',
        caption=(
            'Each stem stands at the time the fix was valid and rises to its age: the pale '
            'part until the packet was transmitted, the dark part until it was received. '
            'Mark and colour state the verdict '
            f'({name}); point at one for its numbers. Horizontal: all ages counted.'
        ),
        alt=alt,
        svg=svg,
    )


def fix_story(
    score: Score, index: int, receipts: Sequence[ReceiptRecord], clock: Clock
) -> Picture:
    """Figure of the receipts of one run: verdict lanes, innovations and NIS with their bands."""
    final = [r for r in last_revisions(receipts) if r.receive_ns is not None]
    counts = score.verdicts.by_verdict
    words = ', '.join(f'{n} {v}' for v, n in counts.items())
    key = f'fix-story-{index}'
    alt = f'Receipts of {score.name} over time: {words}; innovations and NIS of each fix.'
    tips: dict[str, list[str]] = {}
    lanes = list(counts) or ['none']
    with drawing(key):
        lane_px = 34 + 21 * len(lanes)
        fig = new_figure(HALF_PX, lane_px + 480)
        axes = fig.subplots(4, 1, sharex=True, height_ratios=[lane_px, 125, 125, 150])
        clock.axis(axes[3])
        _lanes(axes[0], final, lanes, counts, clock, tips)
        judged = [r for r in final if np.isfinite(r.innovation_G).all()]
        for k, axis in enumerate(('east', 'north')):
            _innovation(
                axes[1 + k], judged, k, clock, run_color(index), f'innovation, grid {axis} [m]'
            )
        _nis(axes[3], judged, clock, tips)
        axes[3].set_xlabel(f'reception, mission time [{clock.unit}]')
        fig.suptitle(
            score.name, x=0.008, ha='left', fontsize=13, fontweight='bold', color=run_color(index)
        )
        svg = to_svg(fig, key, alt, tips)
    return Picture(
        key=key,
        title='What became of each fix',
        caption=(
            'From the top: every receipt in the lane of its verdict; measured minus predicted '
            'position with ±3 sigma of the innovation; NIS with the band that 95 % of an honest '
            'filter’s fixes fall in, and the gate (dotted).'
        ),
        alt=alt,
        svg=svg,
        width='half',
    )


def _stems(ax: Axes, timed: Sequence[TimedFix], clock: Clock) -> None:
    if len(timed) > _MOST_TIPS:
        # One in a pixel column: the oldest, in front of which the others would not be seen.
        by_age = sorted(timed, key=lambda f: -f.delay)
        x = clock(np.array([f.validity_ns for f in by_age]))
        timed = [by_age[k] for k in distinct(x, np.zeros(len(x)), 820, 1)]
    x = clock(np.array([f.validity_ns for f in timed], dtype=np.int64))
    ages = np.array([f.delay for f in timed])
    sent_ns = [f.receipt.transmit_ns or f.validity_ns for f in timed]
    sent = np.array([s - f.validity_ns for s, f in zip(sent_ns, timed, strict=True)]) * 1e-9
    width = float(np.clip(450.0 / max(len(timed), 1), 0.4, 2.0))
    zero = np.zeros(len(x))
    strokes(ax, x, zero, x, sent, color('aside'), width, alpha=0.35, capstyle='butt', zorder=2)
    strokes(ax, x, sent, x, ages, color('aside'), width, alpha=0.7, capstyle='butt', zorder=2)


def _bottom_lane(
    ax: Axes,
    clock: Clock,
    lost: Ints,
    unread: Sequence[ReceiptRecord],
    top: float,
    tips: dict[str, list[str]],
) -> float:
    """Packets without a known validity, below zero at transmission; lower end of the axis."""
    if not len(lost) and not unread:
        return 0.0
    y = -0.07 * top
    if len(lost):
        x = clock(lost)
        x = x[(x >= ax.get_xlim()[0]) & (x <= ax.get_xlim()[1])]
        ax.plot(
            x,
            np.full(len(x), y),
            ls='',
            marker='x',
            ms=5.5,
            mew=1.3,
            color=color('aside'),
            zorder=4,
            clip_on=False,
        )
    for verdict in sorted({r.verdict_text for r in unread}):
        some = [r for r in unread if r.verdict_text == verdict]
        x = clock(np.array([r.transmit_ns or r.receive_ns for r in some]))
        _marks(
            ax,
            x,
            np.full(len(x), y),
            verdict,
            30,
            tips,
            f'unread-{verdict}',
            [_tip(r) for r in some],
        )
    return -0.13 * top


def _delay_legend(fig: Figure, verdicts: Sequence[str], lost: bool, unread: Sequence[str]) -> None:
    entries = [
        Line2D([], [], color=color('aside'), lw=3, alpha=0.35, label='until transmitted'),
        Line2D([], [], color=color('aside'), lw=3, alpha=0.9, label='under way'),
    ]
    names = in_order({*verdicts, *unread})
    for verdict in names:
        look = verdict_look(verdict)
        entries.append(
            Line2D(
                [],
                [],
                ls='',
                marker=look.marker,
                ms=7,
                mfc=color(look.token) if look.filled else 'none',
                mec=color(look.token),
                label=verdict,
            )
        )
    if lost:
        entries.append(
            Line2D([], [], ls='', marker='x', ms=6, color=color('aside'), label='never arrived')
        )
    fig.legend(
        handles=entries,
        loc='outside upper left',
        ncols=len(entries),
        handlelength=1.3,
        columnspacing=1.5,
        handletextpad=0.5,
    )


def _lanes(
    ax: Axes,
    final: Sequence[ReceiptRecord],
    lanes: Sequence[str],
    counts: dict[str, int],
    clock: Clock,
    tips: dict[str, list[str]],
) -> None:
    for k, verdict in enumerate(lanes):
        some = [r for r in final if r.verdict_text == verdict]
        x = clock(np.array([r.receive_ns for r in some], dtype=np.int64))
        texts = [_tip(r) for r in some]
        _marks(ax, x, np.full(len(x), float(k)), verdict, 26, tips, f'lane-{verdict}', texts)
    ax.set_yticks(range(len(lanes)), [f'{v}  {counts.get(v, 0)}' for v in lanes])
    ax.set_ylim(len(lanes) - 0.4, -0.6)
    ax.grid(visible=False, axis='x')
    ax.tick_params(left=False)
    ax.spines['left'].set_visible(False)


def _innovation(
    ax: Axes, judged: Sequence[ReceiptRecord], axis: int, clock: Clock, shade: str, name: str
) -> None:
    ax.axhline(0.0, color=color('muted'), lw=0.8, zorder=1.4)
    if not judged:
        row_heading(ax, name, 'none')
        return
    x = clock(np.array([r.receive_ns for r in judged]))
    r = np.array([j.innovation_G[axis] for j in judged])
    width = 3.0 * np.sqrt(np.array([j.innovation_variance_G[axis] for j in judged]))
    fused = np.array([j.verdict_text == 'FUSED' for j in judged])
    rows = envelope(x, width, 440)
    area: dict[str, Any] = {'color': shade, 'alpha': 0.16, 'lw': 0, 'zorder': 1.5, 'step': 'mid'}
    ax.fill_between(x[rows], -width[rows], width[rows], **area)
    start = len(r) // 12
    limit = 1.15 * float(
        np.nanmax(
            np.r_[np.abs(r[start:][fused[start:]]), np.nanquantile(width[start:], 0.9), 1e-6]
        )
    )
    inside = np.abs(r) <= limit
    for chosen, look in ((fused, 'FUSED'), (~fused, 'GATED')):
        style = verdict_look(look)
        mark: dict[str, Any] = {
            'ls': '',
            'ms': 4.2,
            'mew': 0,
            'color': color(style.token),
            'zorder': 3,
        }
        shown = np.flatnonzero(chosen & inside)
        if len(shown) > _MOST_TIPS:
            shown = shown[distinct(x[shown], r[shown], 420, 90)]
            dots(ax, x[shown], r[shown], color(style.token), 2.4, zorder=3)
        else:
            ax.plot(x[shown], r[shown], marker=style.marker, **mark)
        for sign, arrow in ((1.0, '^'), (-1.0, 'v')):
            beyond = chosen & ~inside & (np.sign(r) == sign)
            ax.plot(x[beyond], np.full(beyond.sum(), 0.95 * sign * limit), marker=arrow, **mark)
    ax.set_ylim(-limit, limit)
    beyond = int((~inside).sum())
    row_heading(ax, name, f'{beyond} beyond, up to {np.abs(r).max():.3g} m' if beyond else '')


def _nis(
    ax: Axes, judged: Sequence[ReceiptRecord], clock: Clock, tips: dict[str, list[str]]
) -> None:
    ax.set_yscale('log')
    known = [r for r in judged if np.isfinite(r.nis) and r.nis > 0.0 and r.degrees_of_freedom > 0]
    if not known:
        row_heading(ax, 'NIS', 'none')
        return
    each = np.array([r.degrees_of_freedom for r in known])
    dof = int(np.median(each))
    low, high = (float(v) for v in chi_square_band(dof))
    nis = np.array([r.nis for r in known])
    bottom, top = 10 ** np.floor(np.log10(min(nis.min(), low))), 3.0 * max(nis.max(), high)
    bottom = max(bottom, 1e-2)
    ax.axhspan(low, high, color=color('fused'), alpha=0.13, lw=0, zorder=1)
    gates = [r.gate for r in known if np.isfinite(r.gate)]
    if gates:
        gate = float(np.median(gates))
        ax.axhline(gate, color=color('gated'), lw=1.2, ls=(0, (1, 2)), zorder=2)
        top = max(top, 2.0 * gate)
    for verdict in ('FUSED', 'GATED'):
        some = [r for r in known if r.verdict_text == verdict]
        x = clock(np.array([r.receive_ns for r in some], dtype=np.int64))
        y = np.maximum([r.nis for r in some], bottom * 1.05)
        _marks(ax, x, y, verdict, 17, tips, f'nis-{verdict}', [_tip(r) for r in some])
    lows, highs = chi_square_band(each)  # with heights and without them: each by its own
    share = float(np.mean((nis >= lows) & (nis <= highs)))
    ax.set_ylim(bottom, top)
    ax.yaxis.set_major_formatter(lambda value, _: f'{value:g}')
    ax.minorticks_off()
    row_heading(ax, 'NIS', f'{100 * share:.0f} % in the 95 % band of χ²({dof})')


def _marks(
    ax: Axes,
    x: Floats,
    y: Floats,
    verdict: str,
    area: float,
    tips: dict[str, list[str]],
    key: str,
    texts: list[str],
) -> None:
    """Markers in the look of a verdict, with tooltips unless there are very many.

    Limits of the time axis are set before: what lies outside is left out.
    """
    low, high = ax.get_xlim()
    seen = np.flatnonzero((x >= low) & (x <= high))
    x, y, texts = x[seen], y[seen], [texts[k] for k in seen]
    if len(x) == 0:
        return
    look = verdict_look(verdict)
    if len(x) > _MOST_TIPS:
        keep = distinct(x, np.log(y) if ax.get_yscale() == 'log' else y, 420, 90)
        dots(ax, x[keep], y[keep], color(look.token), 0.6 * float(np.sqrt(area)), zorder=4)
        return
    ax.plot(
        x,
        y,
        ls='',
        marker=look.marker,
        ms=float(np.sqrt(area)),
        mfc=color(look.token) if look.filled else 'none',
        mec=color('card') if look.filled else color(look.token),
        mew=0.5 if look.filled else 1.2,
        zorder=4,
        clip_on=False,
        gid=f'tips:{key}',
    )
    tips[key] = texts


def _tip(r: ReceiptRecord) -> str:
    """Text of one receipt in a line or two."""
    parts = [f'{r.source} {r.sequence}: {r.verdict_text}']
    if np.isfinite(r.age_s):
        parts.append(f'{r.age_s:.2f} s old')
    if np.isfinite(r.nis):
        parts.append(f'NIS {r.nis:.2f}')
    return ', '.join(parts) + (f'\n{r.reason}' if r.reason else '')


def _lost(sent: SentPackets | None, final: Sequence[ReceiptRecord]) -> Ints:
    """Transmission times of packets without a receipt."""
    if sent is None:
        return np.empty(0, dtype=np.int64)
    known = {r.sequence for r in final if r.source == sent.source}
    return sent.transmit_ns[[int(s) not in known for s in sent.sequence]]
