"""Furniture of a nautical chart: frame, graticule, scale bar, pole, compass, overview."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..graticule import GraticuleLine, angle_label
from ..projection import PolarMap
from ..style import color

Floats = NDArray[np.float64]

_MARGIN_X, _MARGIN_Y = 14.0, 15.0  # least distance of labels along an edge [px]
_CHAR = 6.4  # width of a character of a label [px]


def window(points: Floats, aspect: float, least: float = 50.0) -> tuple[Floats, Floats]:
    """Corners of a window of width / height = `aspect` around points (n, 2) with a margin [m]."""
    low, high = points.min(0), points.max(0)
    size = np.maximum(1.22 * (high - low), least)
    height = max(size[1], size[0] / aspect)
    half = 0.5 * height * np.array([aspect, 1.0])
    center = 0.5 * (low + high)
    return center - half, center + half


def frame(
    fig: Figure, box_px: tuple[float, float, float, float], low: Floats, high: Floats
) -> Axes:
    """Axes at `box_px` (left, bottom, width, height) that show corners `low` to `high`."""
    width, height = fig.get_size_inches() * 72.0
    x, y, w, h = box_px
    ax = fig.add_axes((x / width, y / height, w / width, h / height))
    ax.set_facecolor(color('sea'))
    ax.grid(visible=False)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    for spine in ax.spines.values():
        spine.set_visible(True)
        spine.set_color(color('muted'))
    return ax


def draw_graticule(ax: Axes, lines: list[GraticuleLine]) -> None:
    """Thin lines; labels stand outside of the frame where they cross it, or on a closed circle."""
    low, high = _corners(ax)
    pixel = _pixel(ax)
    edges: dict[str, list[tuple[float, str]]] = {'left': [], 'bottom': [], 'top': []}
    for parallel in (True, False):
        family = [one for one in lines if one.parallel == parallel]
        crossings = [_crossings(one.xy, low, high) for one in family]
        met = [edge for found in crossings for edge, _ in found]
        # One label each, on the edge that most of the family crosses; none on the right.
        order = sorted(edges, key=lambda edge: (-met.count(edge), edge))
        for one, found in zip(family, crossings, strict=True):
            ax.plot(*one.xy.T, color=color('graticule'), lw=0.8, zorder=1)
            for edge in order:
                places = [place for where, place in found if where == edge]
                if places:
                    edges[edge] += [(place, one.label) for place in places]
                    break
            if not found and parallel and ((one.xy > low) & (one.xy < high)).all():
                top = one.xy[np.argmax(one.xy[:, 1])]
                _label(ax, top, one.label, (0, 3), 'center', 'bottom', halo=True)
    for edge, labels in edges.items():
        _edge_labels(ax, edge, sorted(labels), low, high, pixel)


def draw_scale_bar(ax: Axes) -> None:
    """Bar of a round length in the lower right corner."""
    low, high = _corners(ax)
    pixel = _pixel(ax)
    length = round_length(0.22 * (high[0] - low[0]))
    x1, y = high[0] - 18 * pixel, low[1] + 18 * pixel
    x0 = x1 - length
    ax.plot([x0, x1], [y, y], color=color('ink'), lw=4.0, solid_capstyle='butt', zorder=9)
    middle = 0.5 * (x0 + x1)
    ax.plot([x0, middle], [y, y], color=color('card'), lw=2.0, solid_capstyle='butt', zorder=9.1)
    _label(ax, np.array([middle, y]), length_label(length), (0, 5), 'center', 'bottom', halo=True)


def draw_pole(ax: Axes, chart: PolarMap) -> None:
    """Mark the pole if it is in view, else draw an arrow to it at the upper left."""
    low, high = _corners(ax)
    name = 'North Pole' if chart.hemisphere > 0 else 'South Pole'
    if (low < 0.0).all() and (high > 0.0).all():
        ax.plot(0, 0, ls='', marker='+', ms=16, mew=1.6, color=color('ink'), zorder=6)
        ax.plot(0, 0, ls='', marker='o', ms=7, mfc='none', mec=color('ink'), mew=1.2, zorder=6)
        _label(ax, np.zeros(2), name, (8, 6), 'left', 'bottom', halo=True, bold=True)
        return
    pixel = _pixel(ax)
    center = 0.5 * (low + high)
    distance = float(np.hypot(*center))
    toward = -center / distance
    base = np.array([low[0] + 46 * pixel, high[1] - 46 * pixel])
    _arrow(ax, base, np.array([0.0, 1.0]), 26 * pixel, 'muted')
    _arrow(ax, base, toward, 34 * pixel, 'ink')
    _label(ax, base + np.array([0, 27 * pixel]), 'grid N', (0, 2), 'center', 'bottom', halo=True)
    text = f'{name}\n{length_label(distance)}'
    if toward[0] < 0.0:  # to the right of both arrows
        _label(ax, base + np.array([12 * pixel, 0.0]), text, (0, 2), 'left', 'top', halo=True)
        return
    drop = -4.0 if toward[1] < 0.3 else -2.0
    _label(ax, base + toward * 36 * pixel, text, (6.0, drop), 'left', 'top', halo=True)


def overview(
    fig: Figure, box_px: tuple[float, float, float, float], chart: PolarMap, track: Floats
) -> None:
    """Small map of the whole polar region with the place of the mission."""
    reach = float(np.hypot(*track.T).max())
    latitude, _ = chart.to_geodetic(np.array([reach, 0.0]))
    outer_deg = min(75.0, 10.0 * np.floor((abs(np.rad2deg(latitude)) - 4.0) / 10.0))
    width, height = fig.get_size_inches() * 72.0
    x, y, w, h = box_px
    ax = fig.add_axes((x / width, y / height, w / width, h / height))
    ax.set_axis_off()
    ax.set_aspect('equal')
    rings = np.arange(outer_deg, 89.9, 5.0 if outer_deg >= 65 else 10.0)
    lon = np.linspace(-np.pi, np.pi, 181)
    outer = float(np.hypot(*chart.from_geodetic(chart.hemisphere * np.deg2rad(outer_deg), 0.0)))
    for deg in rings:
        ring = chart.from_geodetic(np.full(181, chart.hemisphere * np.deg2rad(deg)), lon)
        edge = deg == outer_deg
        ax.fill(*ring.T, color=color('sea'), lw=0, zorder=0) if edge else None
        ax.plot(*ring.T, color=color('muted' if edge else 'graticule'), lw=1.0 if edge else 0.7)
        spot = chart.from_geodetic(chart.hemisphere * np.deg2rad(deg), np.deg2rad(-135.0))
        letters = angle_label(deg * chart.hemisphere, 'NS')
        if not edge:
            _label(ax, spot, letters, (0, 0), 'center', 'center', halo=True, size=9.5)
    for deg in range(0, 360, 30):
        end = outer * np.array(
            [np.sin(np.deg2rad(deg)), -chart.hemisphere * np.cos(np.deg2rad(deg))]
        )
        ax.plot([0.03 * end[0], end[0]], [0.03 * end[1], end[1]], color=color('graticule'), lw=0.7)
        if deg % 90 == 0:
            text = angle_label((deg + 180) % 360 - 180 if deg != 180 else 180, 'EW')
            _label(ax, 1.1 * end, text, (0, 0), 'center', 'center', size=10)
    ax.plot(0, 0, ls='', marker='+', ms=9, mew=1.2, color=color('ink'))
    place = track[len(track) // 2]
    ax.plot(*place, ls='', marker='o', ms=15, mfc='none', mec=color('ink'), mew=2.0, zorder=5)
    ax.plot(*place, ls='', marker='o', ms=4, mfc=color('ink'), mew=0, zorder=5)
    ax.set_xlim(-1.22 * outer, 1.22 * outer)
    ax.set_ylim(-1.22 * outer, 1.22 * outer)


def round_length(wanted: float) -> float:
    """Largest of 1, 2, 5 times a power of ten that is not larger than wanted."""
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(m * power for m in (1.0, 2.0, 5.0) if m * power <= wanted * (1 + 1e-9)))


def length_label(metres: float) -> str:
    """Text of a length with unit."""
    if metres < 1000.0:
        return f'{metres:.3g} m'
    km = metres / 1000.0
    return f'{km:,.0f} km'.replace(',', '\u202f') if km >= 100 else f'{km:.3g} km'


def _crossings(xy: Floats, low: Floats, high: Floats) -> list[tuple[str, float]]:
    """Edges at which a line leaves the window, with the place along the edge."""
    inside = np.asarray(((xy >= low) & (xy <= high)).all(1))
    found = []
    for k in np.flatnonzero(inside[1:] != inside[:-1]):
        a, b = (xy[k], xy[k + 1]) if inside[k] else (xy[k + 1], xy[k])  # a inside, b outside
        share = [_reach(a[k], b[k], low[k], high[k]) for k in (0, 1)]
        axis = int(np.argmin(share))
        point = a + share[axis] * (b - a)
        names = ('right', 'left') if axis == 0 else ('top', 'bottom')
        found.append((names[0] if b[axis] > a[axis] else names[1], float(point[1 - axis])))
    return found


def _reach(a: float, b: float, low: float, high: float) -> float:
    """Share of the way from a, inside, to b at which the border is met; infinite if never."""
    return float(((high if b > a else low) - a) / (b - a)) if b != a else np.inf


def _edge_labels(
    ax: Axes,
    edge: str,
    labels: list[tuple[float, str]],
    low: Floats,
    high: Floats,
    pixel: float,
) -> None:
    """Labels along one edge, leaving out those that would touch the one before."""
    upright = edge in ('left', 'right')
    free = -np.inf
    for place, text in labels:
        half = 0.5 * (_MARGIN_Y if upright else _CHAR * len(text) + _MARGIN_X) * pixel
        if place - half < free:
            continue
        free = place + half
        if upright:
            x, gap, ha = (low[0], -5, 'right') if edge == 'left' else (high[0], 5, 'left')
            _label(ax, np.array([x, place]), text, (gap, 0), ha, 'center')
        else:
            y, gap, va = (low[1], -5, 'top') if edge == 'bottom' else (high[1], 5, 'bottom')
            _label(ax, np.array([place, y]), text, (0, gap), 'center', va)


def _label(
    ax: Axes,
    at: Floats,
    text: str,
    offset: tuple[float, float],
    ha: str,
    va: str,
    *,
    halo: bool = False,
    bold: bool = False,
    size: float = 11,
) -> None:
    ax.annotate(
        text,
        _xy(at),
        xytext=offset,
        textcoords='offset points',
        ha=ha,
        va=va,
        fontsize=size,
        fontweight='bold' if bold else 'normal',
        color=color('ink' if bold else 'muted'),
        annotation_clip=False,
        gid='class:halo-sea' if halo else None,
        zorder=10,
    )


def _arrow(ax: Axes, base: Floats, direction: Floats, length: float, token: str) -> None:
    ax.annotate(
        '',
        _xy(base + direction * length),
        xytext=_xy(base),
        arrowprops={
            'arrowstyle': '-|>',
            'color': color(token),
            'lw': 1.4,
            'shrinkA': 0,
            'shrinkB': 0,
        },
        zorder=9,
    )


def _xy(point: Floats) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _corners(ax: Axes) -> tuple[Floats, Floats]:
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    return np.array([x0, y0]), np.array([x1, y1])


def _pixel(ax: Axes) -> float:
    """Metres per pixel of the figure."""
    fig = ax.get_figure(root=True)
    if fig is None:
        raise ValueError('ax belongs to no figure')
    width_px = float(fig.get_size_inches()[0]) * 72.0 * ax.get_position().width
    x0, x1 = ax.get_xlim()
    return float((x1 - x0) / width_px)
