"""One IMU sample through the strapdown, and the means to linearize the covariance step at.

Derivation: docs/derivations/grid.md, section 4.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel
from ..frames.earth import OMEGA_IE, up_and_height
from ..frames.grid import fill_C_e_G
from ..frames.navigation import surroundings
from ..frames.strapdown import strapdown_step_held


@entry
@kernel
def hold_surroundings(held: Array, v_G: Array, r_e: Array, span: float) -> None:
    """Fill the `surroundings` for all samples of the next ``span`` [s], taken at its middle.

    Over a filter step of 0.1 s at 3 m/s gravity changes by less than 1e-6 m/s^2 and the grid axes
    turn by 5e-8 rad, which the middle halves and balances: as in blocks (`frames.blocks`).
    """
    u_x, u_y, u_z, inv_d, k_EE, k_EN, k_NN, g = surroundings(v_G, r_e, 0.5 * span)
    held[0] = u_x
    held[1] = u_y
    held[2] = u_z
    held[3] = inv_d
    held[4] = k_EE
    held[5] = k_EN
    held[6] = k_NN
    held[7] = g


@entry
@kernel
def imu_step(
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    b_gyro_b: Array,
    b_accel_b: Array,
    omega_ib_b: Array,
    f_b: Array,
    increments: Array,
    dt: float,
    dt_prev: float,
    sums: Array,
    held: Array,
) -> None:
    """Advance the navigation state by one sample of mean rate and specific force, less the biases.

    Parameters
    ----------
    C_b_G, v_G, r_e : (3, 3), (3,) [m/s], (3,) [m] navigation state, in place
    b_gyro_b, b_accel_b : (3,) estimated biases, body axes [rad/s], [m/s^2]
    omega_ib_b, f_b : (3,) means over the interval, as measured, body axes [rad/s], [m/s^2]
    increments : (4, 3) array, in place: angle and velocity increment of this step, then of the
        step before
    dt, dt_prev : this interval and the one before [s]; 0 for none
    sums : (6, 3) array, in place: integrals over the filter step of C_b_G (rows 0..2), of the
        specific force in grid axes (row 3), of the rate in body axes (row 4); [5, 0] is the time
    held : (8,) surroundings, as `hold_surroundings` leaves them
    """
    for k in range(3):
        increments[2, k] = increments[0, k]
        increments[3, k] = increments[1, k]
        increments[0, k] = (omega_ib_b[k] - b_gyro_b[k]) * dt
        increments[1, k] = (f_b[k] - b_accel_b[k]) * dt
    half = 0.5 * dt
    for i in range(3):
        for j in range(3):
            sums[i, j] += C_b_G[i, j] * half
    strapdown_step_held(C_b_G, v_G, r_e, increments, dt, dt_prev, held)
    for i in range(3):
        for j in range(3):
            sums[i, j] += C_b_G[i, j] * half
        # At the interval's end: half a sample late, which the mean over a filter step hardly sees.
        sums[3, i] += (
            C_b_G[i, 0] * increments[1, 0]
            + C_b_G[i, 1] * increments[1, 1]
            + C_b_G[i, 2] * increments[1, 2]
        )
        sums[4, i] += increments[0, i]
    sums[5, 0] += dt


@kernel
def take_means(sums: Array, C_mean: Array, f_b: Array, omega_b: Array) -> None:
    """Attitude matrix, specific force and rate as means over the filter step; clears ``sums``.

    f_b is such that C_mean f_b is the mean specific force in grid axes: C_mean is orthogonal but
    for the square of the rotation within a step, so its transpose serves as the inverse.
    """
    time = sums[5, 0]
    for i in range(3):
        for j in range(3):
            C_mean[i, j] = sums[i, j] / time
    for j in range(3):
        s = 0.0
        for i in range(3):
            s += C_mean[i, j] * sums[3, i]
        f_b[j] = s / time
        omega_b[j] = sums[4, j] / time
    for i in range(6):
        for j in range(3):
            sums[i, j] = 0.0


@kernel
def place(
    r_e: Array,
    v_G: Array,
    C_b_G: Array,
    lever_b: Array,
    C_e_G: Array,
    omega_ie_G: Array,
    lever_G: Array,
    point_e: Array,
    velocity_e: Array,
) -> float:
    """Height [m] at a navigation state; its frames and the place of a point of the vehicle.

    Parameters
    ----------
    r_e, v_G, C_b_G : (3,) [m], (3,) [m/s], (3, 3) navigation state
    lever_b : (3,) the point from base_link, body axes [m]
    C_e_G, omega_ie_G : (3, 3), (3,) out, ECEF to grid; earth rate, grid axes [rad/s]
    lever_G : (3,) out, the lever in grid axes [m]
    point_e, velocity_e : (3,) out, the point, ECEF [m]; velocity of base_link, ECEF axes [m/s]

    Returns
    -------
    float
        Height above the ellipsoid [m].
    """
    u_x, u_y, u_z, height = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    for i in range(3):
        omega_ie_G[i] = OMEGA_IE * C_e_G[i, 2]
        lever_G[i] = C_b_G[i, 0] * lever_b[0] + C_b_G[i, 1] * lever_b[1] + C_b_G[i, 2] * lever_b[2]
    for i in range(3):
        point_e[i] = (
            r_e[i] + C_e_G[0, i] * lever_G[0] + C_e_G[1, i] * lever_G[1] + C_e_G[2, i] * lever_G[2]
        )
        # Velocity of base_link: the lever turns by less than a centimetre in the interval that
        # this is used for.
        velocity_e[i] = C_e_G[0, i] * v_G[0] + C_e_G[1, i] * v_G[1] + C_e_G[2, i] * v_G[2]
    return height
