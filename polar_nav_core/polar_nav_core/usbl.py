"""USBL: from array measurement to position (docs/derivations/measurements.md, 3).

The fix is the follower's position at t3, when its transponder replied, seen from the array's pose
at t4, when the reply was back. Leader and follower have different grid frames: relative vectors
travel in the leader's, positions are added in ECEF only. What the engine makes of a position is
`kernels.sins.rows.fix_rows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrices, vectors
from .attitude import skew
from .grid import ecef_to_grid

_ITERATIONS = 6


class Range(NamedTuple):
    """One-way distance from the array at t4 to the transponder at t3."""

    distance: float
    """[m]"""
    variance: float
    """[m^2]"""


class Relative(NamedTuple):
    """A vector [m] with its covariance; axes are those of the function that returns it."""

    vector: Array
    """Shape (3,) [m]."""
    covariance: Array
    """Shape (3, 3) [m^2]."""


def range_at_reply(
    half_path: float, half_path_variance: float, direction: ArrayLike, displacement: ArrayLike
) -> Range:
    """Distance from the array at t4 to the transponder, from the round trip of a moving array.

    The interrogation left at p(t1), the reply came back to p(t4): with the path L = |F - p(t1)| +
    |F - p(t4)|, the displacement D = p(t4) - p(t1) and the direction u from p(t4) to F, ``r = (L^2
    - D^2) / (2 (L + u.D))``. The transponder is taken as standing still between hearing and
    replying.

    Parameters
    ----------
    half_path : float
        L / 2 = sound speed (round trip - turn-around) / 2: what the instrument shows as range [m].
    half_path_variance : float
        [m^2]
    direction : array_like, shape (3,)
        Unit vector u.
    displacement : array_like, shape (3,)
        D, of the array, in the axes of *direction* [m].

    Returns
    -------
    Range

    Raises
    ------
    ValueError
        If the path is not longer than the displacement, so that no such triangle exists.
    """
    u = vectors(direction, 'direction')
    D = vectors(displacement, 'displacement')
    path = 2.0 * half_path
    moved = float(D @ D)
    if not path * path > moved:
        raise ValueError(
            f'half_path={half_path} m is too short for a displacement of {moved**0.5} m'
        )
    denominator = path + float(u @ D)
    distance = (path * path - moved) / (2.0 * denominator)
    slope = 2.0 * (path - distance) / denominator
    return Range(distance, slope * slope * half_path_variance)


def relative_in_array(
    direction_a: ArrayLike,
    cosine_covariance: ArrayLike,
    distance: float,
    distance_variance: float,
    up_a: ArrayLike | None = None,
    up_difference: float = 0.0,
    up_variance: float = 0.0,
) -> Relative:
    """Vector from the array to the transponder, array axes, by weighted least squares.

    Measured are the direction cosines on the array's x and y axes, the distance and, where known,
    the difference of heights. All four enter: the textbook's X = h c_x / sqrt(1 - c_x^2 - c_y^2)
    divides by zero at equal depths, the least squares is regular there and for any tilt of the
    array.

    Parameters
    ----------
    direction_a : array_like, shape (3,)
        Unit vector from array to transponder, array axes. A plane array measures x and y; the sign
        of z says on which side the transponder is.
    cosine_covariance : array_like, shape (2, 2)
        Of the x and y direction cosines.
    distance, distance_variance : float
        [m], [m^2], from `range_at_reply`.
    up_a : array_like, shape (3,), optional
        Up in array axes (third row of C_a_G). Without it the height difference is not used, and z
        is held by the direction's z with a standard deviation of the distance: a plane array knows
        no more of it.
    up_difference, up_variance : float
        Height of the transponder above the array [m] and its variance [m^2].

    Returns
    -------
    Relative

    Raises
    ------
    ValueError
        If the distance or a variance is not positive.
    """
    if not (distance > 0.0 and distance_variance > 0.0):
        raise ValueError(
            f'distance={distance} m and distance_variance={distance_variance} m^2 must be positive'
        )
    n = vectors(direction_a, 'direction_a')
    n = n / np.sqrt(n @ n)
    weights = np.zeros((4, 4))
    weights[:2, :2] = np.linalg.inv(np.asarray(cosine_covariance, np.float64).reshape(2, 2))
    weights[2, 2] = 1.0 / distance_variance
    if up_a is None:
        last = np.array([0.0, 0.0, 1.0])
        last_measured = distance * n[2]
        weights[3, 3] = 1.0 / distance**2
    else:
        if not up_variance > 0.0:
            raise ValueError(f'up_variance={up_variance} m^2 must be positive')
        last = vectors(up_a, 'up_a')
        last_measured = up_difference
        weights[3, 3] = 1.0 / up_variance
    measured = np.array([n[0], n[1], distance, last_measured])
    p = distance * n
    for _ in range(_ITERATIONS):
        r = float(np.sqrt(p @ p))
        unit = p / r
        J = np.vstack([(np.eye(3) - np.outer(unit, unit))[:2] / r, unit, last])
        residual = measured - np.array([unit[0], unit[1], r, last @ p])
        N = J.T @ weights @ J
        p = p + np.linalg.solve(N, J.T @ weights @ residual)
    covariance: Array = np.linalg.inv(N)
    return Relative(p, 0.5 * (covariance + covariance.T))


def relative_in_grid(
    relative_a: Relative,
    C_a_b: ArrayLike,
    lever_b: ArrayLike,
    C_b_G: ArrayLike,
    attitude_covariance_G: ArrayLike,
) -> Relative:
    """Vector from the leader's base_link at t4 to the transponder, leader's grid axes.

    Parameters
    ----------
    relative_a : Relative
        From `relative_in_array`.
    C_a_b : array_like, shape (3, 3)
        Array axes to body axes.
    lever_b : array_like, shape (3,)
        From base_link to the array, body axes [m].
    C_b_G : array_like, shape (3, 3)
        Attitude of the leader at t4.
    attitude_covariance_G : array_like, shape (3, 3)
        Of its error phi, grid axes [rad^2]. It turns lever arm and range together: [r x] P [r
        x]^T.

    Returns
    -------
    Relative
        The position of the leader is not in the covariance.
    """
    C = matrices(C_b_G, 'C_b_G')
    C_a_G = C @ matrices(C_a_b, 'C_a_b')
    r = C_a_G @ relative_a.vector + C @ vectors(lever_b, 'lever_b')
    S = skew(r)
    P = matrices(attitude_covariance_G, 'attitude_covariance_G')
    covariance = C_a_G @ relative_a.covariance @ C_a_G.T + S @ P @ S.T
    return Relative(r, 0.5 * (covariance + covariance.T))


def transponder_position(
    leader_r_e: ArrayLike, relative_G: Relative, leader_covariance_e: ArrayLike | None = None
) -> Relative:
    """Position of the transponder, ECEF, from the leader's at t4 and the relative vector.

    Parameters
    ----------
    leader_r_e : array_like, shape (3,)
        base_link of the leader at t4, ECEF [m].
    relative_G : Relative
        From `relative_in_grid`.
    leader_covariance_e : array_like, shape (3, 3), optional
        Of the leader's position, ECEF axes [m^2]; zero without it.

    Returns
    -------
    Relative
        Position (3,) [m] and covariance (3, 3) [m^2], ECEF.
    """
    leader = vectors(leader_r_e, 'leader_r_e')
    C_G_e = ecef_to_grid(leader).T
    covariance = C_G_e @ relative_G.covariance @ C_G_e.T
    if leader_covariance_e is not None:
        covariance = covariance + matrices(leader_covariance_e, 'leader_covariance_e')
    return Relative(leader + C_G_e @ relative_G.vector, covariance)
