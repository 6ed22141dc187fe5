"""Error-state filter on 24 states: prediction, update and feedback.

Order of states: phi_G, dv_G, dr_e, gyro bias, accelerometer bias, DVL scale, DVL Markov velocity,
USBL bias (polar_nav_core.error_model.ErrorState; signs in docs/frames.md). The transition matrix
is full in its first nine rows (columns 0..14) and diagonal below, which the products here make use
of. No function allocates; scratch arrays come from the caller. Loops over a row run to the length
of an array where that is faster: the compiler takes loops of a known length apart before it looks
for vectors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...arrays import Array
from ...arrays import Ints as Ints
from ..cache import entry, kernel

N = 24
NAV = 9
"""States with dynamics: attitude, velocity, position."""
COUPLED = 15
"""States that the first nine are driven by: themselves and the inertial biases."""
PHI, DV, DR, GYRO, ACCEL, SCALE, MARKOV, USBL = 0, 3, 6, 9, 12, 15, 18, 21
"""First index of each block of the error."""


@kernel
def leading_nine(
    x: Array,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """First nine elements of a row as scalars: those of Phi's full rows, while it is changed."""
    return x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8]


@entry
@kernel
def predict(P: Array, Phi: Array, q: Array, M: Array) -> None:
    """P <- Phi P Phi^T + diag(q), symmetric to the bit.

    Inner loops run along rows, so that the compiler uses vector instructions without changing the
    order of any sum. What couples the first nine states and the rest is scaled rows of Phi P: P is
    symmetric. The states from NAV to MARKOV are constants: among themselves they keep their P.

    Parameters
    ----------
    P : (24, 24) array, in place
    Phi : (24, 24) transition, full in rows 0..8 and columns 0..14; diagonal below, ones to MARKOV
    q : (24,) variances added over the step
    M : (24, 24) scratch: Phi P in the first nine rows, and the diagonal of Phi in the next; in the
        first nine columns of the rows below, the first nine rows of Phi as columns
    """
    n = P.shape[0]
    nine = n - COUPLED
    for i in range(NAV):  # one expression of COUPLED products
        for j in range(N):
            M[i, j] = (
                Phi[i, 0] * P[0, j] + Phi[i, 1] * P[1, j] + Phi[i, 2] * P[2, j]
                + Phi[i, 3] * P[3, j] + Phi[i, 4] * P[4, j] + Phi[i, 5] * P[5, j]
                + Phi[i, 6] * P[6, j] + Phi[i, 7] * P[7, j] + Phi[i, 8] * P[8, j]
                + Phi[i, 9] * P[9, j] + Phi[i, 10] * P[10, j] + Phi[i, 11] * P[11, j]
                + Phi[i, 12] * P[12, j] + Phi[i, 13] * P[13, j] + Phi[i, 14] * P[14, j]
            )  # fmt: skip
    for k in range(COUPLED):
        for j in range(NAV):
            M[NAV + k, j] = Phi[j, k]
    for i in range(NAV, N):
        M[NAV, i] = Phi[i, i]
    # Whole rows, as an index from 0 is known not to be negative; what is too much is written anew.
    for j in range(NAV):
        for i in range(n):
            P[j, i] = M[NAV, i] * M[j, i]
    for j in range(NAV):
        for i in range(NAV, N):
            P[i, j] = P[j, i]
    for i in range(NAV):
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(M[i])
        x_9, x_10, x_11 = M[i, 9], M[i, 10], M[i, 11]
        x_12, x_13, x_14 = M[i, 12], M[i, 13], M[i, 14]
        for j in range(nine):  # what stands right of the diagonal comes from the rows below
            P[i, j] = (
                x_0 * M[9, j] + x_1 * M[10, j] + x_2 * M[11, j]
                + x_3 * M[12, j] + x_4 * M[13, j] + x_5 * M[14, j]
                + x_6 * M[15, j] + x_7 * M[16, j] + x_8 * M[17, j]
                + x_9 * M[18, j] + x_10 * M[19, j] + x_11 * M[20, j]
                + x_12 * M[21, j] + x_13 * M[22, j] + x_14 * M[23, j]
            )  # fmt: skip
        for j in range(i):
            P[j, i] = P[i, j]
    for i in range(MARKOV, N):
        d = Phi[i, i]
        for j in range(NAV, i + 1):
            P[i, j] *= d * M[NAV, j]
        for j in range(NAV, i):
            P[j, i] = P[i, j]
    for i in range(N):
        P[i, i] += q[i]


@entry
@kernel
def innovation_covariance(S: Array, PHt: Array, P: Array, H: Array, R: Array, m: int) -> None:
    """PHt = (P H^T)^T, shape (3, 24), and S = H P H^T + R for the first m rows.

    Columns of H are mostly zeros, which are passed over. Three rows are taken at once.
    """
    n = P.shape[0]
    for a in range(m):
        for i in range(n):
            PHt[a, i] = 0.0
    if m == 3:
        for k in range(n):
            h_0 = H[0, k]
            h_1 = H[1, k]
            h_2 = H[2, k]
            if h_0 != 0.0 or h_1 != 0.0 or h_2 != 0.0:
                for i in range(n):
                    PHt[0, i] += h_0 * P[k, i]
                    PHt[1, i] += h_1 * P[k, i]
                    PHt[2, i] += h_2 * P[k, i]
        s_00 = R[0, 0]
        s_10 = 0.5 * (R[1, 0] + R[0, 1])
        s_11 = R[1, 1]
        s_20 = 0.5 * (R[2, 0] + R[0, 2])
        s_21 = 0.5 * (R[2, 1] + R[1, 2])
        s_22 = R[2, 2]
        for k in range(n):
            s_00 += H[0, k] * PHt[0, k]
            s_10 += H[1, k] * PHt[0, k]
            s_11 += H[1, k] * PHt[1, k]
            s_20 += H[2, k] * PHt[0, k]
            s_21 += H[2, k] * PHt[1, k]
            s_22 += H[2, k] * PHt[2, k]
        S[0, 0] = s_00
        S[1, 1] = s_11
        S[2, 2] = s_22
        S[1, 0] = S[0, 1] = s_10
        S[2, 0] = S[0, 2] = s_20
        S[2, 1] = S[1, 2] = s_21
        return
    for a in range(m):
        for k in range(n):
            h = H[a, k]
            if h != 0.0:
                for i in range(n):
                    PHt[a, i] += h * P[k, i]
    for a in range(m):
        for b in range(a + 1):
            S[a, b] = 0.5 * (R[a, b] + R[b, a])
        for k in range(n):
            h = H[a, k]
            if h != 0.0:
                for b in range(a + 1):
                    S[a, b] += h * PHt[b, k]
        for b in range(a):
            S[b, a] = S[a, b]


@entry
@kernel
def cholesky(L: Array, A: Array, n: int) -> bool:
    """Lower Cholesky factor of A[:n, :n]; False when it is not positive definite or not finite."""
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0 or math.isinf(s):
                    return False
                L[i, i] = math.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    return True


@entry
@kernel
def is_positive_definite(A: Array, n: int, U: Array) -> bool:
    """Whether A[:n, :n], symmetric, is positive definite and finite.

    By the pivots of A = U^T D^-1 U, row by row along memory. U is scratch of the shape of A. What
    stands left of the diagonal is carried along and not read: loops from 0 are faster.
    """
    for i in range(n):
        for j in range(n):
            U[i, j] = A[i, j]
    for k in range(n):
        pivot = U[k, k]
        if not pivot > 0.0 or math.isinf(pivot):
            return False
        inverse = 1.0 / pivot
        for i in range(k + 1, n):
            factor = U[k, i] * inverse
            for j in range(n):
                U[i, j] -= factor * U[k, j]
    return True


@entry
@kernel
def nis_of(L: Array, z: Array, w: Array, m: int) -> float:
    """z^T S^-1 z from the Cholesky factor L of S; w is scratch of length m."""
    total = 0.0
    for a in range(m):
        s = z[a]
        for b in range(a):
            s -= L[a, b] * w[b]
        w[a] = s / L[a, a]
        total += w[a] * w[a]
    return total


@kernel
def gain_of(K: Array, D: Array, G: Array, L: Array, S: Array, m: int) -> None:
    """K = G S^-1 and D = G - K S/2, all transposed: one row for each of m measured values.

    Parameters
    ----------
    K, D : (3, n) arrays, out
        Gain, and what Joseph's form needs besides (`subtract`); rows from m to 2 become zero.
    G : (3, n) array
        (P H^T)^T, or the rows of another block of the covariance.
    L, S : (3, 3) arrays
        Cholesky factor of the innovation covariance S, and S itself.
    m : int
        Measured values.
    """
    n = G.shape[1]
    for a in range(m):  # K S = G by forward and back substitution
        for i in range(n):
            K[a, i] = G[a, i]
        for b in range(a):
            s = L[a, b]
            for i in range(n):
                K[a, i] -= s * K[b, i]
        s = 1.0 / L[a, a]
        for i in range(n):
            K[a, i] *= s
    for c in range(m):
        a = m - 1 - c
        for b in range(a + 1, m):
            s = L[b, a]
            for i in range(n):
                K[a, i] -= s * K[b, i]
        s = 1.0 / L[a, a]
        for i in range(n):
            K[a, i] *= s
    for a in range(m):
        for i in range(n):
            D[a, i] = G[a, i]
        for b in range(m):
            s = 0.5 * S[a, b]
            for i in range(n):
                D[a, i] -= s * K[b, i]
    for a in range(m, 3):
        for i in range(n):
            K[a, i] = 0.0
            D[a, i] = 0.0


@kernel
def subtract(P: Array, K_i: Array, D_i: Array, K_j: Array, D_j: Array) -> None:
    """P <- P - K_i D_j^T - D_i K_j^T: one block of Joseph's form multiplied out.

    P is (n_i, n_j); gains and D, transposed, are (3, n_i) and (3, n_j). Always three rows: one
    pass over P.
    """
    for i in range(P.shape[0]):
        k_0 = K_i[0, i]
        k_1 = K_i[1, i]
        k_2 = K_i[2, i]
        d_0 = D_i[0, i]
        d_1 = D_i[1, i]
        d_2 = D_i[2, i]
        for j in range(P.shape[1]):
            P[i, j] -= (
                (k_0 * D_j[0, j] + d_0 * K_j[0, j])
                + (k_1 * D_j[1, j] + d_1 * K_j[1, j])
                + (k_2 * D_j[2, j] + d_2 * K_j[2, j])
            )


@entry
@kernel
def update(
    P: Array,
    x: Array,
    S: Array,
    z: Array,
    m: int,
    K: Array,
    PHt: Array,
    L: Array,
    D: Array,
) -> None:
    """Kalman update with Joseph's form; x <- K z.

    P <- (I - K H) P (I - K H)^T + K R K^T with K = P H^T S^-1. Multiplied out with G = P H^T and
    S = H G + R this is P - K D^T - D K^T, D = G - K S/2: for any K, as Joseph's, so that a rounded
    gain matters in second order only; symmetric to the bit; a quarter of the work. S, PHt and L
    come from :func:`innovation_covariance` and :func:`cholesky`.

    Parameters
    ----------
    P : (24, 24) array, in place
    x : (24,) array, out: estimated error
    S, z : (m, m), (m,)
    m : measured values, 1 to 3
    K : (3, 24) array, out: the gain, transposed
    PHt, L : (3, 24), (3, 3)
    D : (3, 24) array, out: D^T; of a larger array the first three rows
    """
    n = P.shape[0]
    gain_of(K, D, PHt, L, S, m)
    for i in range(n):
        x[i] = 0.0
    for a in range(m):
        s = z[a]
        for i in range(n):
            x[i] += s * K[a, i]
    if m == 1:
        for i in range(n):
            k_0 = K[0, i]
            d_0 = D[0, i]
            for j in range(n):
                P[i, j] -= k_0 * D[0, j] + d_0 * K[0, j]
        return
    subtract(P, K, D, K, D)


@kernel
def feed_back(
    x: Array,
    C_b_G: Array,
    v_G: Array,
    r_e: Array,
    b_gyro_b: Array,
    b_accel_b: Array,
    dvl_scale_m: Array,
    dvl_markov_m: Array,
    usbl_bias_a: Array,
) -> None:
    """Correct the navigation state by the estimated error x, in place (closed loop).

    C <- exp([phi x]) C, v <- v - dv, r <- r - dr; the sensor errors are estimates of errors, so
    theirs is added. This is the retraction that all Jacobians refer to (docs/frames.md), and the
    one place that corrects the state.

    Parameters
    ----------
    x : (24,) array
        Estimated error, in the order and units of `polar_nav_core.error_model.ErrorState`.
    C_b_G, v_G, r_e : (3, 3), (3,), (3,) arrays
        Attitude; velocity, grid axes [m/s]; position, ECEF [m].
    b_gyro_b, b_accel_b : (3,) arrays
        Estimated biases, body axes [rad/s], [m/s^2].
    dvl_scale_m, dvl_markov_m, usbl_bias_a : (3,) arrays
        Estimated errors of DVL and USBL, instrument axes [-], [m/s], [m].
    """
    a = x[PHI]
    b = x[PHI + 1]
    c = x[PHI + 2]
    angle2 = a * a + b * b + c * c
    if angle2 > 1e-6:
        angle = math.sqrt(angle2)
        s = math.sin(angle) / angle
        h = (1.0 - math.cos(angle)) / angle2
    else:  # the next terms are under 1e-21
        s = 1.0 - angle2 * (1.0 / 6.0 - angle2 * (1.0 / 120.0))
        h = 0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0))
    for j in range(3):
        p = C_b_G[0, j]
        q = C_b_G[1, j]
        r = C_b_G[2, j]
        # phi x column, twice (Rodrigues)
        u0 = b * r - c * q
        u1 = c * p - a * r
        u2 = a * q - b * p
        w0 = b * u2 - c * u1
        w1 = c * u0 - a * u2
        w2 = a * u1 - b * u0
        C_b_G[0, j] = p + s * u0 + h * w0
        C_b_G[1, j] = q + s * u1 + h * w1
        C_b_G[2, j] = r + s * u2 + h * w2
    for k in range(3):
        v_G[k] -= x[DV + k]
        r_e[k] -= x[DR + k]
        b_gyro_b[k] += x[GYRO + k]
        b_accel_b[k] += x[ACCEL + k]
        dvl_scale_m[k] += x[SCALE + k]
        dvl_markov_m[k] += x[MARKOV + k]
        usbl_bias_a[k] += x[USBL + k]


def scratch() -> dict[str, Any]:
    """Work arrays of one filter, by the names that the kernels use."""
    return {
        'F15': np.zeros((COUPLED, COUPLED)),
        'M': np.zeros((N, N)),
        'L': np.zeros((3, 3)),
        'LP': np.zeros((N, N)),
        'S': np.zeros((3, 3)),
        'PHt': np.zeros((3, N)),
        'K': np.zeros((3, N)),
        'w': np.zeros(3),
    }
