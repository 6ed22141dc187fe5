"""Polar stereographic map of WGS-84, regular at its pole, in real metres at the place shown.

Greenwich points down on the northern map and up on the southern one, which makes the map's axes
the grid axes: x grid east (+e_y), y grid north (-e_x in the north, +e_x in the south). Away from
the pole grid axes and map axes differ by a fraction of a degree (0.37 degrees at 80 N, 120 E):
both grids are conformal, only one is flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polar_nav_core.earth import geodetic_from_ecef

Floats = NDArray[np.float64]

_A = 6378137.0  # WGS-84 semi-major axis [m]
_E = float(np.sqrt(2.0 / 298.257223563 - 298.257223563**-2))  # first eccentricity


@dataclass(frozen=True)
class PolarMap:
    """Projection true to scale at latitude `true_latitude`, around the pole of `hemisphere`."""

    hemisphere: int  # 1 north, -1 south
    true_latitude: float  # [rad], magnitude

    @classmethod
    def around(cls, latitude: Floats) -> PolarMap:
        """Map for places at these latitudes [rad]: nearer pole, true to scale at their middle."""
        finite = latitude[np.isfinite(latitude)]
        if finite.size == 0:
            raise ValueError('latitude has no finite value')
        hemisphere = 1 if np.median(finite) >= 0.0 else -1
        magnitude = hemisphere * finite
        return cls(hemisphere, float(0.5 * (magnitude.min() + magnitude.max())))

    def from_geodetic(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Map coordinates [m] of places [rad].

        rho = k t(lat), t = tan(pi/4 - lat/2) ((1 + e sin lat)/(1 - e sin lat))^(e/2) (Snyder 1987,
        eqs. 15-9 and 21-33, 21-34), and k such that the scale is 1 at the true latitude.

        Returns
        -------
        ndarray, shape (..., 2)
            x, y; (0, 0) at the pole.
        """
        rho = self._scale() * _t(self.hemisphere * np.asarray(latitude, dtype=np.float64))
        lon = np.asarray(longitude, dtype=np.float64)
        return np.stack([rho * np.sin(lon), -self.hemisphere * rho * np.cos(lon)], axis=-1)

    def from_ecef(self, r_e: Floats) -> Floats:
        """Map coordinates [m] of ECEF positions [m], shape (..., 3) to (..., 2)."""
        latitude, longitude, _ = geodetic_from_ecef(np.asarray(r_e, dtype=np.float64))
        return self.from_geodetic(latitude, longitude)

    def to_geodetic(self, xy: Floats) -> tuple[Floats, Floats]:
        """Latitude and longitude [rad] of map coordinates [m], shape (..., 2)."""
        xy = np.asarray(xy, dtype=np.float64)
        t = np.hypot(xy[..., 0], xy[..., 1]) / self._scale()
        longitude = np.arctan2(xy[..., 0], -self.hemisphere * xy[..., 1])
        latitude = 0.5 * np.pi - 2.0 * np.arctan(t)
        for _ in range(6):  # converges by e^2 = 1/150 a step
            s = _E * np.sin(latitude)
            latitude = 0.5 * np.pi - 2.0 * np.arctan(t * ((1.0 - s) / (1.0 + s)) ** (_E / 2.0))
        return self.hemisphere * latitude, longitude

    def _scale(self) -> float:
        lat = abs(self.true_latitude)
        if lat > 0.5 * np.pi - 1e-9:
            # Limit of m / t at the pole.
            return 2.0 * _A / float(np.sqrt((1 + _E) ** (1 + _E) * (1 - _E) ** (1 - _E)))
        m = np.cos(lat) / np.sqrt(1.0 - (_E * np.sin(lat)) ** 2)
        return float(_A * m / _t(np.float64(lat)))


def _t(latitude: Floats | np.float64) -> Floats:
    s = _E * np.sin(latitude)
    return np.tan(0.25 * np.pi - 0.5 * latitude) * ((1.0 + s) / (1.0 - s)) ** (_E / 2.0)
