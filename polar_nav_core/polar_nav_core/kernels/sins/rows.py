"""Measurement rows: innovation z = estimate - measurement, H and R of each sensor.

Derivation: docs/derivations/measurements.md.

Signs: x is estimate minus truth for attitude (Chat = exp(-[phi x]) C), velocity and position; for
sensor errors it is the part of the error that the estimate does not know yet. z = H x + noise.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel
from .far import bend_of

PHI = 0
DV = 3
DR = 6
GYRO = 9
SCALE = 15
MARKOV = 18
USBL = 21


@kernel
def _clear(H: Array, m: int) -> None:
    for a in range(m):
        for k in range(24):
            H[a, k] = 0.0


@kernel
def _rotate_covariance(R: Array, C: Array, Rm: Array) -> None:
    """R = C Rm C^T for 3 x 3, symmetric to the bit."""
    for i in range(3):
        x = C[i, 0] * Rm[0, 0] + C[i, 1] * Rm[1, 0] + C[i, 2] * Rm[2, 0]
        y = C[i, 0] * Rm[0, 1] + C[i, 1] * Rm[1, 1] + C[i, 2] * Rm[2, 1]
        z = C[i, 0] * Rm[0, 2] + C[i, 1] * Rm[1, 2] + C[i, 2] * Rm[2, 2]
        for j in range(i + 1):
            R[i, j] = x * C[j, 0] + y * C[j, 1] + z * C[j, 2]
            R[j, i] = R[i, j]


@kernel
def turn_rows(H: Array, V0: float, V1: float, V2: float) -> None:
    """Write what an attitude error does to a velocity into a ping's rows: -[V x] on phi.

    Parameters
    ----------
    H : (3, 24) array, in place
    V0, V1, V2 : float
        Velocity that turns with the attitude, grid axes [m/s].
    """
    H[0, PHI + 1] = V2
    H[0, PHI + 2] = -V1
    H[1, PHI] = -V2
    H[1, PHI + 2] = V0
    H[2, PHI] = V1
    H[2, PHI + 1] = -V0


@entry
@kernel
def dvl_rows(
    H: Array,
    R: Array,
    z: Array,
    C_m_G: Array,
    C_b_G: Array,
    v_G: Array,
    omega_ib_b: Array,
    omega_ie_G: Array,
    b_gyro_b: Array,
    scale_m: Array,
    markov_m: Array,
    v_m: Array,
    R_m: Array,
    C_m_b: Array,
    lever_b: Array,
) -> None:
    """DVL velocity over ground, resolved with the estimated attitude.

    z = v_G - C_b_G (C_m_b (v_m - markov)/(1 + scale) - omega_eb x lever); the block -[V x] on phi
    is what makes heading observable. The scale error multiplies the predicted velocity, not the
    measured one: the noise of a ping must not stand in its own H (measurements.md, 1).

    Parameters
    ----------
    H, R, z : (3, 24), (3, 3), (3,) out, grid axes
    C_m_G : (3, 3) scratch
    C_b_G, v_G : (3, 3), (3,) estimate [m/s]
    omega_ib_b, b_gyro_b : (3,) measured rate and its estimated bias, body axes [rad/s]
    omega_ie_G : (3,) Earth rate, grid axes [rad/s]
    scale_m, markov_m : (3,) estimated scale error [-] and Markov velocity [m/s], instrument axes
    v_m, R_m : (3,), (3, 3) measurement [m/s] and its covariance [(m/s)^2], instrument axes
    C_m_b, lever_b : (3, 3), (3,) mounting of the instrument; its place, body axes [m]
    """
    _clear(H, 3)
    for i in range(3):
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += C_b_G[i, k] * C_m_b[k, j]
            C_m_G[i, j] = s
    w0 = omega_ib_b[0] - b_gyro_b[0]
    w1 = omega_ib_b[1] - b_gyro_b[1]
    w2 = omega_ib_b[2] - b_gyro_b[2]
    for k in range(3):
        w0 -= C_b_G[k, 0] * omega_ie_G[k]
        w1 -= C_b_G[k, 1] * omega_ie_G[k]
        w2 -= C_b_G[k, 2] * omega_ie_G[k]
    l0 = lever_b[0]
    l1 = lever_b[1]
    l2 = lever_b[2]
    lever_velocity_b0 = w1 * l2 - w2 * l1
    lever_velocity_b1 = w2 * l0 - w0 * l2
    lever_velocity_b2 = w0 * l1 - w1 * l0
    for i in range(3):
        z[i] = v_G[i] + (
            C_b_G[i, 0] * lever_velocity_b0
            + C_b_G[i, 1] * lever_velocity_b1
            + C_b_G[i, 2] * lever_velocity_b2
        )
    for k in range(3):
        gain = 1.0 / (1.0 + scale_m[k])
        corrected = (v_m[k] - markov_m[k]) * gain
        predicted = (
            C_m_b[0, k] * lever_velocity_b0
            + C_m_b[1, k] * lever_velocity_b1
            + C_m_b[2, k] * lever_velocity_b2
        )
        for n in range(3):
            predicted += C_m_G[n, k] * v_G[n]
        for i in range(3):
            z[i] -= C_m_G[i, k] * corrected
            H[i, SCALE + k] = -C_m_G[i, k] * predicted * gain
            H[i, MARKOV + k] = -C_m_G[i, k] * gain
    for i in range(3):
        H[i, DV + i] = 1.0
        # C (eps x lever) = -C [lever x] eps
        H[i, GYRO] = -(C_b_G[i, 1] * l2 - C_b_G[i, 2] * l1)
        H[i, GYRO + 1] = -(C_b_G[i, 2] * l0 - C_b_G[i, 0] * l2)
        H[i, GYRO + 2] = -(C_b_G[i, 0] * l1 - C_b_G[i, 1] * l0)
    turn_rows(H, v_G[0] - z[0], v_G[1] - z[1], v_G[2] - z[2])
    _rotate_covariance(R, C_m_G, R_m)


@entry
@kernel
def depth_rows(
    H: Array,
    R: Array,
    z: Array,
    C_e_G: Array,
    C_b_G: Array,
    height: float,
    measured_height: float,
    variance: float,
    lever_b: Array,
) -> None:
    """Height of the pressure sensor: z = h + (C_b_G lever)_up - measured_height, one row.

    Parameters
    ----------
    H, R, z : (3, 24), (3, 3), (3,) out, first row
    C_e_G, C_b_G : (3, 3) frames at the estimate
    height : of base_link as estimated, above the ellipsoid [m]
    measured_height, variance : of the sensor: sea surface less depth [m], [m^2]
    lever_b : (3,) sensor from base_link, body axes [m]
    """
    _clear(H, 1)
    L0 = C_b_G[0, 0] * lever_b[0] + C_b_G[0, 1] * lever_b[1] + C_b_G[0, 2] * lever_b[2]
    L1 = C_b_G[1, 0] * lever_b[0] + C_b_G[1, 1] * lever_b[1] + C_b_G[1, 2] * lever_b[2]
    L2 = C_b_G[2, 0] * lever_b[0] + C_b_G[2, 1] * lever_b[1] + C_b_G[2, 2] * lever_b[2]
    z[0] = height + L2 - measured_height
    H[0, PHI] = -L1
    H[0, PHI + 1] = L0
    for k in range(3):
        H[0, DR + k] = C_e_G[2, k]
    R[0, 0] = variance


@entry
@kernel
def fix_rows(
    H: Array,
    R: Array,
    z: Array,
    C_e_G: Array,
    lever_G: Array,
    r_e: Array,
    measured_r_e: Array,
    R_e: Array,
    C_a_G: Array,
    usbl_bias_a: Array,
) -> None:
    """Position of the transponder: z = C_e_G (r_e - measured_r_e) + C_a_G usbl_bias_a, grid axes.

    Parameters
    ----------
    H, R, z : (3, 24), (3, 3), (3,) out
    C_e_G : (3, 3) at the estimate
    lever_G : (3,) transponder from base_link, grid axes [m]
    r_e : (3,) estimated position of the transponder at the time of validity, ECEF [m]
    measured_r_e, R_e : (3,), (3, 3) the fix, ECEF
    C_a_G : (3, 3) USBL array axes to grid, or how leader's errors move a fix (`fill_shared`);
        all zero while neither is estimated
    usbl_bias_a : (3,) estimated USBL error, array axes [m], or leader's errors per sigma
    """
    _clear(H, 3)
    for i in range(3):
        s = 0.0
        for k in range(3):
            s += C_e_G[i, k] * (r_e[k] - measured_r_e[k])
            H[i, DR + k] = C_e_G[i, k]
            s += C_a_G[i, k] * usbl_bias_a[k]
            H[i, USBL + k] = -C_a_G[i, k]
        z[i] = s
    z[2] += bend_of(C_e_G, r_e, measured_r_e)
    # Chat lever = C lever - phi x (C lever) = C lever + [lever_G x] phi
    H[0, PHI + 1] = -lever_G[2]
    H[0, PHI + 2] = lever_G[1]
    H[1, PHI] = lever_G[2]
    H[1, PHI + 2] = -lever_G[0]
    H[2, PHI] = -lever_G[1]
    H[2, PHI + 1] = lever_G[0]
    _rotate_covariance(R, C_e_G, R_e)
