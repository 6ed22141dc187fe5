"""Depth sensor error model: y = quantized(depth + bias + sigma w_k + e u_k), u uniform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.params import param, vector

from ..section import Spec
from .noise import CHUNK, Draws, Index

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DepthErrors(Spec):
    """Errors of a depth sensor."""

    lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'Position from base_link, body axes'
    )
    bias_m: float = param(0.0, 'm', -100.0, 100.0, 'Constant error, positive: too deep')
    noise_sigma_m: float = param(0.05, 'm', 0.0, 100.0, 'White noise per sample, 1-sigma')
    uniform_error_m: float = param(
        0.0, 'm', 0.0, 100.0, 'Largest further error per sample, uniform; the DVL-less paper: 0.05'
    )
    quantum_m: float = param(0.0, 'm', 0.0, 10.0, 'Resolution; 0: none')
    atmospheric_pressure_pa: float = param(
        101325.0, 'Pa', 80000.0, 110000.0, 'Air pressure at the surface'
    )


class DepthSensor:
    """One depth sensor.

    Parameters
    ----------
    errors : DepthErrors
        What is wrong with it, and where it is mounted.
    rng : numpy.random.Generator
        Its own stream.
    """

    def __init__(self, errors: DepthErrors, rng: np.random.Generator) -> None:
        self._e = errors
        self._arm_b = np.array(errors.lever_b)
        self._draws = Draws(rng, 1)
        # A stream of its own: the option changes no other draw.
        self._uniform = Draws(rng.spawn(1)[0], 1, uniform=True)
        self._index = Index()

    @property
    def variance(self) -> float:
        """Of a sample [m^2]: noise, uniform error and rounding."""
        e = self._e
        return e.noise_sigma_m**2 + e.uniform_error_m**2 / 3.0 + e.quantum_m**2 / 12.0

    def measure(self, k: int, depth: float, C_b_G: Floats) -> float:
        """Sample number k.

        Parameters
        ----------
        k : int
            Numbers never go back; skipped ones are skipped in the noise.
        depth : float
            Of base_link, positive down [m].
        C_b_G : ndarray, shape (3, 3)
            Body to grid.

        Returns
        -------
        float
            Depth of the sensor as measured [m].
        """
        self._index.take(k, 1)
        chunk, row = divmod(k, CHUNK)
        while self._draws.chunk < chunk:
            self._draws.advance()
            self._uniform.advance()
        below = depth - float(C_b_G[2] @ self._arm_b)
        measured = below + self._e.bias_m + self._e.noise_sigma_m * float(self._draws.rows[row, 0])
        measured += self._e.uniform_error_m * float(self._uniform.rows[row, 0])
        if self._e.quantum_m > 0.0:
            measured = self._e.quantum_m * round(measured / self._e.quantum_m)
        return measured
