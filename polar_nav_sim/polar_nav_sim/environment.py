"""Disturbed gravity and sea surface, which no filter models.

A field is a sum of plane waves over the horizontal plane at a place, random in direction, length
and phase: smooth, the same for every vehicle, and with the stated RMS over places and seeds.

    s_k = k_k . x + p_k,    a = sqrt(2 / K)
    anomaly     = A + sigma_A a sum cos s_k                          downwards
    deflection  = D - sigma_D sqrt(2) a sum (k_k / |k_k|) sin s_k    of the plumb line
    undulation  = N + sigma_N a sum cos s_k                          other waves

The phases are those of a potential field (masses below attract sideways too); on a flat Earth its
sigma_D is sigma_A / (sqrt(2) gamma): 0.148 arcsec per mGal, on each axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import earth, grid
from polar_nav_core.params import param, vector

from .randomness import stream
from .section import Spec

Floats = NDArray[np.float64]

MGAL = 1e-5
"""One milligal [m/s^2]."""
ARCSEC = math.radians(1.0) / 3600.0
_WAVES = 16
"""Enough that the sum is nearly Gaussian: the kurtosis of its values is 3 - 1.5 / 16."""


@dataclass(frozen=True)
class GravitySpec(Spec):
    """Difference of a mission's gravity from normal gravity; zero by default."""

    anomaly_mgal: float = param(0.0, 'mGal', -500.0, 500.0, 'Constant anomaly, positive: stronger')
    anomaly_sigma_mgal: float = param(0.0, 'mGal', 0.0, 500.0, 'RMS of the varying anomaly')
    deflection_arcsec: tuple[float, float] = vector(
        (0.0, 0.0), 'arcsec', -300.0, 300.0, 'Constant pull of gravity to grid east, grid north'
    )
    deflection_sigma_arcsec: float = param(
        0.0, 'arcsec', 0.0, 300.0, 'RMS per axis of the varying deflection'
    )
    shortest_m: float = param(10e3, 'm', 100.0, 1e6, 'Shortest wave of the field')
    longest_m: float = param(50e3, 'm', 100.0, 1e6, 'Longest one')
    seed: int = param(1, '', 0, 2**31 - 1, 'Of the field, which belongs to the place, not the run')

    @property
    def is_normal(self) -> bool:
        """Whether the difference is zero."""
        constant = self.anomaly_mgal or any(self.deflection_arcsec)
        return not (constant or self.anomaly_sigma_mgal or self.deflection_sigma_arcsec)


@dataclass(frozen=True)
class GeoidSpec(Spec):
    """Difference of the sea surface from the height in the vehicles' parameters."""

    undulation_m: float = param(0.0, 'm', -150.0, 150.0, 'Constant part')
    undulation_sigma_m: float = param(0.0, 'm', 0.0, 100.0, 'RMS of the varying part')
    shortest_m: float = param(20e3, 'm', 100.0, 1e7, 'Shortest wave of it')
    longest_m: float = param(200e3, 'm', 100.0, 1e7, 'Longest one')
    seed: int = param(1, '', 0, 2**31 - 1, 'Of the field, which belongs to the place, not the run')

    @property
    def is_flat(self) -> bool:
        """Whether the difference is zero."""
        return not (self.undulation_m or self.undulation_sigma_m)


class _Waves:
    """Plane waves over the horizontal plane at an origin."""

    def __init__(
        self, name: str, seed: int, lengths_m: tuple[float, float], origin_e: Floats
    ) -> None:
        rng = stream(seed, f'environment/{name}')
        shortest, longest = min(lengths_m), max(lengths_m)
        length_m = shortest * (longest / shortest) ** rng.random(_WAVES)
        angle, self._phase = 2.0 * np.pi * rng.random((2, _WAVES))
        self.direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self._wave = self.direction * (2.0 * np.pi / length_m)[:, None]
        self._origin_e = origin_e
        self._C_e_O = np.asarray(grid.ecef_to_grid(origin_e))[:2]

    def argument(self, r_e: Floats) -> Floats:
        """s_k at places of shape (..., 3) [rad], shape (..., K)."""
        x_O = (r_e - self._origin_e) @ self._C_e_O.T
        return np.asarray(x_O @ self._wave.T + self._phase)


class Gravity:
    """Gravity of a place minus normal gravity.

    Parameters
    ----------
    spec : GravitySpec
        The difference.
    origin_e : ndarray, shape (3,)
        Point where the horizontal plane of the field touches the Earth, ECEF [m].
    """

    def __init__(self, spec: GravitySpec, origin_e: Floats) -> None:
        self._spec = spec
        self._waves = _Waves(
            'gravity', spec.seed, (spec.shortest_m, spec.longest_m), np.asarray(origin_e)
        )

    def disturbance(self, r_e: Floats) -> Floats:
        """Gravity minus normal gravity at places of shape (..., 3), grid axes [m/s^2]."""
        e = self._spec
        s = self._waves.argument(r_e)
        a = math.sqrt(2.0 / _WAVES)
        tilt = np.array(e.deflection_arcsec) * ARCSEC - (
            e.deflection_sigma_arcsec * ARCSEC * math.sqrt(2.0) * a
        ) * (np.sin(s) @ self._waves.direction)
        anomaly = (e.anomaly_mgal + e.anomaly_sigma_mgal * a * np.sum(np.cos(s), axis=-1)) * MGAL
        level = np.asarray(earth.gravity(r_e))[..., None] * tilt
        return np.concatenate([level, -anomaly[..., None]], axis=-1)


class Geoid:
    """Sea surface of a place above the height in the vehicles' parameters; as :class:`Gravity`."""

    def __init__(self, spec: GeoidSpec, origin_e: Floats) -> None:
        self._spec = spec
        self._waves = _Waves(
            'geoid', spec.seed, (spec.shortest_m, spec.longest_m), np.asarray(origin_e)
        )

    def undulation(self, r_e: Floats) -> Floats:
        """Height of the sea surface above the stated one at places of shape (..., 3) [m]."""
        e = self._spec
        waves = np.sum(np.cos(self._waves.argument(r_e)), axis=-1)
        return np.asarray(e.undulation_m + e.undulation_sigma_m * math.sqrt(2.0 / _WAVES) * waves)


@dataclass(frozen=True)
class Environment:
    """Disturbances of gravity and sea surface in a mission's truth; none by default."""

    gravity: Gravity | None = None
    geoid: Geoid | None = None


CALM = Environment()
"""Normal gravity and a level sea."""
