"""The shape of a recorded track, smoothed in a polar plane and followed at mission speed.

Buoy fixes are rounded (1e-4 degrees is 11 m) and hours apart; the vehicle sails a smooth curve
near them, not from fix to fix. All fixes between the stated times are smoothed together: the shape
does not depend on how long the mission is. The plane is the polar stereographic one of the
hemisphere, in which neither the pole nor the 180th meridian is special.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import earth
from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_text

from .. import splines
from ..specs import TrackSpec

Floats = NDArray[np.float64]

_SPHERE_M = 6371000.0
_DEGREE = 5
_SAMPLE_M = 1.0
_MOST_SAMPLES = 200_000


@dataclass(frozen=True)
class Fixes:
    """Recorded positions in the order of time: UTC seconds, radians."""

    utc_s: Floats
    lat: Floats
    lon: Floats


def read_fixes(path: Path) -> Fixes:
    """Fixes of a CSV file with the columns datetime, latitude and longitude.

    Raises
    ------
    ConfigError
        Naming the file, the line and what is wrong.
    """
    times: list[float] = []
    lats: list[float] = []
    lons: list[float] = []
    with io.StringIO(read_text(path), newline='') as f:
        rows = csv.DictReader(f)
        missing = {'datetime', 'latitude', 'longitude'} - set(rows.fieldnames or ())
        if missing:
            raise ConfigError(f'{path}: no column {sorted(missing)[0]}')
        for row in rows:
            try:
                when, lat, lon = (
                    parse_utc(row['datetime']),
                    float(row['latitude']),
                    float(row['longitude']),
                )
            except (TypeError, ValueError) as error:
                raise ConfigError(f'{path}, line {rows.line_num}: {error}') from error
            if not (abs(lat) <= 90.0 and abs(lon) <= 360.0):
                raise ConfigError(
                    f'{path}, line {rows.line_num}: no place at {lat}, {lon} degrees'
                )
            if times and when <= times[-1]:
                raise ConfigError(
                    f'{path}, line {rows.line_num}: time does not increase:'
                    f' {row["datetime"].strip()} is the same as or before the line above'
                )
            times.append(when)
            lats.append(math.radians(lat))
            lons.append(math.radians(lon))
    return Fixes(np.array(times), np.array(lats), np.array(lons))


def parse_utc(text: str) -> float:
    """UTC seconds of an ISO date and time; without an offset it is UTC."""
    when = datetime.fromisoformat(text.strip())
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def to_plane(lat: Floats, lon: Floats, south: bool) -> Floats:
    """Positions in the polar stereographic plane, shape (n, 2) [m]."""
    rho = 2.0 * _SPHERE_M * np.tan(0.25 * np.pi - 0.5 * (-lat if south else lat))
    return np.stack([rho * np.cos(lon), rho * np.sin(lon)], axis=-1)


def from_plane(xy: Floats, south: bool) -> tuple[Floats, Floats]:
    """Latitude and longitude of points in the plane [rad]; longitude 0 at the pole itself."""
    rho = np.hypot(xy[..., 0], xy[..., 1])
    lat = 0.5 * np.pi - 2.0 * np.arctan(rho / (2.0 * _SPHERE_M))
    return (-lat if south else lat), np.arctan2(xy[..., 1], xy[..., 0])


class TrackPath:
    """A smooth curve near the chosen part of a track.

    Parameters
    ----------
    spec : TrackSpec
        Which part, how smooth.
    path : Path
        The file.
    before_s, after_s : float
        Sailing time that is needed before and after the start of the mission [s].
    """

    def __init__(self, spec: TrackSpec, path: Path, before_s: float, after_s: float) -> None:
        self._where = f'{path}'
        fixes = chosen_fixes(spec, path)
        self._south = bool(np.mean(fixes.lat) < 0.0)
        xy = to_plane(fixes.lat, fixes.lon, self._south)
        if spec.reverse:
            xy = xy[::-1]
        self._curve = self._smooth(xy, spec.smoothing_m)
        self._speed = spec.speed_mps
        self._margin_m = spec.speed_mps * before_s
        self._need_m = spec.speed_mps * (before_s + after_s)
        self._nearest_pole = spec.nearest_pole

    def _smooth(self, xy: Floats, smoothing_m: float) -> Floats:
        moved = np.concatenate([[True], np.any(np.diff(xy, axis=0) != 0.0, axis=1)])
        xy = xy[moved]
        if len(xy) <= _DEGREE:
            raise ConfigError(
                f'{self._where}: {len(xy)} fixes between first_utc and last_utc, a curve needs'
                f' {_DEGREE + 1}'
            )
        chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        curve, _ = splines.splprep(xy.T, u=chord, s=len(xy) * smoothing_m**2, k=_DEGREE)
        count = int(min(max(chord[-1] / _SAMPLE_M, 100.0), _MOST_SAMPLES))
        return np.stack(splines.splev(np.linspace(0.0, chord[-1], count), curve), axis=-1)

    def sail(self, height: float, t_s: Floats) -> Floats:
        """Positions at constant speed over ground along the curve.

        Parameters
        ----------
        height : float
            Height above the ellipsoid [m].
        t_s : ndarray, shape (n,)
            Time since the start of the mission [s].

        Returns
        -------
        ndarray, shape (n, 3)
            ECEF [m].

        Raises
        ------
        ConfigError
            When the curve is too short.
        """
        lat, lon = from_plane(self._curve, self._south)
        dense_e = np.asarray(earth.ecef_from_geodetic(lat, lon, np.full_like(lat, height)))
        along = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(dense_e, axis=0), axis=1))]
        )
        spare_m = along[-1] - self._need_m
        if spare_m < 0.0:
            raise ConfigError(
                f'{self._where}: the smoothed part is {along[-1]:.0f} m long,'
                f' the mission needs {self._need_m:.0f} m'
            )
        start_m = 0.0
        if self._nearest_pole:
            # The middle of the mission comes as near to the closest point as the file allows.
            closest_m = along[int(np.argmin(np.linalg.norm(self._curve, axis=1)))]
            start_m = min(max(0.0, closest_m - 0.5 * self._need_m), spare_m)
        s = start_m + self._margin_m + self._speed * t_s
        # The plane, not ECEF, is interpolated: the result is then exactly at the stated height.
        xy = splines.make_interp_spline(along, self._curve, k=3)(np.clip(s, 0.0, along[-1]))
        lat, lon = from_plane(xy, self._south)
        return np.asarray(earth.ecef_from_geodetic(lat, lon, np.full_like(lat, height)))


def chosen_fixes(spec: TrackSpec, path: Path) -> Fixes:
    """Fixes between ``first_utc`` and ``last_utc``.

    Raises
    ------
    ConfigError
        If the file cannot be read or has none.
    """
    fixes = read_fixes(path)
    keep = np.ones(len(fixes.utc_s), dtype=bool)
    for name, limit in (('first_utc', spec.first_utc), ('last_utc', spec.last_utc)):
        if not limit:
            continue
        try:
            utc_s = parse_utc(limit)
        except ValueError as error:
            raise ConfigError(f'path: parameter {name}: {limit!r} is not an ISO time') from error
        keep &= fixes.utc_s >= utc_s if name == 'first_utc' else fixes.utc_s <= utc_s
    if not keep.any():
        raise ConfigError(f'{path}: no fix between first_utc and last_utc')
    return Fixes(fixes.utc_s[keep], fixes.lat[keep], fixes.lon[keep])
