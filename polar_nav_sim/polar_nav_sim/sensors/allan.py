"""Allan deviation of an IMU's stated errors, and degrees of freedom of its estimate.

Everything follows from the generalized covariance K(l) of the angle (or velocity) x that the
sampled rate adds up to, l intervals of length T apart; the terms add:

    white noise of density N       K = -N^2 T l / 2
    Gauss-Markov sigma, q = e^-T/tau
                                   K = -(sigma T)^2 (l (1 - q^2) - 2 q (1 - q^l)) / (2 (1 - q)^2)
    random walk of density W       K = W^2 T^3 (l^3 - l) / 12
    counts of size Q               K = Q^2 / 12 at l = 0, else 0

With d_k = x_{k+2m} - 2 x_{k+m} + x_k the Allan variance at m T is E[d^2] / (2 (m T)^2), and the
autocovariance of d is R(l) = K(l-2m) - 4 K(l-m) + 6 K(l) - 4 K(l+m) + K(l+2m). An estimate from
all M = n - 2m + 1 overlapping d has the equivalent degrees of freedom

    2 E[v]^2 / Var[v] = M^2 R(0)^2 / sum over |l| < M of (M - |l|) R(l)^2

exactly, also where several terms meet; the 1-sigma of its root is deviation / sqrt(2 dof). These
are the processes as they are sampled, not their continuous limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .imu import DPH, MICRO_G, ImuErrors

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Terms:
    """Random errors of one axis, SI: of a gyro [rad, s], of an accelerometer [m, s].

    Attributes
    ----------
    density : float
        White noise [unit/sqrt(Hz)].
    sigma, tau_s : float
        Gauss-Markov instability [unit] and its correlation time [s].
    walk : float
        Random walk of the bias [unit/s/sqrt(Hz)].
    quantum : float
        Size of a count [unit s].
    """

    density: float
    sigma: float = 0.0
    tau_s: float = 1.0
    walk: float = 0.0
    quantum: float = 0.0


def gyro_terms(e: ImuErrors, axis: int) -> Terms:
    """Terms of one gyro [rad/s]."""
    return Terms(
        e.gyro_noise_density[axis],
        e.gyro_instability_sigma_dph * DPH,
        e.gyro_instability_tau_s,
        e.gyro_random_walk,
        e.gyro_quantum,
    )


def accel_terms(e: ImuErrors, axis: int) -> Terms:
    """Terms of one accelerometer [m/s^2]."""
    return Terms(
        e.accel_noise_density[axis],
        e.accel_instability_sigma_ug * MICRO_G,
        e.accel_instability_tau_s,
        e.accel_random_walk,
        e.accel_quantum,
    )


def deviation(terms: Terms, period_s: float, windows: NDArray[np.int64]) -> Floats:
    """Allan deviation at the averaging times m T.

    Parameters
    ----------
    terms : Terms
        One axis.
    period_s : float
        T [s].
    windows : ndarray of int, shape (n,)
        m.

    Returns
    -------
    ndarray, shape (n,)
        [unit of the axis].
    """
    m = np.asarray(windows, dtype=np.float64)
    K = [_covariance(terms, period_s, i * m) for i in range(3)]
    return np.sqrt(3.0 * K[0] - 4.0 * K[1] + K[2]) / (m * period_s)


def degrees_of_freedom(
    terms: Terms, period_s: float, windows: NDArray[np.int64], n: int
) -> Floats:
    """Equivalent degrees of freedom of the overlapping estimate from n samples, shape of windows.

    Raises
    ------
    ValueError
        Where a window is longer than half of the record.
    """
    if 2 * int(np.max(windows)) > n:
        raise ValueError(
            f'a window of {int(np.max(windows))} needs twice as many samples, not {n}'
        )
    return np.array([_degrees_of_freedom(terms, period_s, int(m), n) for m in windows])


def _degrees_of_freedom(terms: Terms, T: float, m: int, n: int) -> float:
    count = n - 2 * m + 1
    near = np.arange(min(2 * m, count - 1) + 1, dtype=np.float64)
    R = np.zeros_like(near)
    for weight, i in zip((1.0, -4.0, 6.0, -4.0, 1.0), (-2, -1, 0, 1, 2), strict=True):
        R += weight * _covariance(terms, T, np.abs(near + i * m))
    total = 2.0 * float((count - near) @ np.square(R)) - count * float(R[0]) ** 2
    if terms.sigma > 0.0 and count > 2 * m + 1:
        # Farther apart only the Gauss-Markov term is left, in closed form where sums would cancel.
        far = np.arange(2 * m + 1, count, dtype=np.float64)
        one = -math.expm1(-T / terms.tau_s)
        gain = (terms.sigma * T / one) ** 2 * math.expm1(-m * T / terms.tau_s) ** 4
        tail = gain * np.exp(-(far + 1.0 - 2.0 * m) * T / terms.tau_s)
        total += 2.0 * float((count - far) @ np.square(tail))
    return (count * float(R[0])) ** 2 / total


def _covariance(terms: Terms, T: float, lag: Floats) -> Floats:
    """K(l) for l >= 0."""
    K = -0.5 * terms.density**2 * T * lag
    if terms.sigma > 0.0:
        one = -math.expm1(-T / terms.tau_s)
        q = 1.0 - one
        sums = lag * one * (1.0 + q) + 2.0 * q * np.expm1(-lag * T / terms.tau_s)
        K = K - 0.5 * (terms.sigma * T / one) ** 2 * sums
    K = K + terms.walk**2 * T**3 * (lag**3 - lag) / 12.0
    return np.asarray(K + np.where(lag == 0.0, terms.quantum**2 / 12.0, 0.0))
