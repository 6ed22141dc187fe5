"""Strapdown navigation in the grid frame: a small object over `kernels.frames`."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrices, vectors
from .earth import gravity
from .grid import require_regular
from .kernels.frames import blocks as _blocks
from .kernels.frames import strapdown as _kernels
from .kernels.sins import error_model as _error_model


def increments(
    omega_ib_b: ArrayLike, f_b: ArrayLike, dt: float, sample: Literal['mean', 'instant'] = 'mean'
) -> tuple[Array, Array]:
    """Increments of angle and velocity from a uniform series of rates and specific forces.

    Parameters
    ----------
    omega_ib_b, f_b : array_like, shape (n, 3)
        Angular rate [rad/s] and specific force [m/s^2], body axes.
    dt : float
        Sampling interval [s].
    sample : {'mean', 'instant'}
        ``mean``: row k is the mean over the interval that ends at its stamp, and n increments come
        out. ``instant``: row k is the value at its stamp; the trapezoid between neighbours gives n
        - 1 increments, the first of which ends at the stamp of row 1.

    Returns
    -------
    dtheta_b, dvel_b : ndarray, shape (n, 3) or (n - 1, 3)
        [rad], [m/s].
    """
    rate = vectors(omega_ib_b, 'omega_ib_b')
    force = vectors(f_b, 'f_b')
    if rate.ndim != 2 or rate.shape != force.shape:
        raise ValueError(
            f'omega_ib_b and f_b must have one shape (n, 3), not {rate.shape} and {force.shape}'
        )
    if sample == 'mean':
        return rate * dt, force * dt
    if sample == 'instant':
        return 0.5 * dt * (rate[1:] + rate[:-1]), 0.5 * dt * (force[1:] + force[:-1])
    raise ValueError(f"sample must be 'mean' or 'instant', not {sample!r}")


class Strapdown:
    """Attitude, velocity and position of a vehicle, carried forward by IMU increments.

    Parameters
    ----------
    C_b_G : array_like, shape (3, 3)
        Body to grid; orthonormal within 1e-6.
    v_G : array_like, shape (3,)
        Velocity over ground, grid axes [m/s].
    r_e : array_like, shape (3,)
        Position, ECEF [m].

    Raises
    ------
    ValueError
        If an argument is not finite or of another shape, C_b_G is not a rotation, or r_e is one of
        the two places where the grid frame is undefined.
    """

    C_b_G: Array
    v_G: Array
    r_e: Array

    def __init__(self, C_b_G: ArrayLike, v_G: ArrayLike, r_e: ArrayLike) -> None:
        self.C_b_G = matrices(C_b_G, 'C_b_G').copy()
        self.v_G = vectors(v_G, 'v_G').copy()
        self.r_e = require_regular(r_e).copy()
        for name in ('C_b_G', 'v_G', 'r_e'):
            value = getattr(self, name)
            if value.shape not in ((3,), (3, 3)) or not np.all(np.isfinite(value)):
                raise ValueError(f'{name} must be one finite vector or matrix, not {value!r}')
        error = float(np.max(np.abs(self.C_b_G @ self.C_b_G.T - np.eye(3))))
        if error > 1e-6 or np.linalg.det(self.C_b_G) < 0.0:
            raise ValueError(
                f'C_b_G is not a rotation: |C C^T - I| = {error:.3g} > 1e-06 or det < 0'
            )
        self._dtheta_prev_b = np.zeros(3)
        self._dvel_prev_b = np.zeros(3)
        self._dt_prev = 0.0

    def step(self, dtheta_b: ArrayLike, dvel_b: ArrayLike, dt: float) -> None:
        """Advance over one interval, of any length.

        Parameters
        ----------
        dtheta_b, dvel_b : array_like, shape (3,)
            Integrals of omega_ib_b [rad] and f_b [m/s] over the interval, body axes.
        dt : float
            Length of the interval [s], positive.
        """
        if not dt > 0.0:
            raise ValueError(f'dt must be positive, not {dt}')
        angle = vectors(dtheta_b, 'dtheta_b')
        velocity = vectors(dvel_b, 'dvel_b')
        if angle.shape != (3,) or velocity.shape != (3,):
            raise ValueError(
                f'dtheta_b and dvel_b must have shape (3,), not {angle.shape} and {velocity.shape}'
            )
        _kernels.strapdown_step_uneven(
            self.C_b_G,
            self.v_G,
            self.r_e,
            angle.copy(),
            velocity.copy(),
            self._dtheta_prev_b,
            self._dvel_prev_b,
            float(dt),
            self._dt_prev,
        )
        self._dtheta_prev_b[:] = angle
        self._dvel_prev_b[:] = velocity
        self._dt_prev = float(dt)

    def run(self, dtheta_b: ArrayLike, dvel_b: ArrayLike, dt: float, block: int = 1) -> None:
        """Advance over n intervals of one length.

        Parameters
        ----------
        dtheta_b, dvel_b : array_like, shape (n, 3)
            Increments, as for `step`.
        dt : float
            Length of each interval [s]. If it differs from that of the interval before, the first
            increments go through `step`.
        block : int
            Samples per evaluation of the navigation rates; 10 at 100 Hz is four times as fast as 1
            and as good.
        """
        angles = vectors(dtheta_b, 'dtheta_b')
        velocities = vectors(dvel_b, 'dvel_b')
        if angles.ndim != 2 or angles.shape != velocities.shape:
            raise ValueError(
                'dtheta_b and dvel_b must have one shape (n, 3), '
                f'not {angles.shape} and {velocities.shape}'
            )
        if block < 1:
            raise ValueError(f'block must be at least 1, not {block}')
        if len(angles) and self._dt_prev != dt:
            self.step(angles[0], velocities[0], dt)
            angles = angles[1:]
            velocities = velocities[1:]
        _blocks.strapdown_blocks(
            self.C_b_G,
            self.v_G,
            self.r_e,
            angles,
            velocities,
            self._dtheta_prev_b,
            self._dvel_prev_b,
            float(dt),
            int(block),
        )

    def hold_vertical(self, height: float, v_up: float = 0.0) -> None:
        """Set height above the ellipsoid [m] and vertical velocity [m/s], as known from depth."""
        _kernels.hold_vertical(self.v_G, self.r_e, float(height), float(v_up))


def warm_up() -> None:
    """Compile or load the kernels used here, so that no first call takes seconds."""
    C_b_G = np.eye(3)
    v_G = np.zeros(3)
    r_e = np.array([0.0, 0.0, 6356752.0])
    zero = np.zeros(3)
    rows = np.zeros((1, 3))
    _kernels.strapdown_step(C_b_G, v_G, r_e, zero, zero, zero, zero, 0.01)
    _kernels.strapdown_step_uneven(C_b_G, v_G, r_e, zero, zero, zero, zero, 0.01, 0.0)
    _blocks.strapdown_blocks(C_b_G, v_G, r_e, rows, rows, zero, zero, 0.01, 1)
    _kernels.hold_vertical(v_G, r_e, 0.0, 0.0)
    gravity(r_e)
    # Only benchmarks and tests run these; a node takes the cache for whole when it has all.
    _kernels.strapdown_batch(C_b_G, v_G, r_e, rows, rows, zero, zero, 0.01)
    heights = np.zeros(1)
    _kernels.strapdown_batch_held(C_b_G, v_G, r_e, rows, rows, zero, zero, 0.01, heights, heights)
    _error_model.fill_system_matrix(np.empty((15, 15)), r_e, v_G, C_b_G, zero)
