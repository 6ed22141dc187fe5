"""Colours and type of the report, once for light and once for dark.

Figures are drawn in the light colours; on the way into the page every one of them becomes a CSS
variable of the same name (`svg.themed`), so that one picture serves both schemes. Each light
colour is therefore used for one token only. Hues follow Okabe and Ito's set, darkened on paper and
lightened at night until lines have a contrast of at least 3:1; shape or position always has the
same meaning as colour.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

# token: (light, dark)
TOKENS: dict[str, tuple[str, str]] = {
    'page': ('#f6f7f9', '#0f151c'),
    'card': ('#ffffff', '#171f28'),
    'sea': ('#eaf1f6', '#121b24'),
    'ink': ('#18232e', '#e9eef3'),
    'muted': ('#566473', '#a4b2c0'),
    'rule': ('#d5dce3', '#2e3a47'),
    'graticule': ('#b9c8d4', '#34485a'),
    'run0': ('#c9510c', '#ff9a5c'),
    'run1': ('#0b6fae', '#66b9f1'),
    'run2': ('#078a66', '#41cfa6'),
    'run3': ('#a8458a', '#e89bcd'),
    'run4': ('#7d6608', '#dcc04a'),
    'leader': ('#6b53a8', '#b7a5ea'),
    'fused': ('#0a8761', '#3fd0a5'),
    'gated': ('#c4570f', '#ff9d60'),
    'damaged': ('#b02a4c', '#ff86a0'),
    'aside': ('#6f7d8b', '#8f9fae'),
    'late': ('#8a5a00', '#e7b04b'),
    'fix': ('#b97f00', '#f3bd4a'),
}

SANS = (
    "Inter, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', 'Noto Sans', 'Liberation Sans', "
    'Arial, system-ui, sans-serif'
)
MONO = "ui-monospace, 'SF Mono', 'Cascadia Mono', 'Liberation Mono', Menlo, Consolas, monospace"

FULL_PX = 1080  # width of a picture across the page
HALF_PX = 530  # width of one of two beside each other


def color(token: str) -> str:
    """Light colour of a token, to draw with."""
    return TOKENS[token][0]


def run_color(index: int) -> str:
    """Colour of the configuration at this place; they repeat after five."""
    return color(f'run{index % 5}')


@dataclass(frozen=True)
class VerdictLook:
    """Colour and shape of one verdict."""

    token: str
    marker: str
    filled: bool = True


_LOOKS = {
    'FUSED': VerdictLook('fused', 'o'),
    'GATED': VerdictLook('gated', 's'),
    'DUPLICATE': VerdictLook('aside', 'D', filled=False),
    'TOO_OLD': VerdictLook('late', 'v'),
    'TOO_LATE': VerdictLook('late', '>'),
    'FROM_FUTURE': VerdictLook('late', '<'),
    'NOT_FINITE': VerdictLook('damaged', 'P'),
    'BAD_CRC': VerdictLook('damaged', 'X'),
    'BAD_MAC': VerdictLook('damaged', '*'),
    'BAD_FORMAT': VerdictLook('damaged', 'd'),
    'IMPLAUSIBLE': VerdictLook('damaged', 'p'),
    'REPLAYED': VerdictLook('aside', 'd', filled=False),
    'UNKNOWN_SOURCE': VerdictLook('aside', 'h'),
    'IN_FLIGHT': VerdictLook('aside', 'o', filled=False),
    'SWITCHED_OFF': VerdictLook('aside', 's', filled=False),
    'NOT_READY': VerdictLook('aside', '^', filled=False),
}


def verdict_look(verdict: str) -> VerdictLook:
    """Look of a verdict, also of one that this version does not know."""
    return _LOOKS.get(verdict, VerdictLook('aside', 'p', filled=False))


def new_figure(width_px: float, height_px: float, *, free: bool = False) -> Figure:
    """Figure whose SVG has one unit per CSS pixel; `free` of automatic layout."""
    size = (width_px / 72.0, height_px / 72.0)
    if free:
        fig = Figure(figsize=size)
    else:
        engine = ConstrainedLayoutEngine(w_pad=4 / 72, h_pad=3 / 72, hspace=0.04, wspace=0.03)
        fig = Figure(figsize=size, layout=engine)
    fig.patch.set_alpha(0.0)
    return fig


@contextmanager
def drawing(salt: str) -> Iterator[None]:
    """Settings while a figure is drawn; `salt` makes its ids repeatable and its own."""
    with mpl.rc_context(
        {
            'svg.fonttype': 'none',
            'svg.hashsalt': salt,
            'path.simplify': True,
            'path.simplify_threshold': 0.1,
            'font.family': 'DejaVu Sans',
            'font.size': 12,
            'axes.titlesize': 13,
            'axes.titleweight': 'bold',
            'axes.titlelocation': 'left',
            'axes.titlepad': 8,
            'axes.labelsize': 12,
            'axes.labelcolor': color('muted'),
            'axes.edgecolor': color('rule'),
            'axes.facecolor': 'none',
            'axes.linewidth': 1.0,
            'axes.spines.top': False,
            'axes.spines.right': False,
            'axes.grid': True,
            'axes.axisbelow': True,
            'axes.unicode_minus': True,
            'grid.color': color('rule'),
            'grid.linewidth': 0.7,
            'xtick.color': color('rule'),
            'ytick.color': color('rule'),
            'xtick.labelcolor': color('muted'),
            'ytick.labelcolor': color('muted'),
            'xtick.labelsize': 11,
            'ytick.labelsize': 11,
            'xtick.major.size': 3,
            'ytick.major.size': 3,
            'text.color': color('ink'),
            'axes.titlecolor': color('ink'),
            'lines.linewidth': 1.6,
            'lines.solid_capstyle': 'round',
            'legend.frameon': False,
            'legend.fontsize': 11,
            'hatch.linewidth': 0.6,
        }
    ):
        yield
