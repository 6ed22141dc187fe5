"""Three combinations of the error as rows (3, 24): products, sums and whitening of them."""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from .update import NAV, N


@kernel
def step_columns(C: Array, Phi: Array, work: Array) -> None:
    """C^T <- C^T Phi^T for three rows; work is (3, 24)."""
    for a in range(3):
        for i in range(NAV):
            work[a, i] = (
                Phi[i, 0] * C[a, 0] + Phi[i, 1] * C[a, 1] + Phi[i, 2] * C[a, 2]
                + Phi[i, 3] * C[a, 3] + Phi[i, 4] * C[a, 4] + Phi[i, 5] * C[a, 5]
                + Phi[i, 6] * C[a, 6] + Phi[i, 7] * C[a, 7] + Phi[i, 8] * C[a, 8]
                + Phi[i, 9] * C[a, 9] + Phi[i, 10] * C[a, 10] + Phi[i, 11] * C[a, 11]
                + Phi[i, 12] * C[a, 12] + Phi[i, 13] * C[a, 13] + Phi[i, 14] * C[a, 14]
            )  # fmt: skip
    for a in range(3):
        for i in range(NAV):
            C[a, i] = work[a, i]
        for i in range(NAV, N):
            C[a, i] *= Phi[i, i]


@kernel
def leading_nine(
    x: Array,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """First nine elements of a row as scalars: those of Phi's full rows, while it is changed."""
    return x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8]


@kernel
def step_rows(Y: Array, Phi: Array, work: Array) -> None:
    """Y <- Y Phi for three rows; work is (3, 24)."""
    for a in range(3):
        y_0, y_1, y_2, y_3, y_4, y_5, y_6, y_7, y_8 = leading_nine(Y[a])
        for j in range(N):
            work[a, j] = (
                y_0 * Phi[0, j] + y_1 * Phi[1, j] + y_2 * Phi[2, j]
                + y_3 * Phi[3, j] + y_4 * Phi[4, j] + y_5 * Phi[5, j]
                + y_6 * Phi[6, j] + y_7 * Phi[7, j] + y_8 * Phi[8, j]
            )  # fmt: skip
        for j in range(NAV):
            Y[a, j] = work[a, j]
        for j in range(NAV, N):
            Y[a, j] = work[a, j] + Phi[j, j] * Y[a, j]


@kernel
def rows_times(out: Array, X: Array, A: Array) -> None:
    """Out = X A for three rows X and a square A, in one expression of 24 products."""
    for a in range(3):
        x = X[a]
        for j in range(A.shape[0]):
            out[a, j] = (
                x[0] * A[0, j] + x[1] * A[1, j] + x[2] * A[2, j] + x[3] * A[3, j]
                + x[4] * A[4, j] + x[5] * A[5, j] + x[6] * A[6, j] + x[7] * A[7, j]
                + x[8] * A[8, j] + x[9] * A[9, j] + x[10] * A[10, j] + x[11] * A[11, j]
                + x[12] * A[12, j] + x[13] * A[13, j] + x[14] * A[14, j] + x[15] * A[15, j]
                + x[16] * A[16, j] + x[17] * A[17, j] + x[18] * A[18, j] + x[19] * A[19, j]
                + x[20] * A[20, j] + x[21] * A[21, j] + x[22] * A[22, j] + x[23] * A[23, j]
            )  # fmt: skip


@kernel
def inner(out: Array, X: Array, Y: Array) -> None:
    """Out = X Y^T, (3, 3) of (3, 24) each."""
    for a in range(3):
        for b in range(3):
            s = 0.0
            for k in range(N):
                s += X[a, k] * Y[b, k]
            out[a, b] = s


@kernel
def add_outer(A: Array, sign: float, X: Array, Y: Array) -> None:
    """A <- A + sign X^T Y for rows (3, 24)."""
    n = A.shape[0]
    for i in range(n):
        x_0 = sign * X[0, i]
        x_1 = sign * X[1, i]
        x_2 = sign * X[2, i]
        for j in range(n):
            A[i, j] += x_0 * Y[0, j] + x_1 * Y[1, j] + x_2 * Y[2, j]


@kernel
def whitener(B: Array, P_cc: Array, R: Array) -> bool:
    """B = L^-1 with L L^T = P_cc + R; False when that is not positive definite."""
    s_00 = P_cc[0, 0] + R[0, 0]
    if not s_00 > 0.0 or math.isinf(s_00):
        return False
    b_0 = 1.0 / math.sqrt(s_00)
    l_10 = (P_cc[1, 0] + R[1, 0]) * b_0
    l_20 = (P_cc[2, 0] + R[2, 0]) * b_0
    s_11 = P_cc[1, 1] + R[1, 1] - l_10 * l_10
    if not s_11 > 0.0 or math.isinf(s_11):
        return False
    b_1 = 1.0 / math.sqrt(s_11)
    l_21 = (P_cc[2, 1] + R[2, 1] - l_20 * l_10) * b_1
    s_22 = P_cc[2, 2] + R[2, 2] - l_20 * l_20 - l_21 * l_21
    if not s_22 > 0.0 or math.isinf(s_22):
        return False
    b_2 = 1.0 / math.sqrt(s_22)
    B[0, 0] = b_0
    B[1, 0] = -l_10 * b_0 * b_1
    B[1, 1] = b_1
    B[2, 0] = -(l_20 * b_0 + l_21 * B[1, 0]) * b_2
    B[2, 1] = -l_21 * b_1 * b_2
    B[2, 2] = b_2
    return True


@kernel
def whiten(out: Array, B: Array, X: Array) -> None:
    """Out = B X for three rows, B lower triangular; out is not X."""
    for j in range(X.shape[1]):
        out[0, j] = B[0, 0] * X[0, j]
        out[1, j] = B[1, 0] * X[0, j] + B[1, 1] * X[1, j]
        out[2, j] = B[2, 0] * X[0, j] + B[2, 1] * X[1, j] + B[2, 2] * X[2, j]


@kernel
def solve_rows(X: Array, L: Array, m: int) -> None:
    """X <- S^-1 X for (m, 3), S = L L^T."""
    for c in range(3):
        for a in range(m):
            s = X[a, c]
            for b in range(a):
                s -= L[a, b] * X[b, c]
            X[a, c] = s / L[a, a]
        for n in range(m):
            a = m - 1 - n
            s = X[a, c]
            for b in range(a + 1, m):
                s -= L[b, a] * X[b, c]
            X[a, c] = s / L[a, a]


@kernel
def add_mean(mean: Array, sign: float, W: Array, B: Array, z: Array) -> None:
    """Mean <- mean + sign W^T B z."""
    w_0 = sign * B[0, 0] * z[0]
    w_1 = sign * (B[1, 0] * z[0] + B[1, 1] * z[1])
    w_2 = sign * (B[2, 0] * z[0] + B[2, 1] * z[1] + B[2, 2] * z[2])
    for i in range(N):
        mean[i] += W[0, i] * w_0 + W[1, i] * w_1 + W[2, i] * w_2
