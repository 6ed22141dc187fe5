"""Slow and systematic errors of an IMU that a filter with constant biases does not model.

Drawn per run, each from a stream of its own name, so that one of them never changes another:

    E            scale factors on the diagonal, cross-axis terms beside it
    G            gyro bias per specific force, rad/s per m/s^2: every entry is independent
    residual_k   c (Temp(t) - Temp(0)) + step(t >= t_step) + sum of random steps before t
                 + rectified vibration b g_rms^2 (t >= t_vibration)

with t = k T and Temp(t) = Temp_end + (Temp_start - Temp_end) exp(-t / tau): an IMU that comes from
the deck and cools in the water.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..randomness import substream
from .imu_errors import DPH, G0, MICRO_G, ImuErrors
from .noise import CHUNK, Draws

Floats = NDArray[np.float64]


class Residuals:
    """Errors of one IMU besides its noise and constant biases.

    Parameters
    ----------
    errors : ImuErrors
        Its errors.
    period_s : float
        Length of an interval [s].
    rng : numpy.random.Generator
        The stream of the IMU; it is named, not drawn from.

    Attributes
    ----------
    matrices : (E of the gyros, E of the accelerometers)
        Each of shape (3, 3), or None where it is zero.
    G : ndarray, shape (3, 3), or None
        Gyro bias per specific force [rad/s / (m/s^2)].
    """

    def __init__(self, errors: ImuErrors, period_s: float, rng: np.random.Generator) -> None:
        e = self._e = errors
        self._rng = rng
        self._period_s = period_s
        self._chunk = -1
        self.matrices = (
            self._matrix('gyro', e.gyro_scale_sigma, e.gyro_misalignment_sigma),
            self._matrix('accel', e.accel_scale_sigma, e.accel_misalignment_sigma),
        )
        self.G = (
            e.gyro_g_sigma_dph * DPH / G0 * self._drawn('g', (3, 3))
            if e.gyro_g_sigma_dph > 0.0
            else None
        )
        unit = np.repeat([DPH, MICRO_G], 3)
        self._per_kelvin = (
            unit
            * np.repeat([e.gyro_temperature_sigma_dph, e.accel_temperature_sigma_ug], 3)
            * self._drawn('temperature', 6)
        )
        self._step = unit * [*e.gyro_step_dph, *e.accel_step_ug]
        self._vibration = (
            unit
            * e.vibration_rms_g**2
            * np.repeat([e.gyro_vibration_sigma_dph, e.accel_vibration_sigma_ug], 3)
            * self._drawn('vibration', 6)
        )
        self._step_sigma = unit * np.repeat([e.gyro_step_sigma_dph, e.accel_step_sigma_ug], 3)
        self._random = e.bias_steps_per_hour > 0.0 and bool(self._step_sigma.any())
        self._when = Draws(substream(rng, 'steps/when'), 1, uniform=True)
        self._size = Draws(substream(rng, 'steps/size'), 6)
        self._sum = np.zeros(6)
        constant = self._per_kelvin.any() or self._step.any() or self._vibration.any()
        self._on = bool(constant) or self._random

    def advance(self, additive: list[Floats]) -> None:
        """Add the next chunk of all six axes to two arrays of shape (CHUNK, 3)."""
        self._chunk += 1
        if not self._on:
            return
        e = self._e
        t_s = self._period_s * (CHUNK * self._chunk + np.arange(CHUNK))[:, None]
        cooled = (e.temperature_end_c - e.temperature_start_c) * -np.expm1(
            -t_s / e.temperature_tau_s
        )
        residual = self._per_kelvin * cooled
        residual += self._step * (t_s >= e.bias_step_s)
        residual += self._vibration * (t_s >= e.vibration_from_s)
        if self._random:
            residual += self._random_steps()
        for i in range(2):
            additive[i] += residual[:, 3 * i : 3 * i + 3]

    def _random_steps(self) -> Floats:
        """Sum of the steps so far, shape (CHUNK, 6)."""
        probability = -math.expm1(-self._e.bias_steps_per_hour * self._period_s / 3600.0)
        happens = 0.5 * (self._when.advance() + 1.0) < probability
        total = self._sum + np.cumsum(happens * self._step_sigma * self._size.advance(), axis=0)
        self._sum = total[-1]
        return np.asarray(total)

    def _matrix(self, triad: str, scale: float, cross: float) -> Floats | None:
        if scale == 0.0 and cross == 0.0:
            return None
        unit = self._drawn(f'{triad}/matrix', (3, 3))
        return np.where(np.eye(3, dtype=bool), scale * unit, cross * unit)

    def _drawn(self, name: str, shape: int | tuple[int, int]) -> Floats:
        return np.asarray(substream(self._rng, name).standard_normal(shape))
