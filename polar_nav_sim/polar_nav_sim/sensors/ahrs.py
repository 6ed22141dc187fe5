"""Attitude and heading reference: rates and attitude with uniform errors, as the DVL-less paper.

    omega_k = omega_b + u_k e_rate
    (psi, theta, phi)_k = true angles + w_k e_angle + (b, 0, 0)

u, w uniform in [-1, 1] per axis and sample. The attitude is base_link in the local grid axes; b is
the constant heading error, counter-clockwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import euler_from_matrix, matrix_from_euler
from polar_nav_core.params import param

from ..section import Spec
from .noise import CHUNK, Draws, Index

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AhrsErrors(Spec):
    """Errors of an AHRS; defaults are those of the DVL-less paper."""

    ahrs_rate_error: float = param(
        0.01, 'rad/s', 0.0, 1.0, 'Largest error of each angular rate, uniform (ahrs)'
    )
    ahrs_angle_error: float = param(
        0.02, 'rad', 0.0, 1.0, 'Largest error of roll, pitch and heading, uniform (ahrs)'
    )
    ahrs_heading_bias_deg: float = param(
        0.0, 'deg', -180.0, 180.0, 'Constant error of the heading, counter-clockwise (ahrs)'
    )

    @property
    def angle_variance(self) -> float:
        """Of each angle, the constant error of heading left out [rad^2]."""
        return self.ahrs_angle_error**2 / 3.0

    @property
    def rate_variance(self) -> float:
        """Of each rate [(rad/s)^2]."""
        return self.ahrs_rate_error**2 / 3.0


class AhrsSensor:
    """One AHRS.

    Parameters
    ----------
    errors : AhrsErrors
        What is wrong with it.
    rng : numpy.random.Generator
        Its own stream.
    """

    def __init__(self, errors: AhrsErrors, rng: np.random.Generator) -> None:
        self._e = errors
        self._draws = Draws(rng, 6, uniform=True)
        self._index = Index()

    def measure(self, k0: int, omega_b: Floats, C_b_G: Floats) -> tuple[Floats, Floats]:
        """Measured samples k0, k0 + 1, ...

        Parameters
        ----------
        k0 : int
            Numbers never go back; skipped ones are skipped in the noise.
        omega_b : ndarray, shape (n, 3)
            Angular rates [rad/s].
        C_b_G : ndarray, shape (n, 3, 3)
            True attitude, body to grid.

        Returns
        -------
        omega_b, C_b_G : ndarray, shape (n, 3), (n, 3, 3)
        """
        w = self._uniform(k0, len(omega_b))
        psi, theta, phi = euler_from_matrix(C_b_G)
        angle = self._e.ahrs_angle_error
        bias = math.radians(self._e.ahrs_heading_bias_deg)
        measured = matrix_from_euler(
            psi + bias + angle * w[:, 5], theta + angle * w[:, 4], phi + angle * w[:, 3]
        )
        return omega_b + self._e.ahrs_rate_error * w[:, :3], measured

    def _uniform(self, k0: int, count: int) -> Floats:
        """Rows of numbers in [-1, 1], shape (count, 6)."""
        self._index.take(k0, count)
        out = np.empty((count, 6))
        done = 0
        while done < count:
            chunk, first = divmod(k0 + done, CHUNK)
            while self._draws.chunk < chunk:
                self._draws.advance()
            n = min(CHUNK - first, count - done)
            out[done : done + n] = self._draws.rows[first : first + n]
            done += n
        return out
