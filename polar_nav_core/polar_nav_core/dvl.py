"""Correction of Doppler velocities for the sound speed that the instrument assumed.

A Doppler shift is 2 f v / c: an instrument that divides by its own c_i measures (c_i / c) v. A
phased array steers its beams by c, too, so that its horizontal velocity does not depend on it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array

SOUND_SPEED_LIMITS = (1300.0, 1700.0)
"""Sound speeds of water, sea and lakes [m/s]; any other number stands for unknown."""


def sound_speed_factors(instrument: ArrayLike, water: float, phased: ArrayLike = False) -> Array:
    """Factors that correct velocities of a DVL, per axis of the instrument: c / c_i, (..., 3).

    Parameters
    ----------
    instrument : array_like
        Sound speed c_i that the instrument assumed [m/s].
    water : float
        Sound speed c at the vehicle [m/s]. Where one of both is outside of `SOUND_SPEED_LIMITS`
        (0 and NaN are) it is unknown, and the factors are 1.
    phased : array_like of bool
        Phased array: x and y stay as they are.
    """
    least, most = SOUND_SPEED_LIMITS
    assumed = np.asarray(instrument, dtype=np.float64)
    known = (assumed >= least) & (assumed <= most) & (least <= water <= most)
    ratio = np.where(known, water / np.where(known, assumed, 1.0), 1.0)
    level = np.where(phased, 1.0, ratio)
    return np.stack([level, level, ratio], axis=-1)


def corrected(v_m: Array, covariance_m: Array, factors: Array) -> tuple[Array, Array]:
    """Velocities (..., 3) and their covariances (..., 3, 3), times the factors of their axes."""
    if not np.any(factors != 1.0):
        return v_m, covariance_m
    with np.errstate(over='ignore'):
        square = factors[..., :, None] * factors[..., None, :]
        return v_m * factors, covariance_m * square
