"""Errors of an estimate in the follower's grid axes, with the filter's sigmas.

Signs (docs/frames.md): estimate minus truth. Attitude: Chat_b_G = exp(-[phi_G x]) C_b_G; velocity
dv_G = vhat_G - v_G as components; position dr_G = C_e_G (rhat_e - r_e) with the grid axes at the
true position. Along track is the direction of the true horizontal velocity, cross track 90 degrees
to its left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.attitude import grid_heading, log
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.grid import convergence, ecef_to_grid

from .align import Alignment

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MIN_SPEED = 0.05  # [m/s]; a track has no direction below it
ARCMIN = 180.0 * 60.0 / np.pi  # per radian


@dataclass(frozen=True, eq=False)
class ErrorSeries:
    """Errors of n estimates, SI and radians, NaN where the estimate was not finite."""

    stamp_ns: Ints  # shape (n,)
    phi_G: Floats  # shape (n, 3) [rad]
    dv_G: Floats  # shape (n, 3) [m/s]
    dr_G: Floats  # shape (n, 3) [m]
    along: Floats  # shape (n,) [m]; negative: the estimate lags; NaN below MIN_SPEED
    cross: Floats  # shape (n,) [m]; to the left
    grid_heading: Floats  # shape (n,) [rad], clockwise positive, in (-pi, pi]
    true_heading: Floats  # shape (n,) [rad]; NaN where the filter gave none
    P_attitude_G: Floats  # shape (n, 3, 3) [rad^2]
    P_velocity_G: Floats  # shape (n, 3, 3) [(m/s)^2]
    P_position_G: Floats  # shape (n, 3, 3) [m^2]
    true_heading_sigma: Floats  # shape (n,) [rad]

    @property
    def horizontal(self) -> Floats:
        """Horizontal distance between estimate and truth [m], shape (n,)."""
        return np.hypot(self.dr_G[:, 0], self.dr_G[:, 1])

    @property
    def sigma_attitude_G(self) -> Floats:
        """Square root of the diagonal [rad], shape (n, 3); NaN where a variance is negative."""
        return spilled.by_rows(_sigma, self.P_attitude_G)

    @property
    def sigma_velocity_G(self) -> Floats:
        """Square root of the diagonal [m/s], shape (n, 3); NaN where a variance is negative."""
        return spilled.by_rows(_sigma, self.P_velocity_G)

    @property
    def sigma_position_G(self) -> Floats:
        """Square root of the diagonal [m], shape (n, 3); NaN where a variance is negative."""
        return spilled.by_rows(_sigma, self.P_position_G)

    def time(self, origin_ns: int) -> Floats:
        """Seconds since `origin_ns`, shape (n,)."""
        return np.asarray((self.stamp_ns - origin_ns) * 1e-9, dtype=np.float64)


@np.errstate(over='ignore', invalid='ignore')  # a damaged message can hold any number
def errors(pairs: Alignment) -> ErrorSeries:
    """Errors, estimate minus truth, of all pairs."""
    truth, estimate, by_rows = pairs.truth, pairs.estimate, spilled.by_rows
    dr_G = by_rows(_dr_G, truth.r_e, estimate.r_e)
    along, cross = by_rows(_along_and_cross, truth.v_G, dr_G).T
    return ErrorSeries(
        stamp_ns=truth.stamp_ns,
        phi_G=by_rows(_phi_G, truth.C_b_G, estimate.C_b_G),
        dv_G=by_rows(np.subtract, estimate.v_G, truth.v_G),
        dr_G=dr_G,
        along=along,
        cross=cross,
        grid_heading=by_rows(_grid_heading, truth.C_b_G, estimate.C_b_G),
        true_heading=by_rows(_true_heading, truth.r_e, truth.C_b_G, estimate.true_heading),
        P_attitude_G=estimate.P_attitude_G,
        P_velocity_G=estimate.P_velocity_G,
        P_position_G=estimate.P_position_G,
        true_heading_sigma=estimate.true_heading_sigma,
    )


def _dr_G(truth_r_e: Floats, r_e: Floats) -> Floats:
    return np.asarray(np.einsum('nij,nj->ni', ecef_to_grid(truth_r_e), r_e - truth_r_e))


def _phi_G(truth_C_b_G: Floats, C_b_G: Floats) -> Floats:
    # Chat C' = exp(-[phi x]).
    return np.asarray(-log(C_b_G @ np.swapaxes(truth_C_b_G, 1, 2)))


def _along_and_cross(truth_v_G: Floats, dr_G: Floats) -> Floats:
    """Parts of the error along and across the track, shape (n, 2)."""
    speed = np.hypot(truth_v_G[:, 0], truth_v_G[:, 1])
    moving = speed >= MIN_SPEED
    safe = np.where(moving, speed, 1.0)
    t_x = np.where(moving, truth_v_G[:, 0] / safe, np.nan)
    t_y = np.where(moving, truth_v_G[:, 1] / safe, np.nan)
    along = dr_G[:, 0] * t_x + dr_G[:, 1] * t_y
    cross = dr_G[:, 1] * t_x - dr_G[:, 0] * t_y
    return np.stack([along, cross], axis=1)


def _grid_heading(truth_C_b_G: Floats, C_b_G: Floats) -> Floats:
    return wrapped(grid_heading(C_b_G) - grid_heading(truth_C_b_G))


def _true_heading(truth_r_e: Floats, truth_C_b_G: Floats, heading: Floats) -> Floats:
    latitude, longitude, _ = geodetic_from_ecef(truth_r_e)
    return wrapped(heading - grid_heading(truth_C_b_G) - convergence(latitude, longitude))


def wrapped(angle: Floats) -> Floats:
    """Angle in (-pi, pi] [rad]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def distance_travelled(r_e: Floats) -> float:
    """Distance travelled through positions [m], summed over chords."""
    return float(np.linalg.norm(np.diff(r_e, axis=0), axis=1).sum())


def _sigma(P: Floats) -> Floats:
    variance = np.diagonal(P, axis1=1, axis2=2)
    return np.sqrt(np.where(variance >= 0.0, variance, np.nan))
