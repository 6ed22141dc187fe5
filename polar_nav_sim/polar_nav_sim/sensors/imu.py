"""IMU error model: ideal increments in, mean rates and specific forces as measured out.

With x the true mean over an interval of length T, per triad:

    y = ((I + diag(scale)) C_b_s + E) x + bias + turn_on + instability_k + walk_k
        + density / sqrt(T) w_k + residual_k

then saturation of y, then quantization of y T whose remainder is carried into the next sample, as
in an instrument that counts pulses. C_b_s is the misalignment: the triad is turned by it against
the body. E and the residual, zero by default, are those of
:mod:`polar_nav_sim.sensors.imu_residuals`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import exp

from .imu_errors import DPH, G0, MICRO_G, ImuErrors
from .imu_residuals import Residuals
from .noise import CHUNK, Draws, GaussMarkov, Index, RandomWalk, fixed_product

Floats = NDArray[np.float64]

__all__ = ['DPH', 'G0', 'MICRO_G', 'ImuErrors', 'ImuSensor']


@dataclass(frozen=True)
class _Triad:
    """Errors of three gyros or three accelerometers, SI."""

    bias: Floats
    turn_on: float
    density: Floats
    instability: float
    tau_s: float
    walk: float
    scale: Floats
    misalignment: Floats
    quantum: float
    limit: float


class ImuSensor:
    """One IMU.

    Parameters
    ----------
    errors : ImuErrors
        Its errors.
    period_s : float
        Length of an interval [s].
    rng : numpy.random.Generator
        Its own stream.
    """

    def __init__(self, errors: ImuErrors, period_s: float, rng: np.random.Generator) -> None:
        e = errors
        triads = (
            _Triad(
                np.array(e.gyro_bias_dph) * DPH,
                e.gyro_turn_on_sigma_dph * DPH,
                np.array(e.gyro_noise_density),
                e.gyro_instability_sigma_dph * DPH,
                e.gyro_instability_tau_s,
                e.gyro_random_walk,
                np.array(e.gyro_scale),
                np.array(e.gyro_misalignment),
                e.gyro_quantum,
                e.gyro_range,
            ),
            _Triad(
                np.array(e.accel_bias_ug) * MICRO_G,
                e.accel_turn_on_sigma_ug * MICRO_G,
                np.array(e.accel_noise_density),
                e.accel_instability_sigma_ug * MICRO_G,
                e.accel_instability_tau_s,
                e.accel_random_walk,
                np.array(e.accel_scale),
                np.array(e.accel_misalignment),
                e.accel_quantum,
                e.accel_range,
            ),
        )
        self.period_s = period_s
        self._index = Index()
        self._draws = Draws(rng, 18)
        once = rng.standard_normal((4, 3))
        self._residuals = Residuals(e, period_s, rng)
        self._triads = [
            _TriadModel(t, period_s, once[2 * i], once[2 * i + 1], self._residuals.matrices[i])
            for i, t in enumerate(triads)
        ]
        self._additive = [np.empty((0, 3)), np.empty((0, 3))]

    def measure(self, k0: int, delta_theta_b: Floats, delta_v_b: Floats) -> tuple[Floats, Floats]:
        """Mean rates and specific forces of intervals k0, k0 + 1, ...

        Parameters
        ----------
        k0 : int
            Number of the first interval; numbers never go back, skipped ones are skipped in the
            noise.
        delta_theta_b, delta_v_b : ndarray, shape (n, 3)
            Ideal increments [rad], [m/s].

        Returns
        -------
        omega_ib_b, f_b : ndarray, shape (n, 3)
            Means over the intervals as measured [rad/s], [m/s^2].
        """
        self._index.take(k0, len(delta_theta_b))
        gyro, accel = np.empty_like(delta_theta_b), np.empty_like(delta_v_b)
        done = 0
        while done < len(delta_theta_b):
            chunk, first = divmod(k0 + done, CHUNK)
            while self._draws.chunk < chunk:
                w = self._draws.advance()
                self._additive = [
                    t.additive(w[:, 9 * i : 9 * i + 9]) for i, t in enumerate(self._triads)
                ]
                self._residuals.advance(self._additive)
            count = min(CHUNK - first, len(delta_theta_b) - done)
            now, rows = slice(done, done + count), slice(first, first + count)
            added = self._additive[0][rows]
            if self._residuals.G is not None:
                added = added + fixed_product(self._residuals.G, delta_v_b[now] / self.period_s)
            gyro[now] = self._triads[0].measure(delta_theta_b[now], added)
            accel[now] = self._triads[1].measure(delta_v_b[now], self._additive[1][rows])
            done += count
        return gyro, accel


class _TriadModel:
    def __init__(
        self, triad: _Triad, period_s: float, turn_on: Floats, first: Floats, E: Floats | None
    ) -> None:
        self._triad = triad
        self._period_s = period_s
        self._bias = triad.bias + triad.turn_on * turn_on
        self._white = triad.density / math.sqrt(period_s)
        self._instability = GaussMarkov(
            np.full(3, triad.instability), triad.tau_s, period_s, first
        )
        self._walk = RandomWalk(np.full(3, triad.walk), period_s)
        self._matrix = np.diag(1.0 + triad.scale) @ exp(triad.misalignment).T
        if E is not None:
            self._matrix = self._matrix + E
        self._remainder = np.zeros(3)

    def additive(self, w: Floats) -> Floats:
        """Sum of all additive errors, for one chunk of standard normal rows, shape (CHUNK, 9)."""
        return np.asarray(
            self._bias
            + self._white * w[:, :3]
            + self._instability.advance(w[:, 3:6])
            + self._walk.advance(w[:, 6:])
        )

    def measure(self, increments: Floats, additive: Floats) -> Floats:
        y = fixed_product(self._matrix, increments / self._period_s) + additive
        if self._triad.limit > 0.0:
            y = np.clip(y, -self._triad.limit, self._triad.limit)
        if self._triad.quantum > 0.0:
            y = self._quantize(y * self._period_s) / self._period_s
        return y

    def _quantize(self, increments: Floats) -> Floats:
        out = np.empty_like(increments)
        for i, increment in enumerate(increments):
            total = self._remainder + increment
            out[i] = self._triad.quantum * np.round(total / self._triad.quantum)
            self._remainder = total - out[i]
        return out
