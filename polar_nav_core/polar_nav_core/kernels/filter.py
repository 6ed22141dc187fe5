"""Error-state filter on 24 states: prediction, update and feedback.

Order of states: phi_G, dv_G, dr_e, gyro bias, accelerometer bias, DVL scale, DVL Markov velocity,
USBL bias (polar_nav_core.error_model.ErrorState). The transition matrix is full in its first nine
rows (columns 0..14) and diagonal below, which the products here make use of. No function
allocates; scratch arrays come from the caller.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from .cache import kernel
from .error_model import fill_system_matrix

Ints = NDArray[np.int64]

N = 24
NAV = 9
"""States with dynamics: attitude, velocity, position."""
COUPLED = 15
"""States that the first nine are driven by: themselves and the inertial biases."""
MARKOV = 18
USBL = 21


@kernel
def fill_transition(
    Phi: Array,
    F15: Array,
    r_e: Array,
    v_G: Array,
    C_b_G: Array,
    omega_ib_b: Array,
    f_b: Array,
    dt: float,
    tau_markov: float,
    tau_usbl: float,
) -> None:
    """Phi = I + F dt + (F dt)^2/2 for one filter step; exact exponentials for the Markov blocks.

    Parameters
    ----------
    Phi : (24, 24) array, out
    F15 : (15, 15) scratch
    r_e, v_G, C_b_G, omega_ib_b, f_b : mean navigation state and inertial input over the step
    dt : step [s]
    tau_markov, tau_usbl : correlation times [s]; 0 for a constant
    """
    fill_system_matrix(F15, r_e, v_G, C_b_G, omega_ib_b, f_b)
    for i in range(N):
        for j in range(N):
            Phi[i, j] = 0.0
        Phi[i, i] = 1.0
    half = 0.5 * dt * dt
    for i in range(NAV):
        for j in range(COUPLED):
            square = 0.0
            for k in range(NAV):  # rows of F15 below nine are zero
                square += F15[i, k] * F15[k, j]
            Phi[i, j] += F15[i, j] * dt + square * half
    if tau_markov > 0.0:
        decay = math.exp(-dt / tau_markov)
        for i in range(MARKOV, MARKOV + 3):
            Phi[i, i] = decay
    if tau_usbl > 0.0:
        decay = math.exp(-dt / tau_usbl)
        for i in range(USBL, USBL + 3):
            Phi[i, i] = decay


@kernel
def predict(P: Array, Phi: Array, q: Array, M: Array) -> None:
    """P <- Phi P Phi^T + diag(q), symmetric to the bit.

    Inner loops run along rows, so that the compiler uses vector instructions without changing the
    order of any sum. The product's rows below nine are scaled rows of Phi P: P is symmetric.

    Parameters
    ----------
    P : (24, 24) array, in place
    Phi : (24, 24) transition, full in rows 0..8 and columns 0..14, diagonal below
    q : (24,) variances added over the step
    M : (24, 24) scratch
    """
    for i in range(NAV):  # M = Phi P; one expression of COUPLED products
        for j in range(N):
            M[i, j] = (
                Phi[i, 0] * P[0, j] + Phi[i, 1] * P[1, j] + Phi[i, 2] * P[2, j]
                + Phi[i, 3] * P[3, j] + Phi[i, 4] * P[4, j] + Phi[i, 5] * P[5, j]
                + Phi[i, 6] * P[6, j] + Phi[i, 7] * P[7, j] + Phi[i, 8] * P[8, j]
                + Phi[i, 9] * P[9, j] + Phi[i, 10] * P[10, j] + Phi[i, 11] * P[11, j]
                + Phi[i, 12] * P[12, j] + Phi[i, 13] * P[13, j] + Phi[i, 14] * P[14, j]
            )  # fmt: skip
    for i in range(NAV):
        for j in range(i + 1):
            s = 0.0
            for k in range(COUPLED):
                s += M[i, k] * Phi[j, k]
            P[i, j] = s
            P[j, i] = s
    for i in range(NAV, N):
        d = Phi[i, i]
        for j in range(NAV):
            s = d * M[j, i]
            P[i, j] = s
            P[j, i] = s
        for j in range(NAV, i + 1):
            s = d * Phi[j, j] * P[i, j]
            P[i, j] = s
            P[j, i] = s
    for i in range(N):
        P[i, i] += q[i]


@kernel
def innovation_covariance(S: Array, PHt: Array, P: Array, H: Array, R: Array, m: int) -> None:
    """PHt = (P H^T)^T, shape (3, 24), and S = H P H^T + R for the first m rows.

    Rows of H are mostly zeros, which are passed over.
    """
    for a in range(m):
        for i in range(N):
            PHt[a, i] = 0.0
        for k in range(N):
            h = H[a, k]
            if h != 0.0:
                for i in range(N):
                    PHt[a, i] += h * P[k, i]
    for a in range(m):
        for b in range(a + 1):
            s = 0.5 * (R[a, b] + R[b, a])
            for k in range(N):
                s += H[a, k] * PHt[b, k]
            S[a, b] = s
            S[b, a] = s


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
def update(
    P: Array,
    x: Array,
    H: Array,
    R: Array,
    z: Array,
    m: int,
    K: Array,
    PHt: Array,
    L: Array,
    A: Array,
) -> None:
    """Kalman update with Joseph's form; x <- K z.

    P <- (I - K H) P (I - K H)^T + K R K^T with K = P H^T S^-1. Multiplied out with G = P H^T this
    is P - K D^T - D K^T, D = G - K S/2: for any K, as Joseph's, so that a rounded gain matters in
    second order only; symmetric to the bit; a quarter of the work. PHt and L come from
    :func:`innovation_covariance` and :func:`cholesky` of the same H and R.

    Parameters
    ----------
    P : (24, 24) array, in place
    x : (24,) array, out: estimated error
    H, R, z : (m, 24), (m, m), (m,)
    K : (3, 24) array, out: the gain, transposed
    PHt, L : (3, 24), (3, 3)
    A : (24, 24) scratch; rows 0..2 are D^T
    """
    for a in range(m):  # K S = P H^T by forward and back substitution
        for i in range(N):
            K[a, i] = PHt[a, i]
        for b in range(a):
            s = L[a, b]
            for i in range(N):
                K[a, i] -= s * K[b, i]
        s = 1.0 / L[a, a]
        for i in range(N):
            K[a, i] *= s
    for c in range(m):
        a = m - 1 - c
        for b in range(a + 1, m):
            s = L[b, a]
            for i in range(N):
                K[a, i] -= s * K[b, i]
        s = 1.0 / L[a, a]
        for i in range(N):
            K[a, i] *= s
    for i in range(N):
        x[i] = 0.0
    for a in range(m):
        s = z[a]
        for i in range(N):
            x[i] += s * K[a, i]
    for a in range(m):
        for i in range(N):
            A[a, i] = PHt[a, i]
        for b in range(m):
            s = R[a, b]
            for k in range(N):
                s += H[a, k] * PHt[b, k]
            s *= 0.5
            for i in range(N):
                A[a, i] -= s * K[b, i]
    if m == 1:
        for i in range(N):
            k_0 = K[0, i]
            d_0 = A[0, i]
            for j in range(N):
                P[i, j] -= k_0 * A[0, j] + d_0 * K[0, j]
            K[1, i] = 0.0
            K[2, i] = 0.0
        return
    for a in range(m, 3):  # always three rows below: one pass over P
        for i in range(N):
            K[a, i] = 0.0
            A[a, i] = 0.0
    for i in range(N):
        k_0 = K[0, i]
        k_1 = K[1, i]
        k_2 = K[2, i]
        d_0 = A[0, i]
        d_1 = A[1, i]
        d_2 = A[2, i]
        for j in range(N):
            P[i, j] -= (
                (k_0 * A[0, j] + d_0 * K[0, j])
                + (k_1 * A[1, j] + d_1 * K[1, j])
                + (k_2 * A[2, j] + d_2 * K[2, j])
            )


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
    """Take the estimated error x out of the navigation state (closed loop).

    C <- exp([phi x]) C, v <- v - dv, r <- r - dr; the sensor errors are estimates of errors, so
    theirs is added.
    """
    a = x[0]
    b = x[1]
    c = x[2]
    angle2 = a * a + b * b + c * c
    if angle2 > 1e-12:
        angle = math.sqrt(angle2)
        s = math.sin(angle) / angle
        h = (1.0 - math.cos(angle)) / angle2
    else:
        s = 1.0 - angle2 / 6.0
        h = 0.5 - angle2 / 24.0
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
        v_G[k] -= x[3 + k]
        r_e[k] -= x[6 + k]
        b_gyro_b[k] += x[9 + k]
        b_accel_b[k] += x[12 + k]
        dvl_scale_m[k] += x[15 + k]
        dvl_markov_m[k] += x[18 + k]
        usbl_bias_a[k] += x[21 + k]


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
        'LU': np.zeros((NAV, NAV)),
        'pivot': np.zeros(NAV, dtype=np.int64),
    }
