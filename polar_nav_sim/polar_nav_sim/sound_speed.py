"""Sound speed in the water: one number, or a profile with the harmonic mean along the slant path.

Rays are straight. Along a straight ray the travel time is L / c_h with the harmonic mean over
depth c_h = (z2 - z1) / integral of dz / c(z); between the points of the profile c is linear in
depth, and the integral of a segment is dz ln(c2/c1) / (c2 - c1), exactly.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import param, text
from polar_nav_core.user_files import read_text

from .resources import DATA
from .section import Spec

Floats = NDArray[np.float64]

_LEVEL_M = 1e-3
"""Ends nearer in depth than this [m] are treated as level: the speed at their depth."""


@dataclass(frozen=True)
class WaterSpec(Spec):
    """Sound speed: a number, or a profile."""

    sound_speed: float = param(
        1440.0, 'm/s', 1300.0, 1700.0, 'Sound speed, unless a profile is given'
    )
    sound_speed_profile: str = text(
        '',
        'CSV with columns depth_m and sound_speed_mps; also sought in the data of polar_nav_sim',
    )


class SoundSpeed:
    """Sound speed over depth.

    Parameters
    ----------
    depth : ndarray, shape (n,)
        Increasing [m].
    speed : ndarray, shape (n,)
        At these depths [m/s]; constant above the first and below the last.
    """

    def __init__(self, depth: Floats, speed: Floats) -> None:
        if len(depth) != len(speed) or len(depth) == 0:
            raise ValueError(f'{len(depth)} depths and {len(speed)} speeds make no profile')
        if not np.all(np.diff(depth) > 0.0):
            raise ValueError('the depths of a sound speed profile must increase')
        if not np.all((speed > 1000.0) & (speed < 2000.0)):
            raise ValueError('a sound speed is outside of [1000, 2000] m/s')
        self._depth = depth
        self._speed = speed
        segments = np.array(
            [_slowness_integral(*s) for s in zip(depth, speed, depth[1:], speed[1:], strict=False)]
        )
        self._integral = np.concatenate([[0.0], np.cumsum(segments)])

    @classmethod
    def constant(cls, speed: float) -> SoundSpeed:
        """Sound speed that is the same everywhere."""
        return cls(np.zeros(1), np.array([speed]))

    @classmethod
    def from_csv(cls, path: Path) -> SoundSpeed:
        """Sound speed of a CSV profile with the columns depth_m and sound_speed_mps.

        Raises
        ------
        ConfigError
            Naming the file and what is wrong.
        """
        try:
            rows = list(csv.DictReader(io.StringIO(read_text(path), newline='')))
            depth = np.array([float(r['depth_m']) for r in rows])
            return cls(depth, np.array([float(r['sound_speed_mps']) for r in rows]))
        except KeyError as error:
            raise ConfigError(f'{path}: no column {error}') from error
        except (csv.Error, TypeError, ValueError) as error:
            raise ConfigError(f'{path}: no sound speed profile: {error}') from error

    @classmethod
    def from_spec(cls, spec: WaterSpec) -> SoundSpeed:
        """Sound speed by the parameters.

        Raises
        ------
        ConfigError
            When the profile cannot be read.
        """
        if not spec.sound_speed_profile:
            return cls.constant(spec.sound_speed)
        path = Path(spec.sound_speed_profile).expanduser()
        return cls.from_csv(path if path.is_file() else DATA / path)

    def at(self, depth: float) -> float:
        """Sound speed at a depth [m/s]."""
        return float(np.interp(depth, self._depth, self._speed))

    def mean(self, depth_a: float, depth_b: float) -> float:
        """Harmonic mean between two depths, in either order [m/s]."""
        if abs(depth_b - depth_a) < _LEVEL_M:
            return self.at(0.5 * (depth_a + depth_b))
        return (depth_b - depth_a) / (self._slowness_to(depth_b) - self._slowness_to(depth_a))

    def _slowness_to(self, depth: float) -> float:
        """Integral of 1/c from the first depth of the profile [s]."""
        i = min(
            max(int(np.searchsorted(self._depth, depth, side='right')) - 1, 0),
            len(self._depth) - 1,
        )
        start = float(self._depth[i])
        return float(self._integral[i]) + _slowness_integral(
            start, float(self._speed[i]), depth, self.at(depth)
        )


def _slowness_integral(z1: float, c1: float, z2: float, c2: float) -> float:
    """Integral of dz / c for c linear between two points [s]."""
    ratio = c2 / c1 - 1.0
    # ln(1 + x)/x, whose series serves where the division would lose digits.
    factor = (
        1.0 - ratio / 2.0 + ratio * ratio / 3.0 if abs(ratio) < 1e-6 else math.log1p(ratio) / ratio
    )
    return (z2 - z1) / c1 * factor
