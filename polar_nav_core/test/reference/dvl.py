"""DVL: velocity over ground against the strapdown (docs/derivations/measurements.md, 1).

The instrument (frame m) sits at `Mounting.lever_b` from base_link, turned by `Mounting.C_m_b`, and
shows ``v_m = (1 + K) C_b_m (C_G_b v_G + omega_eb_b x lever_b) + dV + noise`` with the scale error
K per axis and the slowly varying error dV. The innovation is taken in grid axes, where the
measurement has to be resolved with the *estimated* attitude: that is the block -[V x] on phi which
makes heading observable.

The readable form of `kernels.sins.rows.dvl_rows`, which the engine runs.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from polar_nav_core.arrays import Array, matrices, vectors
from polar_nav_core.attitude import skew
from polar_nav_core.error_model import X

from .error_model import Navigation


@dataclass(frozen=True)
class Mounting:
    """Where an instrument sits on the vehicle."""

    C_m_b: Array = field(default_factory=lambda: np.eye(3))
    """Instrument axes to body axes."""
    lever_b: Array = field(default_factory=lambda: np.zeros(3))
    """From base_link to the instrument, body axes [m]."""


def measured(
    navigation: Navigation, omega_ib_b: ArrayLike, omega_ie_G: ArrayLike, mounting: Mounting
) -> Array:
    """Velocity that the DVL shows for a given state: the forward model.

    Parameters
    ----------
    navigation : Navigation
        State and sensor errors; the gyro bias is taken off omega_ib_b.
    omega_ib_b : array_like, shape (3,)
        Angular rate, body axes [rad/s].
    omega_ie_G : array_like, shape (3,)
        Earth rate, grid axes [rad/s].
    mounting : Mounting

    Returns
    -------
    ndarray, shape (3,)
        v_m [m/s].
    """
    C_G_b = navigation.C_b_G.T
    omega_eb_b = (
        vectors(omega_ib_b, 'omega_ib_b')
        - navigation.b_gyro_b
        - C_G_b @ vectors(omega_ie_G, 'omega_ie_G')
    )
    v_b = C_G_b @ navigation.v_G + skew(omega_eb_b) @ mounting.lever_b
    result: Array = (1.0 + navigation.dvl_scale_m) * (
        mounting.C_m_b.T @ v_b
    ) + navigation.dvl_markov_m
    return result


def innovation(
    navigation: Navigation,
    v_m: ArrayLike,
    omega_ib_b: ArrayLike,
    omega_ie_G: ArrayLike,
    mounting: Mounting,
) -> Array:
    """Estimate minus measurement of the velocity, grid axes [m/s]; arguments as `measured`."""
    corrected_m = (vectors(v_m, 'v_m') - navigation.dvl_markov_m) / (1.0 + navigation.dvl_scale_m)
    rate_b = vectors(omega_ib_b, 'omega_ib_b') - navigation.b_gyro_b
    turning_b = skew(rate_b) @ mounting.lever_b
    lever_G = navigation.C_b_G @ mounting.lever_b
    by_dvl_G = (
        navigation.C_b_G @ (mounting.C_m_b @ corrected_m - turning_b)
        + skew(vectors(omega_ie_G, 'omega_ie_G')) @ lever_G
    )
    result: Array = navigation.v_G - by_dvl_G
    return result


def jacobian(
    navigation: Navigation,
    v_m: ArrayLike,
    omega_ib_b: ArrayLike,
    omega_ie_G: ArrayLike,
    mounting: Mounting,
) -> Array:
    """H, shape (3, 24): innovation = H x for the error vector x of `error_model.X`.

    The scale error's block is taken at the predicted velocity: at the measured one, the noise of a
    ping would stand in its own H, and the estimated scale would creep (measurements.md, 1).
    """
    C = navigation.C_b_G
    gain = 1.0 / (1.0 + navigation.dvl_scale_m)
    corrected_m = (vectors(v_m, 'v_m') - navigation.dvl_markov_m) * gain
    rate_b = vectors(omega_ib_b, 'omega_ib_b') - navigation.b_gyro_b
    C_m_G = C @ mounting.C_m_b
    turned_G = C_m_G @ corrected_m - C @ skew(rate_b) @ mounting.lever_b
    H = np.zeros((3, X.size))
    # [V x] on phi, V being the measured velocity; the second term is the earth's part of the lever
    # arm.
    H[:, X.phi_G] = -skew(turned_G) - skew(omega_ie_G) @ skew(C @ mounting.lever_b)
    H[:, X.dv_G] = np.eye(3)
    H[:, X.b_gyro_b] = -C @ skew(mounting.lever_b)
    predicted = measured(navigation, omega_ib_b, omega_ie_G, mounting)
    predicted_m = (predicted - navigation.dvl_markov_m) * gain
    H[:, X.dvl_scale_m] = -C_m_G * (predicted_m * gain)
    H[:, X.dvl_markov_m] = -C_m_G * gain
    return H


def covariance(navigation: Navigation, R_m: ArrayLike, mounting: Mounting) -> Array:
    """Covariance of the instrument, (3, 3) in its axes [(m/s)^2], taken to grid axes."""
    C_m_G = (navigation.C_b_G @ mounting.C_m_b) / (1.0 + navigation.dvl_scale_m)
    result: Array = C_m_G @ matrices(R_m, 'R_m') @ C_m_G.T
    return result
