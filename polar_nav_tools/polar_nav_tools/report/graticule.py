"""Parallels and meridians that suit a map, from half the Arctic to some metres at the pole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .projection import PolarMap

Floats = NDArray[np.float64]

# Degrees; below one degree in minutes and seconds of arc, as charts have them.
STEPS = tuple(
    [30.0, 15.0, 10.0, 5.0, 2.0, 1.0]
    + [m / 60.0 for m in (30, 15, 10, 5, 2, 1)]
    + [s / 3600.0 for s in (30, 15, 10, 5, 2, 1, 0.5, 0.2, 0.1)]
)
_METRES_PER_DEGREE = 111_200.0
_LINES = 4.0  # wanted across the window


@dataclass(frozen=True, eq=False)
class GraticuleLine:
    """One parallel or meridian, in map coordinates."""

    label: str
    parallel: bool
    xy: Floats  # shape (n, 2) [m]


def graticule(projection: PolarMap, low: Floats, high: Floats) -> list[GraticuleLine]:
    """Lines across the window from corner `low` to corner `high` (x, y) [m]."""
    size = float(np.hypot(*(high - low)))
    edge = _edge_points(low, high)
    inside_pole = bool((low < 0.0).all() and (high > 0.0).all())
    radius = np.hypot(edge[:, 0], edge[:, 1])
    middle_radius = float(np.hypot(*(0.5 * (low + high))))

    latitude, _ = projection.to_geodetic(edge)
    magnitude = np.rad2deg(np.abs(latitude))
    lat_low = float(magnitude.min())
    lat_high = 90.0 if inside_pole else float(magnitude[np.argmin(radius)])
    step = _step((float(min(high - low)) / _LINES) / _METRES_PER_DEGREE)
    # Longitudes around that of the middle, so that the date line is no border.
    _, center = projection.to_geodetic(0.5 * (low + high))
    _, longitude = projection.to_geodetic(edge)
    away = np.rad2deg(np.angle(np.exp(1j * (longitude - center))))
    first, last = (float(np.rad2deg(center) + v) for v in (away.min(), away.max()))
    if inside_pole:
        first, last = -180.0, 180.0
    lines = [
        _parallel(projection, lat, first, last)
        for lat in _multiples(lat_low, min(lat_high, 90.0 - 0.25 * step), step)
    ]

    if inside_pole or middle_radius < 0.75 * size:
        lon_step, first = 30.0, max(first, last - 330.0)  # -180 and 180 are one meridian
    else:
        lon_step = _step(np.rad2deg(float(min(high - low)) / _LINES / middle_radius))
    # Not into the pole itself, where all of them would make a blot.
    last_deg = projection.hemisphere * (90.0 - 0.25 * step)
    blot = float(np.hypot(*projection.from_geodetic(np.deg2rad(last_deg), 0.0)))
    inner = blot if inside_pole else max(blot, float(radius.min()) - 0.1 * size)
    lines += [
        _meridian(projection, lon, inner, float(radius.max()) + 0.1 * size)
        for lon in _multiples(first, last, lon_step)
    ]
    return lines


def angle_label(degrees: float, letters: str) -> str:
    """Degrees as charts write them; `letters` are those of positive and negative, e.g. 'NS'."""
    letter = letters[0] if degrees >= 0 else letters[1]
    # In tenths of a second, so that 59.99999 minutes do not appear.
    tenths = round(abs(degrees) * 36000.0)
    whole, rest = divmod(tenths, 36000)
    minutes, seconds = divmod(rest, 600)
    text = f'{whole}°'
    if minutes or seconds:
        text += f'{minutes:02d}′'
    if seconds:
        text += f'{seconds / 10:04.1f}″'.replace('.0″', '″')
    return text if letters == 'EW' and whole in (0, 180) and not rest else text + letter


def _parallel(
    projection: PolarMap, lat_deg: float, first_deg: float, last_deg: float
) -> GraticuleLine:
    latitude = np.deg2rad(lat_deg) * projection.hemisphere
    pad = 0.0 if last_deg - first_deg >= 360.0 else 0.1 * (last_deg - first_deg)
    lon = np.deg2rad(np.linspace(first_deg - pad, last_deg + pad, 361))
    xy = projection.from_geodetic(np.full(lon.shape, latitude), lon)
    return GraticuleLine(angle_label(lat_deg * projection.hemisphere, 'NS'), True, xy)


def _meridian(projection: PolarMap, lon_deg: float, inner: float, outer: float) -> GraticuleLine:
    lon = np.deg2rad(lon_deg)
    direction = np.array([np.sin(lon), -projection.hemisphere * np.cos(lon)])
    shown = (lon_deg + 180.0) % 360.0 - 180.0
    shown = 180.0 if shown == -180.0 else shown
    xy = np.outer(np.linspace(inner, outer, 200), direction)
    return GraticuleLine(angle_label(shown, 'EW'), False, xy)


def _edge_points(low: Floats, high: Floats) -> Floats:
    s = np.linspace(0.0, 1.0, 50)[:, None]
    a, b = low, np.array([high[0], low[1]])
    c, d = high, np.array([low[0], high[1]])
    return np.concatenate([p + s * (q - p) for p, q in ((a, b), (b, c), (c, d), (d, a))])


def _step(wanted_deg: float) -> float:
    """Largest step that is not larger than wanted; the smallest there is otherwise."""
    return next((s for s in STEPS if s <= wanted_deg), STEPS[-1])


def _multiples(first: float, last: float, step: float) -> list[float]:
    low, high = np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9)
    return [float(k * step) for k in np.arange(low, high + 1)]
