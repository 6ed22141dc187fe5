"""A recorded track in its own time: smoothed positions at the stamps of the buoy.

The fixes are smoothed as functions of their stamps in the polar plane of
:mod:`polar_nav_sim.paths.track`; the mission's clock is the track's. Between fixes that are far
apart in time the way is unknown, so a mission over such a gap is refused.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import earth
from polar_nav_core.errors import ConfigError

from .. import splines
from ..specs import TrackSpec
from .track import Fixes, chosen_fixes, from_plane, to_plane

Floats = NDArray[np.float64]

_DEGREE = 5
_HOUR_S = 3600.0


class RecordedPath:
    """A smooth curve through time near the chosen fixes.

    Parameters
    ----------
    spec : TrackSpec
        Which part, how smooth, which gap is too long.
    path : Path
        The file.
    start_utc_s : float
        UTC seconds at the start of the mission.
    before_s, after_s : float
        Time that is needed before and after it [s].

    Raises
    ------
    ConfigError
        Naming the file and why the mission cannot follow the stamps: outside of the track, too few
        fixes, a gap.
    """

    def __init__(
        self, spec: TrackSpec, path: Path, start_utc_s: float, before_s: float, after_s: float
    ) -> None:
        fixes = chosen_fixes(spec, path)
        first, last = start_utc_s - before_s, start_utc_s + after_s
        _check_inside(fixes, first, last, path)
        _check_gaps(fixes, first, last, spec.max_gap_s, path)
        if len(fixes.utc_s) <= _DEGREE:
            raise ConfigError(
                f'{path}: {len(fixes.utc_s)} fixes between first_utc and last_utc, a curve needs'
                f' {_DEGREE + 1}'
            )
        self._south = bool(np.mean(fixes.lat) < 0.0)
        self._origin_s = float(fixes.utc_s[0])
        self._start_s = start_utc_s - self._origin_s
        xy = to_plane(fixes.lat, fixes.lon, self._south)
        hours = (fixes.utc_s - self._origin_s) / _HOUR_S
        smoothing = len(xy) * spec.smoothing_m**2
        self._curve, _ = splines.splprep(xy.T, u=hours, s=smoothing, k=_DEGREE)

    def sail(self, height: float, t_s: Floats) -> Floats:
        """Positions at times since the start of the mission, ECEF, shape (n, 3) [m]."""
        xy = np.stack(splines.splev((self._start_s + t_s) / _HOUR_S, self._curve), axis=-1)
        lat, lon = from_plane(xy, self._south)
        return np.asarray(earth.ecef_from_geodetic(lat, lon, np.full_like(lat, height)))


def recorded_start_s(spec: TrackSpec, path: Path, duration_s: float, margin_s: float) -> float:
    """UTC second of the start of a mission that states none.

    The first that leaves the margin behind the first fix; with ``nearest_pole`` the one that puts
    the middle of the mission at the fix nearest to a pole, as far as the track allows.
    """
    fixes = chosen_fixes(spec, path)
    first = math.ceil(fixes.utc_s[0] + margin_s)
    if not spec.nearest_pole:
        return float(first)
    closest_s = fixes.utc_s[int(np.argmax(np.abs(fixes.lat)))]
    latest = math.floor(fixes.utc_s[-1] - margin_s - duration_s)
    return float(max(first, min(latest, round(closest_s - 0.5 * duration_s))))


def _check_inside(fixes: Fixes, first_s: float, last_s: float, path: Path) -> None:
    if first_s < fixes.utc_s[0] or last_s > fixes.utc_s[-1]:
        raise ConfigError(
            f'{path}: the mission needs the track from {_utc(first_s)} to {_utc(last_s)} (a few'
            f' seconds more than it lasts), its fixes are from {_utc(fixes.utc_s[0])} to'
            f' {_utc(fixes.utc_s[-1])}; with as_recorded, start_time and duration_s must fit'
        )


def _check_gaps(fixes: Fixes, first_s: float, last_s: float, limit_s: float, path: Path) -> None:
    used = (fixes.utc_s[1:] > first_s) & (fixes.utc_s[:-1] < last_s)
    gaps = np.where(used, np.diff(fixes.utc_s), 0.0)
    i = int(np.argmax(gaps))
    if gaps[i] > limit_s:
        raise ConfigError(
            f'{path}: no fix for {gaps[i]:.0f} s after {_utc(fixes.utc_s[i])}, more than max_gap_s'
            f' {limit_s}: as_recorded cannot follow it; choose another part with first_utc,'
            ' last_utc or start_time'
        )


def _utc(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, tz=UTC).isoformat(timespec='seconds')
