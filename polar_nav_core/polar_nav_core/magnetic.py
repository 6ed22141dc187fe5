"""The Earth's magnetic field around a place, by the World Magnetic Model (pygeomag).

The field is a vector in the earth frame with its gradient: a declination is singular at a
geographic pole, the field is not (docs/derivations/heading.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np

from . import earth
from .arrays import Array
from .errors import ConfigError

_STEP = 5000.0
"""Of the differences that give the gradient [m]: well below the 3,000 km of degree 12."""
_MOST_LATITUDE = math.radians(89.999)
"""The library divides by the cosine of the latitude; 110 m from a pole the field is that at it."""


@dataclass(frozen=True)
class Field:
    """Magnetic field around a place.

    Attributes
    ----------
    r_e : (3,) array
        The place, ECEF [m].
    field_e : (3,) array
        Field there, ECEF [nT].
    gradient_e : (3, 3) array
        Its change with the place, ECEF [nT/m].
    horizontal, vertical : float
        Parts of the field there, vertical positive down [nT].
    """

    r_e: Array
    field_e: Array
    gradient_e: Array
    horizontal: float
    vertical: float


def year_of(stamp_ns: int) -> float:
    """Year and fraction of a stamp [ns] since 1970, UTC."""
    when = datetime.fromtimestamp(stamp_ns * 1e-9, UTC)
    begin, end = datetime(when.year, 1, 1, tzinfo=UTC), datetime(when.year + 1, 1, 1, tzinfo=UTC)
    return when.year + (when - begin) / (end - begin)


def field_near(lat: float, lon: float, height: float, year: float) -> Field | None:
    """Field around a place; None where no model is of that year.

    Parameters
    ----------
    lat, lon : float
        Geodetic [rad].
    height : float
        Above the ellipsoid [m].
    year : float
        Year and fraction.

    Raises
    ------
    ConfigError
        When pygeomag is not installed.
    """
    r_e = np.asarray(earth.ecef_from_geodetic(lat, lon, height))
    here = _field_at(r_e, year)
    if here is None:
        return None
    gradient = np.zeros((3, 3))
    for k in range(3):
        step = np.zeros(3)
        step[k] = _STEP
        ahead, behind = _field_at(r_e + step, year), _field_at(r_e - step, year)
        if ahead is None or behind is None:
            return None
        gradient[:, k] = (ahead - behind) / (2.0 * _STEP)
    up = earth.ecef_to_enu(_beside_a_pole(lat), lon)[2]
    down = -float(up @ here)
    horizontal = float(np.linalg.norm(here + down * up))
    return Field(r_e, here, gradient, horizontal, down)


def _field_at(r_e: Array, year: float) -> Array | None:
    """Field at a place, ECEF [nT]; None where no model is of that year."""
    lat, lon, height = (float(x) for x in earth.geodetic_from_ecef(r_e))
    lat = _beside_a_pole(lat)
    model = _model(year)
    if model is None:
        return None
    found = model.calculate(math.degrees(lat), math.degrees(lon), height * 1e-3, year)
    east, north, up = earth.ecef_to_enu(lat, lon)
    field: Array = found.x * north + found.y * east - found.z * up
    return field


def _beside_a_pole(lat: float) -> float:
    return min(max(lat, -_MOST_LATITUDE), _MOST_LATITUDE)


@lru_cache(maxsize=4)
def _model(year: float):  # type: ignore[no-untyped-def]  # noqa: ANN202 - untyped library
    """World Magnetic Model of a year; None where there is none."""
    # Here, because only a magnetic compass needs it.
    try:
        from pygeomag import GeoMag
    except ImportError:
        raise ConfigError(
            'a magnetic heading needs pygeomag, which is not installed here (pip install pygeomag)'
        ) from None
    epoch = 5 * math.floor(year / 5.0)
    if not 2020 <= epoch <= 2025:
        return None
    return GeoMag(coefficients_file=f'wmm/WMM_{epoch}.COF')
