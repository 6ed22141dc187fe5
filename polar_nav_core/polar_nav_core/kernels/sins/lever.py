"""Estimates moved from the point of the IMU to base_link, with their covariance.

With l from base_link to the IMU, ``L = C_b_G l`` and ``U = C_b_G (omega_eb_b x l)``:

    r_base = r_imu - C_G_e L        dr_base = dr - C_G_e [L x] phi
    v_base = v_imu - U              dv_base = dv - [U x] phi + [L x][omega_ie x] phi
                                              + C_b_G [l x] b_gyro + noise

the last the white noise of the rate that is used. The live node calls this for one row, a whole
run for hundreds: the same code, so the same bits.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel, routine
from ..frames.earth import OMEGA_IE, up_and_height
from ..frames.grid import fill_C_e_G
from .update import DR, DV, GYRO, PHI


@kernel
def _cross(a: Array, b: Array, out: Array) -> None:
    """Cross product a x b into ``out``, all (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def _skew(a: Array, out: Array) -> None:
    """[a x] into ``out`` (3, 3)."""
    for i in range(3):
        out[i, i] = 0.0
    out[0, 1] = -a[2]
    out[0, 2] = a[1]
    out[1, 0] = a[2]
    out[1, 2] = -a[0]
    out[2, 0] = -a[1]
    out[2, 1] = a[0]


@kernel
def _product(A: Array, B: Array, sign: float, out: Array) -> None:
    """``out += sign A B``, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] += sign * (A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j])


@entry
@routine
def move_to_base_link(
    lever_b: Array,
    gyro_noise_density: float,
    omega_ib_b: Array,
    bandwidth: Array,
    gyro_bias_b: Array,
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    P: Array,
    work: Array,
) -> None:
    """Move n estimates from the IMU's point to base_link.

    Parameters
    ----------
    lever_b : (3,) array
        IMU from base_link, body axes [m].
    gyro_noise_density : float
        [rad/s/sqrt(Hz)]
    omega_ib_b : (n, 3) array
        Rate at the stamp, as measured [rad/s].
    bandwidth : (n,) array
        Variance of its white noise over the density squared [Hz].
    gyro_bias_b : (n, 3) array
        As estimated [rad/s].
    C_b_G : (n, 3, 3) array
    v_G, r_e : (n, 3) arrays, in place
        Velocity, grid axes [m/s]; position, ECEF [m].
    P : (n, m, m) array, in place
        Covariance of `error_model.X`, at least up to the gyro bias.
    work : (8, 3, 3) array
        Scratch.
    """
    C_e_G, L_skew, U_skew, earth_skew, lever_skew = work[0], work[1], work[2], work[3], work[4]
    vectors, of_phi, of_bias = work[5], work[6], work[7]
    rate, turned, scratch = vectors[0], vectors[1], vectors[2]
    m = P.shape[1]
    _skew(lever_b, lever_skew)
    for n in range(r_e.shape[0]):
        u_x, u_y, u_z, _ = up_and_height(r_e[n, 0], r_e[n, 1], r_e[n, 2])
        fill_C_e_G(u_x, u_y, u_z, C_e_G)
        C = C_b_G[n]
        for i in range(3):
            scratch[i] = OMEGA_IE * C_e_G[i, 2]
        _skew(scratch, earth_skew)
        for i in range(3):
            earth = C[0, i] * scratch[0] + C[1, i] * scratch[1] + C[2, i] * scratch[2]
            rate[i] = omega_ib_b[n, i] - gyro_bias_b[n, i] - earth
        _cross(rate, lever_b, turned)
        for i in range(3):
            scratch[i] = C[i, 0] * turned[0] + C[i, 1] * turned[1] + C[i, 2] * turned[2]
            v_G[n, i] -= scratch[i]
        _skew(scratch, U_skew)
        for i in range(3):
            scratch[i] = C[i, 0] * lever_b[0] + C[i, 1] * lever_b[1] + C[i, 2] * lever_b[2]
        _skew(scratch, L_skew)
        for i in range(3):
            moved = C_e_G[0, i] * scratch[0] + C_e_G[1, i] * scratch[1] + C_e_G[2, i] * scratch[2]
            r_e[n, i] -= moved
        of_bias[:] = 0.0
        _product(C, lever_skew, 1.0, of_bias)
        _move_covariance(P[n], m, C_e_G, L_skew, U_skew, earth_skew, of_phi, of_bias)
        noise = gyro_noise_density * gyro_noise_density * bandwidth[n]
        for i in range(3):
            for j in range(3):
                P[n, DV + i, DV + j] += noise * (
                    of_bias[i, 0] * of_bias[j, 0]
                    + of_bias[i, 1] * of_bias[j, 1]
                    + of_bias[i, 2] * of_bias[j, 2]
                )


@kernel
def _move_covariance(
    P: Array,
    m: int,
    C_e_G: Array,
    L_skew: Array,
    U_skew: Array,
    earth_skew: Array,
    of_phi: Array,
    of_bias: Array,
) -> None:
    """P <- T P T' with what phi and the gyro bias add to velocity and position."""
    for i in range(3):
        for j in range(3):
            of_phi[i, j] = -U_skew[i, j]
    _product(L_skew, earth_skew, 1.0, of_phi)
    for side in range(2):
        for c in range(m):
            for i in range(3):
                moved_v = 0.0
                moved_r = 0.0
                for k in range(3):
                    phi = P[PHI + k, c] if side == 0 else P[c, PHI + k]
                    bias = P[GYRO + k, c] if side == 0 else P[c, GYRO + k]
                    moved_v += of_phi[i, k] * phi + of_bias[i, k] * bias
                    turned = 0.0  # C_G_e [L x]
                    for j in range(3):
                        turned += C_e_G[j, i] * L_skew[j, k]
                    moved_r -= turned * phi
                if side == 0:
                    P[DV + i, c] += moved_v
                    P[DR + i, c] += moved_r
                else:
                    P[c, DV + i] += moved_v
                    P[c, DR + i] += moved_r
