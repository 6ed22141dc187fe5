"""The picture of one fix: the way of its packet, and error and sigma around its use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polar_nav_core.errors import ConfigError

from ..report.style import color, drawing, verdict_look
from .story import Story
from .words import headline

SUFFIXES = ('.png', '.svg')
_LEG_COLOURS = {'bits': 'late', 'transmission': 'late', 'processing': 'leader'}
_WATER = ('reply to the array', 'packet to follower', 'ping to transponder')


def write_figure(path: Path, story: Story) -> None:
    """Write the picture as PNG or SVG.

    Raises
    ------
    ConfigError
        For another file extension.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f'{path}: a picture is written as {" or ".join(SUFFIXES)}')
    with drawing(f'why-{story.sequence}'):
        fig = Figure(figsize=(9.0, 6.0), layout='constrained', facecolor=color('card'))
        top, bottom = fig.subplots(2, 1, height_ratios=[1.0, 1.2])
        _way(top, story)
        _around(bottom, story)
        fig.suptitle(headline(story), x=0.01, ha='left', fontsize=11)
        path.parent.mkdir(parents=True, exist_ok=True)
        dated = {'Date': None} if path.suffix.lower() == '.svg' else {}
        fig.savefig(path, dpi=144, metadata=dated)


def _way(ax: Axes, s: Story) -> None:
    zero = s.zero_ns
    for k, leg in enumerate(s.legs):
        token = 'run1' if leg.name in _WATER else _LEG_COLOURS.get(leg.name, 'aside')
        start = (leg.start_ns - zero) * 1e-9
        ax.barh(k, leg.seconds, left=start, color=color(token), alpha=1.0 if leg.counted else 0.4)
        ax.annotate(
            f'{leg.seconds:.3f} s',
            (start + leg.seconds, k),
            xytext=(4, 0),
            textcoords='offset points',
            va='center',
            fontsize=9,
        )
    ax.set_yticks(range(len(s.legs)), [leg.name for leg in s.legs])
    ax.invert_yaxis()
    ax.grid(visible=False, axis='y')
    ax.margins(x=0.12)
    ax.set_xlabel('time of the run [s]')
    ax.set_title('The way of the packet')


def _around(ax: Axes, s: Story) -> None:
    a = s.around
    t = (a.stamp_ns - s.zero_ns) * 1e-9
    if len(t):
        ax.fill_between(t, 0.0, 3.0 * a.sigma, color=color('run1'), alpha=0.15, lw=0)
        ax.plot(t, a.sigma, color=color('run1'), label='sigma, 2-D (band: 3 sigma)')
    if a.error.size:
        ax.plot(t, a.error, color=color('run0'), label='true error, 2-D')
    for k, stamp_ns in enumerate(a.received_ns):
        label = 'other fixes used' if k == 0 else None
        ax.axvline((int(stamp_ns) - s.zero_ns) * 1e-9, color=color('fix'), lw=1.0, label=label)
    if s.validity_ns is not None:
        at = (s.validity_ns - s.zero_ns) * 1e-9
        ax.axvline(at, color=color('ink'), lw=1.0, ls=(0, (4, 3)), label='valid (t3)')
    for copy in s.copies:
        look = verdict_look(copy.verdict)
        at = (copy.packet.receive_ns - s.zero_ns) * 1e-9
        ax.axvline(at, color=color(look.token), lw=1.8, label=f'received: {copy.verdict}')
    shown = np.r_[3.0 * a.sigma, a.error] if len(t) else np.ones(1)
    shown = shown[np.isfinite(shown)]
    ax.set_ylim(0.0, 1.05 * float(shown.max()) if shown.size and shown.max() > 0.0 else 1.0)
    ax.set_xlabel('time of the run [s]')
    ax.set_ylabel('position [m]')
    ax.set_title(f'Position of {s.vehicle} around it ({s.configuration})')
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc='upper right')
