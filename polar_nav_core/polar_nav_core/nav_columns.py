"""Quantities derived from state and covariance for nav/state, one row of numbers per state.

Geodetic position, angles, quaternion, covariance blocks in grid axes and standard deviations.
Compiled in `kernels.sins.columns`; the live node and a replay from arrays both use these.
"""

from __future__ import annotations

import numpy as np

from .arrays import Array
from .grid import refuse_singular, require_regular
from .kernels.sins import columns as _kernels

COLUMNS = {
    'latitude': _kernels.LATITUDE,
    'longitude': _kernels.LONGITUDE,
    'height': _kernels.HEIGHT,
    'roll': _kernels.ROLL,
    'pitch': _kernels.PITCH,
    'grid_heading': _kernels.GRID_HEADING,
    'true_heading': _kernels.TRUE_HEADING,
    'true_heading_sigma': _kernels.TRUE_HEADING_SIGMA,
    'convergence': _kernels.CONVERGENCE,
}
"""Places of single numbers in a row, by their names in nav/state; angles in radians.

Longitude is NaN at a pole, true heading and convergence where nothing is known of them.
"""
QUATERNION = slice(_kernels.QUATERNION, _kernels.QUATERNION + 4)
"""Of C_b_G: x, y, z, w, with w >= 0."""
POSITION_COVARIANCE_G = slice(_kernels.POSITION_COVARIANCE, _kernels.POSITION_COVARIANCE + 9)
"""C_e_G P_e C_e_G', by rows [m^2]."""
VELOCITY_COVARIANCE_G = slice(_kernels.VELOCITY_COVARIANCE, _kernels.VELOCITY_COVARIANCE + 9)
ATTITUDE_COVARIANCE_G = slice(_kernels.ATTITUDE_COVARIANCE, _kernels.ATTITUDE_COVARIANCE + 9)
"""Of v_G and of phi_G, by rows [m^2/s^2], [rad^2]."""
SIGMA = slice(_kernels.SIGMA, _kernels.SIGMA + 24)
"""Standard deviations of the error state, in its order (`error_model.X`)."""
WIDTH = _kernels.WIDTH


def describe(r_e: Array, C_b_G: Array, P: Array) -> Array:
    """Derived quantities (n, `WIDTH`) of n states.

    Parameters
    ----------
    r_e : (n, 3) array
        Position, ECEF [m].
    C_b_G : (n, 3, 3) array
    P : (n, 24, 24) array
        Covariance of the error state.

    Returns
    -------
    (n, WIDTH) array

    Raises
    ------
    ValueError
        On the equator at longitude +-90 degrees, where there is no grid north.
    """
    rows = np.empty((len(r_e), WIDTH))
    _kernels.describe_many(
        require_regular(r_e),
        np.ascontiguousarray(C_b_G),
        np.ascontiguousarray(P),
        rows,
        np.empty((2, 3, 3)),
    )
    return rows


def require_axes(rows: Array) -> None:
    """Raise ValueError if a row is of a place without grid north."""
    refuse_singular(rows[:, _kernels.DELTA])


def rotations(xyzw: Array) -> Array:
    """Rotation matrices (n, 3, 3) of quaternions x, y, z, w (n, 4).

    Rounding of the quaternion does not scale the matrix. A zero quaternion gives NaN: the message
    said nothing.
    """
    C = np.empty((len(xyzw), 3, 3))
    _kernels.rotations_many(np.ascontiguousarray(xyzw, dtype=np.float64), C)
    return C


def warm_up() -> None:
    """Compile or load the kernels."""
    C = np.eye(3)[None]
    describe(np.array([[0.0, 0.0, 6.36e6]]), C, np.eye(24)[None])
    rotations(np.array([[0.0, 0.0, 0.0, 1.0]]))
