"""Depth sensor error model: y = quantized(depth + bias + air + drift_k + sigma w_k + e u_k).

u is uniform; air, drawn per run, is the day's air pressure minus the one that the instrument
subtracts; the drift is a Gauss-Markov process. A sensor that sticks repeats its last reading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.params import param, vector

from ..randomness import substream
from ..section import Spec
from .noise import CHUNK, Draws, GaussMarkov, Index

Floats = NDArray[np.float64]

M_PER_HPA = 100.0 / (1027.0 * 9.83)
"""Depth of polar surface water per hectopascal of air [m]."""


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
    air_pressure_sigma_hpa: float = param(
        0.0, 'hPa', 0.0, 100.0, "1-sigma of the day's air pressure about it, drawn per run"
    )
    drift_sigma_m: float = param(0.0, 'm', 0.0, 100.0, '1-sigma of the slow drift (Gauss-Markov)')
    drift_tau_s: float = param(3600.0, 's', 0.1, 1e7, 'Its correlation time')
    stick_probability: float = param(
        0.0, '', 0.0, 1.0, 'Probability that a sample begins to repeat the one before'
    )
    stick_s: float = param(5.0, 's', 0.0, 3600.0, 'For how long it sticks then')


class DepthSensor:
    """One depth sensor.

    Parameters
    ----------
    errors : DepthErrors
        Its errors and mounting.
    rng : numpy.random.Generator
        Its own stream.
    period_s : float
        Time between samples [s].
    """

    def __init__(
        self, errors: DepthErrors, rng: np.random.Generator, period_s: float = 0.1
    ) -> None:
        self._e = errors
        self._arm_b = np.array(errors.lever_b)
        self._draws = Draws(rng, 1)
        # A stream of its own: the option changes no other draw.
        self._uniform = Draws(rng.spawn(1)[0], 1, uniform=True)
        self._index = Index()
        self._air = 0.0
        if errors.air_pressure_sigma_hpa > 0.0:
            unit = float(substream(rng, 'air').standard_normal())
            self._air = M_PER_HPA * errors.air_pressure_sigma_hpa * unit
        drift = substream(rng, 'drift')
        self._drift = GaussMarkov(
            np.full(1, errors.drift_sigma_m),
            errors.drift_tau_s,
            period_s,
            drift.standard_normal(1),
        )
        self._drift_draws = Draws(drift, 1)
        self._slow = np.empty((0, 1))
        self._sticks = Draws(substream(rng, 'stick'), 1, uniform=True)
        self._stick_count = max(1, round(errors.stick_s / period_s))
        self._stuck: list[bool] = []
        self._stuck_until = 0
        self._last: float | None = None

    @property
    def variance(self) -> float:
        """Of a sample [m^2]: noise, uniform error and rounding."""
        e = self._e
        return e.noise_sigma_m**2 + e.uniform_error_m**2 / 3.0 + e.quantum_m**2 / 12.0

    def measure(self, k: int, depth: float, C_b_G: Floats) -> float:
        """Measured depth of sample number k.

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
            self._slow = self._drift.advance(self._drift_draws.advance())
            self._advance_sticking()
        if self._stuck[row] and self._last is not None:
            return self._last
        below = depth - float(C_b_G[2] @ self._arm_b)
        measured = below + self._e.bias_m + self._e.noise_sigma_m * float(self._draws.rows[row, 0])
        measured += self._e.uniform_error_m * float(self._uniform.rows[row, 0])
        measured += self._air + float(self._slow[row, 0])
        if self._e.quantum_m > 0.0:
            measured = self._e.quantum_m * round(measured / self._e.quantum_m)
        self._last = measured
        return measured

    def _advance_sticking(self) -> None:
        """Mark the samples of the next chunk that repeat the one before."""
        first = 0.5 * (self._sticks.advance()[:, 0] + 1.0) < self._e.stick_probability
        start = CHUNK * self._sticks.chunk
        self._stuck = []
        for k, begins in enumerate(first.tolist(), start):
            if begins and k >= self._stuck_until:
                self._stuck_until = k + self._stick_count
            self._stuck.append(k < self._stuck_until)
