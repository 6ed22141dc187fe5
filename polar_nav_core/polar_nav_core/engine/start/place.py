"""Place from the first two fixes that agree, brought to the present by dead reckoning."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...earth import geodetic_from_ecef
from ...grid import ecef_to_grid
from ...kernels.limits import EARTH
from ..events import Fix
from ..level import is_level
from ..plausibility import believed, is_covariance, within
from .course import Passed

UNKNOWN_VELOCITY = 2.0
"""1-sigma of a speed that nothing measures, of a vehicle under way [m/s]."""
_AGREE = 3.0
_MOST_AGE_S = 120.0
_MOST_FIXES = 300


class Located(NamedTuple):
    """A usable fix: stamp of validity, position with 1-sigma per horizontal axis, and vertical."""

    stamp_ns: int
    r_e: Array
    sigma: float
    sigma_up: float
    has_height: bool
    source: str


class Place(NamedTuple):
    """Position of base_link, ECEF [m], with 1-sigma, and where it is from."""

    r_e: Array
    sigma: float
    sigma_up: float
    has_height: bool
    how: str


def located(fix: Fix, min_fix_sigma: float) -> Located | None:
    """Position of a fix, as sure as it is believed; None of one that cannot be used."""
    if fix.refusal is not None or not within(fix.r_e, EARTH[1]):
        return None
    if float(np.linalg.norm(fix.r_e)) < EARTH[0] or not is_covariance(fix.covariance_e):
        return None
    C_e_G = ecef_to_grid(fix.r_e)
    P_G = C_e_G @ believed(fix, min_fix_sigma).covariance_e @ C_e_G.T
    sigma = math.sqrt(max(float(P_G[0, 0]), float(P_G[1, 1])))
    up = math.sqrt(float(P_G[2, 2]))
    return Located(fix.validity_ns, fix.r_e, sigma, up, not is_level(fix), fix.source)


class Fixes:
    """Fixes of a start, in the order of their validity.

    Parameters
    ----------
    displacement : callable
        Dead-reckoned way since a stamp, level axes (2,) [m]; None where there is none.
    min_fix_sigma : float
        The parameter [m].
    """

    def __init__(
        self, displacement: Callable[[int], Array | None], min_fix_sigma: float = 0.0
    ) -> None:
        self._displacement, self._min_fix_sigma = displacement, min_fix_sigma
        self._all: deque[Located] = deque(maxlen=_MOST_FIXES)

    def __len__(self) -> int:
        """Return the number of fixes that can be used."""
        return len(self._all)

    def take(self, fix: Fix) -> None:
        """Store a fix, if it can be used and is the newest."""
        found = located(fix, self._min_fix_sigma)
        if found is not None and (not self._all or found.stamp_ns > self._all[-1].stamp_ns):
            self._all.append(found)

    def clear(self) -> None:
        """Forget all of them."""
        self._all.clear()

    def agreed(self, now_ns: int) -> Located | None:
        """Newest fix that an earlier one agrees with; None without."""
        fresh = [f for f in self._all if now_ns - f.stamp_ns <= _MOST_AGE_S * 1e9]
        for k in range(len(fresh) - 1, 0, -1):
            if any(self._agree(fresh[j], fresh[k]) for j in range(k)):
                return fresh[k]
        return None

    def _agree(self, a: Located, b: Located) -> bool:
        """Whether two fixes are as far apart as the way between them, which may be unknown."""
        d = ecef_to_grid(b.r_e) @ (b.r_e - a.r_e)
        apart = math.hypot(d[0], d[1])
        limit = _AGREE * math.hypot(a.sigma, b.sigma)
        before, after = self._displacement(a.stamp_ns), self._displacement(b.stamp_ns)
        if before is None or after is None:
            return apart <= limit + _AGREE * UNKNOWN_VELOCITY * (b.stamp_ns - a.stamp_ns) * 1e-9
        way = before - after
        return abs(apart - math.hypot(way[0], way[1])) <= limit

    def at(self, fix: Located, now_ns: int, turn: float, speed: float | None) -> Place:
        """Place of the antenna now, from a fix.

        Parameters
        ----------
        fix : Located
        now_ns : int
        turn : float
            From level to grid axes [rad].
        speed : float or None
            Present [m/s]; None if it is not known.
        """
        age_s = (now_ns - fix.stamp_ns) * 1e-9
        way_L = self._displacement(fix.stamp_ns)
        how = f'from fixes of {fix.source}, the newest {age_s:.1f} s old'
        if way_L is not None:
            way = complex(way_L[0], way_L[1]) * np.exp(1j * turn)
            r_e = fix.r_e + ecef_to_grid(fix.r_e).T @ np.array([way.real, way.imag, 0.0])
            return Place(r_e, fix.sigma, fix.sigma_up, fix.has_height, how)
        unknown = (UNKNOWN_VELOCITY if speed is None else speed) * age_s
        sigma = math.hypot(fix.sigma, unknown)
        return Place(fix.r_e, sigma, fix.sigma_up, fix.has_height, how)

    def passed(self, track: Array) -> list[Passed]:
        """Fixes within a dead-reckoned track of the antenna (n, 3): stamp [ns], x, y [m]."""
        if len(track) < 2 or not self._all:
            return []
        C_e_G, origin = ecef_to_grid(self._all[-1].r_e), self._all[-1].r_e
        rows = []
        for fix in self._all:
            if track[0, 0] <= fix.stamp_ns <= track[-1, 0]:
                q = [float(np.interp(fix.stamp_ns, track[:, 0], track[:, k])) for k in (1, 2)]
                p_G = (C_e_G @ (fix.r_e - origin))[:2]
                rows.append(Passed(fix.stamp_ns, p_G, np.array(q), fix.sigma))
        return rows


def geodetic(r_e: Array) -> tuple[float, float, float]:
    """Latitude, longitude [rad] and height [m] of a position (3,)."""
    lat, lon, height = geodetic_from_ecef(r_e)
    return float(lat), float(lon), float(height)
