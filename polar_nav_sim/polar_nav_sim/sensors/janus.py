"""Four beams of a DVL: their directions, their least-squares velocity, their ranges.

Beam i points away from the instrument, downwards in its axes (x forward, y left, z up):

    b_i = (sin(angle) cos(az_i), sin(angle) sin(az_i), -cos(angle)),  az_i = azimuth + 90 deg i

Along it the instrument moves at b_i . v_m. Three or four good beams give v_m by least squares,

    v_m = (B' B)^-1 B' s,  covariance sigma^2 (B' B)^-1

with the rows b_i of good beams in B and the measured s. Over a flat floor, altitude h below the
instrument, the range along a beam is h / -(C_m_G b_i)_z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.engine.events import LEAST_BEAMS

Floats = NDArray[np.float64]

BEAMS = 4


@dataclass(frozen=True)
class BeamData:
    """Readings of the four beams; NaN for a lost beam or an unknown floor.

    Attributes
    ----------
    directions_m : ndarray, shape (4, 3)
        Instrument axes, unit length, away from the instrument.
    good : ndarray of bool, shape (4,)
    velocity : ndarray, shape (4,)
        Of the instrument over ground along the beams [m/s].
    velocity_variance : float
        Of each [(m/s)^2].
    range_m : ndarray, shape (4,)
        To the sea floor along the beams [m].
    range_variance : float
        Of each [m^2].
    """

    directions_m: Floats
    good: NDArray[np.bool_]
    velocity: Floats
    velocity_variance: float
    range_m: Floats
    range_variance: float


def directions(angle: float, azimuth: float) -> Floats:
    """Beam directions b_i, shape (4, 3).

    Parameters
    ----------
    angle : float
        Of every beam against the downward axis [rad].
    azimuth : float
        Of the first beam from x towards y [rad].
    """
    az = azimuth + 0.5 * np.pi * np.arange(BEAMS)
    level, down = np.sin(angle), np.cos(angle)
    return np.stack([level * np.cos(az), level * np.sin(az), np.full(BEAMS, -down)], axis=1)


def solve(b_m: Floats, along: Floats, good: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Velocity from the good beams by least squares, and its covariance for unit variance of each.

    Parameters
    ----------
    b_m : ndarray, shape (4, 3)
        Beam directions.
    along : ndarray, shape (4,)
        Velocities along them [m/s].
    good : ndarray of bool, shape (4,)
        Which beams count; at least three.

    Returns
    -------
    v_m : ndarray, shape (3,)
        [m/s].
    cofactor : ndarray, shape (3, 3)
        (B' B)^-1.

    Raises
    ------
    ValueError
        With fewer than three good beams.
    """
    if int(np.count_nonzero(good)) < LEAST_BEAMS:
        raise ValueError(f'{np.count_nonzero(good)} beams give no velocity: {LEAST_BEAMS} do')
    B = b_m[good]
    cofactor = np.asarray(np.linalg.inv(B.T @ B), dtype=np.float64)
    return np.asarray(cofactor @ B.T @ along[good]), cofactor


def slant_ranges(b_m: Floats, C_m_G: Floats, altitude: float) -> Floats:
    """Ranges to a flat floor, shape (4,) [m]; infinite for a beam that does not point down.

    Parameters
    ----------
    b_m : ndarray, shape (4, 3)
        Beam directions.
    C_m_G : ndarray, shape (3, 3)
        Instrument to grid.
    altitude : float
        Of the instrument above the floor [m]; NaN: unknown, the ranges are then NaN too.
    """
    down = -(b_m @ C_m_G[2])
    return np.where(down > 0.0, altitude / np.where(down > 0.0, down, 1.0), np.inf)
