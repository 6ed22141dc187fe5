"""Three combinations of the error as rows (3, 24): products, sums and whitening of them."""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from .update import MARKOV, NAV, N, leading_nine


@kernel
def step_columns(C: Array, Phi: Array, work: Array) -> None:
    """C^T <- C^T Phi^T for three rows; work is (3, 24). From NAV to MARKOV Phi is one."""
    for a in range(3):
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(C[a])
        x_9, x_10, x_11, x_12, x_13, x_14 = (
            C[a, 9],
            C[a, 10],
            C[a, 11],
            C[a, 12],
            C[a, 13],
            C[a, 14],
        )
        for i in range(NAV):
            work[a, i] = (
                Phi[i, 0] * x_0 + Phi[i, 1] * x_1 + Phi[i, 2] * x_2
                + Phi[i, 3] * x_3 + Phi[i, 4] * x_4 + Phi[i, 5] * x_5
                + Phi[i, 6] * x_6 + Phi[i, 7] * x_7 + Phi[i, 8] * x_8
                + Phi[i, 9] * x_9 + Phi[i, 10] * x_10 + Phi[i, 11] * x_11
                + Phi[i, 12] * x_12 + Phi[i, 13] * x_13 + Phi[i, 14] * x_14
            )  # fmt: skip
    for a in range(3):
        for i in range(NAV):
            C[a, i] = work[a, i]
    for i in range(MARKOV, N):
        d = Phi[i, i]
        for a in range(3):
            C[a, i] *= d


@kernel
def step_rows(Y: Array, Phi: Array, work: Array) -> None:
    """Y <- Y Phi for three rows; work is (3, 24). From NAV to MARKOV Phi is one."""
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
        for j in range(NAV, MARKOV):
            Y[a, j] = work[a, j] + Y[a, j]
        for j in range(MARKOV, N):
            Y[a, j] = work[a, j] + Phi[j, j] * Y[a, j]


@kernel
def rows_times(out: Array, X: Array, A: Array) -> None:
    """Out = X A for three rows X and a square A, in one expression of 24 products."""
    for a in range(3):
        x = X[a]
        # As numbers: in an array they would be read again, for `out` might be in front of them.
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(x)
        x_9, x_10, x_11, x_12, x_13 = x[9], x[10], x[11], x[12], x[13]
        x_14, x_15, x_16, x_17, x_18 = x[14], x[15], x[16], x[17], x[18]
        x_19, x_20, x_21, x_22, x_23 = x[19], x[20], x[21], x[22], x[23]
        for j in range(N):
            out[a, j] = (
                x_0 * A[0, j] + x_1 * A[1, j] + x_2 * A[2, j] + x_3 * A[3, j]
                + x_4 * A[4, j] + x_5 * A[5, j] + x_6 * A[6, j] + x_7 * A[7, j]
                + x_8 * A[8, j] + x_9 * A[9, j] + x_10 * A[10, j] + x_11 * A[11, j]
                + x_12 * A[12, j] + x_13 * A[13, j] + x_14 * A[14, j] + x_15 * A[15, j]
                + x_16 * A[16, j] + x_17 * A[17, j] + x_18 * A[18, j] + x_19 * A[19, j]
                + x_20 * A[20, j] + x_21 * A[21, j] + x_22 * A[22, j] + x_23 * A[23, j]
            )  # fmt: skip


@kernel
def inner(out: Array, X: Array, Y: Array) -> None:
    """Out = X Y^T, (3, 3) of (3, 24) each: nine sums side by side, each along its rows."""
    s_00 = s_01 = s_02 = 0.0
    s_10 = s_11 = s_12 = 0.0
    s_20 = s_21 = s_22 = 0.0
    for k in range(N):
        y_0 = Y[0, k]
        y_1 = Y[1, k]
        y_2 = Y[2, k]
        s_00 += X[0, k] * y_0
        s_01 += X[0, k] * y_1
        s_02 += X[0, k] * y_2
        s_10 += X[1, k] * y_0
        s_11 += X[1, k] * y_1
        s_12 += X[1, k] * y_2
        s_20 += X[2, k] * y_0
        s_21 += X[2, k] * y_1
        s_22 += X[2, k] * y_2
    out[0, 0], out[0, 1], out[0, 2] = s_00, s_01, s_02
    out[1, 0], out[1, 1], out[1, 2] = s_10, s_11, s_12
    out[2, 0], out[2, 1], out[2, 2] = s_20, s_21, s_22


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
