"""Linear error model in matrices, and the retraction that all Jacobians refer to.

Derivation: docs/derivations/error_model.md; signs as in `polar_nav_core.error_model`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from polar_nav_core.arrays import Array, matrices, vectors
from polar_nav_core.attitude import exp
from polar_nav_core.error_model import X
from polar_nav_core.grid import require_regular
from polar_nav_core.kernels.sins.error_model import fill_system_matrix

SINS = slice(X.phi_G.start, X.b_accel_b.stop)
"""The first 15 states, those of `system_matrix`."""


class NoiseInput(NamedTuple):
    """Blocks of the white-noise vector that drives the error state. `W` is the instance to use."""

    gyro_b: slice = slice(0, 3)
    """Angular random walk, body axes [rad/s/sqrt(Hz)]."""
    accel_b: slice = slice(3, 6)
    """Velocity random walk, body axes [m/s^2/sqrt(Hz)]."""
    b_gyro_b: slice = slice(6, 9)
    """Drive of the gyro bias [rad/s^2/sqrt(Hz)]."""
    b_accel_b: slice = slice(9, 12)
    """Drive of the accelerometer bias [m/s^3/sqrt(Hz)]."""
    dvl_markov_m: slice = slice(12, 15)
    """Drive of the DVL Markov error [m/s^2/sqrt(Hz)]."""
    usbl_bias_a: slice = slice(15, 18)
    """Drive of the USBL error [m/s/sqrt(Hz)]."""

    @property
    def size(self) -> int:
        """Number of noise components."""
        return int(self[-1].stop)


W = NoiseInput()


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(frozen=True)
class Navigation:
    """What the filter estimates: navigation state and sensor errors, arrays (3,) and (3, 3)."""

    C_b_G: Array
    """Body to grid."""
    v_G: Array
    """Velocity over ground, grid axes [m/s]."""
    r_e: Array
    """Position, ECEF [m]."""
    b_gyro_b: Array = field(default_factory=_zeros)
    """Estimated gyro bias, taken off the measured rate [rad/s]."""
    b_accel_b: Array = field(default_factory=_zeros)
    """Estimated accelerometer bias [m/s^2]."""
    dvl_scale_m: Array = field(default_factory=_zeros)
    """Estimated relative scale error per DVL axis [-]."""
    dvl_markov_m: Array = field(default_factory=_zeros)
    """Estimated slowly varying DVL velocity error [m/s]."""
    usbl_bias_a: Array = field(default_factory=_zeros)
    """Estimated USBL error, array axes [m]."""

    def corrected(self, x: ArrayLike) -> Navigation:
        """Navigation less the error vector x, (24,): what `kernels.sins.update.feed_back` does."""
        error = np.asarray(x, np.float64)
        return replace(
            self,
            C_b_G=exp(error[X.phi_G]) @ self.C_b_G,
            v_G=self.v_G - error[X.dv_G],
            r_e=self.r_e - error[X.dr_e],
            b_gyro_b=self.b_gyro_b + error[X.b_gyro_b],
            b_accel_b=self.b_accel_b + error[X.b_accel_b],
            dvl_scale_m=self.dvl_scale_m + error[X.dvl_scale_m],
            dvl_markov_m=self.dvl_markov_m + error[X.dvl_markov_m],
            usbl_bias_a=self.usbl_bias_a + error[X.usbl_bias_a],
        )


def system_matrix(r_e: ArrayLike, v_G: ArrayLike, C_b_G: ArrayLike, f_b: ArrayLike) -> Array:
    """Exact linear error model of the grid strapdown, gravity gradient included.

    Parameters
    ----------
    r_e : array_like, shape (3,)
        Position, ECEF [m].
    v_G : array_like, shape (3,)
        Velocity over ground, grid axes [m/s].
    C_b_G : array_like, shape (3, 3)
        Body to grid.
    f_b : array_like, shape (3,)
        Specific force, body axes [m/s^2].

    Returns
    -------
    ndarray, shape (15, 15)
        In the order phi_G, dv_G, dr_e, gyro bias, accelerometer bias; bias rows are zero.

    Raises
    ------
    ValueError
        On the equator at longitude +-90 degrees, where the grid frame is undefined.
    """
    arguments = {
        'r_e': require_regular(r_e),
        'v_G': vectors(v_G, 'v_G'),
        'f_b': vectors(f_b, 'f_b'),
        'C_b_G': matrices(C_b_G, 'C_b_G'),
    }
    for name, value in arguments.items():
        if value.ndim != (2 if name == 'C_b_G' else 1):
            raise ValueError(f'{name} must be a single one, not of shape {value.shape}')
    F15 = np.empty((15, 15))
    fill_system_matrix(
        F15,
        arguments['r_e'].copy(),
        arguments['v_G'].copy(),
        arguments['C_b_G'].copy(),
        arguments['f_b'].copy(),
    )
    return F15


def full_system_matrix(
    F15: ArrayLike,
    tau_dvl: float,
    tau_gyro: float = np.inf,
    tau_accel: float = np.inf,
    tau_usbl: float = np.inf,
) -> Array:
    """The 24-state matrix: F15 and first-order Gauss-Markov decay of the sensor errors.

    Parameters
    ----------
    F15 : array_like, shape (15, 15)
        From `system_matrix`.
    tau_dvl, tau_gyro, tau_accel, tau_usbl : float
        Correlation times [s]; inf: constant.

    Returns
    -------
    ndarray, shape (24, 24)
    """
    A = np.zeros((X.size, X.size))
    A[SINS, SINS] = F15
    for block, tau in (
        (X.b_gyro_b, tau_gyro),
        (X.b_accel_b, tau_accel),
        (X.dvl_markov_m, tau_dvl),
        (X.usbl_bias_a, tau_usbl),
    ):
        if not tau > 0.0:
            raise ValueError(f'a correlation time must be positive, not {tau}')
        A[block, block] = -np.eye(3) / tau
    return A


def transition(A: ArrayLike, dt: float) -> Array:
    """Phi = I + A dt + (A dt)^2 / 2 over a step of dt [s]. (n, n) -> (n, n)."""
    M = np.asarray(A, np.float64) * dt
    result: Array = np.eye(len(M)) + M + 0.5 * M @ M
    return result


def noise_input(C_b_G: ArrayLike) -> Array:
    """B: takes the white noise of `NoiseInput` to rates of the error state. (3, 3) -> (24, 18)."""
    C = matrices(C_b_G, 'C_b_G')
    B = np.zeros((X.size, W.size))
    B[X.phi_G, W.gyro_b] = -C
    B[X.dv_G, W.accel_b] = C
    for name in ('b_gyro_b', 'b_accel_b', 'dvl_markov_m', 'usbl_bias_a'):
        B[getattr(X, name), getattr(W, name)] = np.eye(3)
    return B


def markov_density(sigma: float, tau: float) -> float:
    """Noise density that keeps a Gauss-Markov process at sigma: sqrt(2 sigma^2 / tau)."""
    return float(np.sqrt(2.0 * sigma * sigma / tau))


def process_noise(Phi: ArrayLike, B: ArrayLike, density: ArrayLike, dt: float) -> Array:
    """Covariance of the error that white noise adds in a step: dt/2 (Phi B q B^T Phi^T + B q B^T).

    Parameters
    ----------
    Phi : array_like, shape (24, 24)
    B : array_like, shape (24, 18)
        From `noise_input`.
    density : array_like, shape (18,)
        Square roots of the spectral densities, in the units of `NoiseInput`.
    dt : float
        Step [s].

    Returns
    -------
    ndarray, shape (24, 24)
    """
    G = np.asarray(B, np.float64) * np.asarray(density, np.float64)
    M = np.asarray(Phi, np.float64) @ G
    result: Array = 0.5 * dt * (M @ M.T + G @ G.T)
    return result
