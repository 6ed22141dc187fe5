"""Heading from the direction of the Earth's rate, with its sigma; refused where that is large.

``sigma = hypot(bias / (Omega cos L), v_sigma / (Omega R cos L))``: near a pole little of the
Earth's rate is horizontal. To the bias come the noise of the mean, and the tilt, through which the
vertical part of the rate leaks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...attitude import matrix_from_euler
from ...earth import OMEGA_IE, SEMI_MAJOR
from .level import Tilt
from .model import MOST_HEADING

UNKNOWN_SPEED = 1.0
"""1-sigma of the speed of a body that seems to rest, where nothing measures it [m/s]."""
_PER_HOUR = math.radians(1.0) / 3600.0
_REST = 4.0


class Gyrocompass(NamedTuple):
    """True heading of a body at rest.

    Attributes
    ----------
    heading : float
        Clockwise from true north [rad].
    sigma : float
        1-sigma [rad].
    refusal : str
        Sentence on why it cannot be used; empty if it can.
    """

    heading: float
    sigma: float
    refusal: str


def sigma_of(
    latitude: float, rate_sigma: float, v_sigma: float = 0.0, tilt_sigma: float = 0.0
) -> float:
    """1-sigma of a gyrocompass [rad], from 0 up.

    Parameters
    ----------
    latitude : float
        [rad]
    rate_sigma : float
        Of the horizontal rate, per axis: bias and noise [rad/s].
    v_sigma : float
        Of the velocity over ground, per axis [m/s].
    tilt_sigma : float
        Of roll and pitch [rad].
    """
    horizontal = OMEGA_IE * math.cos(latitude)
    vertical = OMEGA_IE * abs(math.sin(latitude))
    error = math.hypot(rate_sigma, v_sigma / SEMI_MAJOR, vertical * tilt_sigma)
    return error / horizontal if horizontal > 0.0 else math.inf


def gyrocompass(
    omega_b: Array,
    tilt: Tilt,
    latitude: float,
    *,
    bias: float,
    noise: float,
    tilt_sigma: float,
    v_b: Array | None = None,
    v_sigma: float = UNKNOWN_SPEED,
) -> Gyrocompass:
    """Heading from a mean rate at rest, or at a steady velocity.

    Parameters
    ----------
    omega_b : (3,) array
        Mean rate, body axes [rad/s].
    tilt : Tilt
    latitude : float
        [rad]
    bias, noise : float
        1-sigma per axis of the gyros' bias, and of what else is in the mean [rad/s].
    tilt_sigma : float
        [rad]
    v_b : (3,) array, optional
        Velocity over ground, body axes [m/s]; none is rest.
    v_sigma : float
        1-sigma per axis [m/s].
    """
    C_b_level = matrix_from_euler(0.0, tilt.pitch, tilt.roll)
    level = C_b_level @ omega_b
    if v_b is not None:
        v = C_b_level @ v_b
        level = level - np.array([-v[1], v[0], 0.0]) / SEMI_MAJOR
    rate_sigma = math.hypot(bias, noise)
    sigma = sigma_of(latitude, rate_sigma, v_sigma, tilt_sigma)
    heading = math.atan2(level[1], level[0])
    excess = abs(float(np.linalg.norm(level)) - OMEGA_IE)
    if sigma > MOST_HEADING:
        return Gyrocompass(heading, sigma, too_weak(latitude, bias, sigma))
    if excess > _REST * math.hypot(rate_sigma, v_sigma / SEMI_MAJOR):
        return Gyrocompass(
            heading,
            sigma,
            f'the gyros turn by {excess / _PER_HOUR:.2g} deg/h more or less than the Earth: '
            f'the vehicle is not at rest, or gyro_bias_sigma ({bias / _PER_HOUR:.2g} deg/h) is '
            'too small',
        )
    return Gyrocompass(heading, sigma, '')


def too_weak(latitude: float, bias: float, sigma: float) -> str:
    """Sentence on a gyrocompass beyond the limit: the gyros, or the latitude, that would do."""
    at = math.degrees(latitude)
    needed = MOST_HEADING * OMEGA_IE * math.cos(latitude) / _PER_HOUR
    cosine = bias / (MOST_HEADING * OMEGA_IE)
    lower = (
        f'; below {math.degrees(math.acos(cosine)):.1f} deg these would do'
        if cosine < 1.0
        else '; at no latitude would these do'
    )
    return (
        f'a gyrocompass of these gyros ({bias / _PER_HOUR:.2g} deg/h) is good to '
        f'{min(math.degrees(sigma), 180.0):.2g} deg at latitude {at:.1f} deg, the limit is '
        f'{math.degrees(MOST_HEADING):g} deg: gyros of {needed:.2g} deg/h would do here{lower}'
    )
