"""Adjoint of a smoother and its covariance, carried backwards over a filter's steps and updates.

The adjoint stands in columns, (n, 1 + COLUMNS): lambda, and beside it its change per unit of each
common error; (n, 1) where there are none. Inner loops run along rows, as in `update`, so that the
compiler uses vectors without changing the order of any sum. Equations:
docs/derivations/smoother.md.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .model import MOVING
from .three_rows import solve_rows
from .update import COUPLED, NAV, N, leading_nine, subtract

PHI = NAV * COUPLED + COUPLED
"""Numbers of a transition that are kept: its first nine rows, then its diagonal below them."""
_DIAGONAL = NAV * COUPLED - NAV
"""Place of the diagonal's first value, were it kept from the first state on."""


@kernel
def _step_adjoint(phi: Array, adjoint: Array, M: Array) -> None:
    """Adjoint <- Phi^T adjoint; M is scratch (n, n)."""
    A = phi[: NAV * COUPLED].reshape((NAV, COUPLED))
    columns = adjoint.shape[1]
    if columns == 1:  # along the rows of Phi
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(adjoint[:, 0])
        for j in range(A.shape[1]):
            M[0, j] = (
                A[0, j] * x_0 + A[1, j] * x_1 + A[2, j] * x_2
                + A[3, j] * x_3 + A[4, j] * x_4 + A[5, j] * x_5
                + A[6, j] * x_6 + A[7, j] * x_7 + A[8, j] * x_8
            )  # fmt: skip
        for j in range(NAV):
            adjoint[j, 0] = M[0, j]
        for j in range(NAV, COUPLED):
            adjoint[j, 0] = M[0, j] + phi[_DIAGONAL + j] * adjoint[j, 0]
        for j in range(COUPLED, N):
            adjoint[j, 0] *= phi[_DIAGONAL + j]
        return
    for j in range(COUPLED):
        for r in range(columns):
            M[j, r] = (
                A[0, j] * adjoint[0, r] + A[1, j] * adjoint[1, r] + A[2, j] * adjoint[2, r]
                + A[3, j] * adjoint[3, r] + A[4, j] * adjoint[4, r] + A[5, j] * adjoint[5, r]
                + A[6, j] * adjoint[6, r] + A[7, j] * adjoint[7, r] + A[8, j] * adjoint[8, r]
            )  # fmt: skip
    for j in range(NAV):
        for r in range(columns):
            adjoint[j, r] = M[j, r]
    for j in range(NAV, COUPLED):
        d = phi[_DIAGONAL + j]
        for r in range(columns):
            adjoint[j, r] = M[j, r] + d * adjoint[j, r]
    for j in range(COUPLED, N):
        d = phi[_DIAGONAL + j]
        for r in range(columns):
            adjoint[j, r] *= d


@kernel
def _step_information(phi: Array, information: Array, w: Array) -> None:
    """Lambda <- Phi^T Lambda Phi, symmetric to the bit; w is scratch (2, 24, 24).

    All loops are as long as a row, with zeros where Phi has none: three times as fast as without
    those, for which the compiler would have to leave its vectors. What couples the states from
    COUPLED on with the others is rows of Lambda Phi, scaled.
    """
    n = information.shape[0]
    M, A, D = w[0], w[1], w[1, NAV]  # Lambda Phi; first nine rows and diagonal of Phi
    for i in range(NAV):
        D[i] = 0.0
        for j in range(COUPLED):
            A[i, j] = phi[i * COUPLED + j]
        for j in range(COUPLED, n):
            A[i, j] = 0.0
    for j in range(NAV, n):
        D[j] = phi[_DIAGONAL + j]
    for i in range(COUPLED):
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(information[i])
        for j in range(n):
            M[i, j] = (
                x_0 * A[0, j] + x_1 * A[1, j] + x_2 * A[2, j]
                + x_3 * A[3, j] + x_4 * A[4, j] + x_5 * A[5, j]
                + x_6 * A[6, j] + x_7 * A[7, j] + x_8 * A[8, j]
                + information[i, j] * D[j]
            )  # fmt: skip
    for i in range(COUPLED):
        x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8 = leading_nine(A[:, i])
        d = D[i]
        for j in range(n):
            information[i, j] = (
                x_0 * M[0, j] + x_1 * M[1, j] + x_2 * M[2, j]
                + x_3 * M[3, j] + x_4 * M[4, j] + x_5 * M[5, j]
                + x_6 * M[6, j] + x_7 * M[7, j] + x_8 * M[8, j]
                + d * M[i, j]
            )  # fmt: skip
    for i in range(COUPLED, n):
        d = D[i]
        for j in range(COUPLED, n):
            information[i, j] *= d * D[j]
    for i in range(1, n):
        for j in range(i):
            information[i, j] = information[j, i]


@kernel
def _apply_step(phi: Array, model: Array, x: Array, out: Array) -> None:
    """Write Phi^T x for each column of x (n, k) into ``out``, with the states of a model.

    ``model``, (3, 31), has the first rows of the states of a vehicle's model, which are n - 24;
    those below them are constant.
    """
    n, columns = x.shape
    for j in range(n):
        for r in range(columns):
            s = 0.0
            if j < COUPLED:
                for i in range(NAV):
                    s += phi[i * COUPLED + j] * x[i, r]
            if NAV <= j < N:
                s += phi[_DIAGONAL + j] * x[j, r]
            elif j >= N + MOVING:
                s += x[j, r]
            for i in range(MOVING):
                s += model[i, j] * x[N + i, r]
            out[j, r] = s


@kernel
def adjoint_before_step(adjoint: Array, phi: Array, model: Array, w: Array) -> None:
    """Carry the adjoint to before a step: as `step_back`, without Lambda."""
    n, columns = adjoint.shape
    if n == N:
        _step_adjoint(phi, adjoint, w[0])
        return
    _apply_step(phi, model, adjoint, w[0, :, :columns])
    for i in range(n):
        for r in range(columns):
            adjoint[i, r] = w[0, i, r]


@kernel
def step_back(adjoint: Array, information: Array, phi: Array, model: Array, w: Array) -> None:
    """Carry adjoint (n, columns) and Lambda (n, n) to before a step; w (2, n, n) scratch.

    lambda <- Phi^T lambda, Lambda <- Phi^T Lambda Phi. Phi as `PHI` numbers, and ``model``, which
    is read where n is more than 24.
    """
    n = adjoint.shape[0]
    adjoint_before_step(adjoint, phi, model, w)
    if n == N:
        _step_information(phi, information, w)
        return
    _apply_step(phi, model, information, w[0])
    for i in range(n):
        for j in range(n):
            w[1, j, i] = w[0, i, j]
    _apply_step(phi, model, w[1], w[0])
    for i in range(n):
        for j in range(i + 1):
            s = 0.5 * (w[0, i, j] + w[0, j, i])
            information[i, j] = s
            information[j, i] = s


@kernel
def inverse(L: Array, m: int, out: Array) -> None:
    """Write (L L^T)^-1, first m rows and columns, into ``out`` (3, 3)."""
    for a in range(3):
        for b in range(3):
            out[a, b] = 1.0 if a == b else 0.0
    solve_rows(out, L, m)


@kernel
def _times_three(Y: Array, K: Array, information: Array) -> None:
    """Y <- K Lambda, of three rows; four products at a time."""
    n = information.shape[0]
    for i in range(n):
        Y[0, i] = Y[1, i] = Y[2, i] = 0.0
    j = 0
    while j + 4 <= n:
        p_0, p_1, p_2, p_3 = K[0, j], K[0, j + 1], K[0, j + 2], K[0, j + 3]
        q_0, q_1, q_2, q_3 = K[1, j], K[1, j + 1], K[1, j + 2], K[1, j + 3]
        r_0, r_1, r_2, r_3 = K[2, j], K[2, j + 1], K[2, j + 2], K[2, j + 3]
        for i in range(n):
            a, b = information[j, i], information[j + 1, i]
            c, d = information[j + 2, i], information[j + 3, i]
            Y[0, i] = Y[0, i] + p_0 * a + p_1 * b + p_2 * c + p_3 * d
            Y[1, i] = Y[1, i] + q_0 * a + q_1 * b + q_2 * c + q_3 * d
            Y[2, i] = Y[2, i] + r_0 * a + r_1 * b + r_2 * c + r_3 * d
        j += 4
    for r in range(j, n):
        for a in range(3):
            k = K[a, r]
            for i in range(n):
                Y[a, i] += k * information[r, i]


@kernel
def _inner_three(A: Array, K: Array, Y: Array) -> None:
    """A <- K Y^T of three rows, which is symmetric: six sums side by side."""
    s_00 = s_10 = s_11 = s_20 = s_21 = s_22 = 0.0
    for i in range(K.shape[1]):
        k_0, k_1, k_2 = K[0, i], K[1, i], K[2, i]
        s_00 += k_0 * Y[0, i]
        s_10 += k_1 * Y[0, i]
        s_11 += k_1 * Y[1, i]
        s_20 += k_2 * Y[0, i]
        s_21 += k_2 * Y[1, i]
        s_22 += k_2 * Y[2, i]
    A[0, 0], A[1, 1], A[2, 2] = s_00, s_11, s_22
    A[1, 0] = A[0, 1] = s_10
    A[2, 0] = A[0, 2] = s_20
    A[2, 1] = A[1, 2] = s_21


@kernel
def measure_back(
    adjoint: Array,
    information: Array,
    K: Array,
    L: Array,
    z: Array,
    moved: Array,
    m: int,
    w: Array,
) -> None:
    """Fill what a measurement of m rows needs backwards, and `smooth.leave_out`.

    Into the scratch: S^-1 into w[1, :3], K^T Lambda K into w[1, 6:9], Lambda K into w[1, 12:15],
    and u = S^-1 z + K^T lambda into w[0, :3], a column of it for lambda and for its change per
    unit of each common error.

    Parameters
    ----------
    adjoint : (n, 1 + COLUMNS) or (n, 1) array
        lambda after the measurement, and beside it its change per unit of each common error, where
        there are any.
    information : (n, n) array
        Lambda.
    K : (3, n) array
        Transposed gain; of a measurement that was refused that which it would have had.
    L : (3, 3) array
        Cholesky factor of S.
    z, moved : (3,), (3, COLUMNS) arrays
        Innovation, and its change per unit of each common error; read where there are any.
    m : int
    w : (2, n, n) array
        Scratch.
    """
    n, columns = adjoint.shape
    weight, A, Y, u = w[1, :3], w[1, 6:9], w[1, 12:15], w[0, :3]
    inverse(L, m, weight[:, :3])
    if m == 3:
        _times_three(Y, K, information)
        _inner_three(A, K, Y)
    else:
        for a in range(3):
            for i in range(n):
                Y[a, i] = 0.0
        for a in range(m):
            for j in range(n):
                k = K[a, j]
                for i in range(n):
                    Y[a, i] += k * information[j, i]
            for b in range(a + 1):
                s = 0.0
                for i in range(n):
                    s += K[a, i] * Y[b, i]
                A[a, b] = s
                A[b, a] = s
    for a in range(m):
        s = 0.0
        for i in range(n):
            s += K[a, i] * adjoint[i, 0]
        for b in range(m):
            s += weight[a, b] * z[b]
        u[a, 0] = s
        if columns == 1:
            continue
        for r in range(1, columns):
            u[a, r] = 0.0
        for i in range(n):
            k = K[a, i]
            for r in range(1, columns):
                u[a, r] += k * adjoint[i, r]
        for b in range(m):
            k = weight[a, b]
            for r in range(1, columns):
                u[a, r] += k * moved[b, r - 1]


@kernel
def adjoint_before_update(adjoint: Array, H: Array, m: int, w: Array) -> None:
    """Carry the adjoint to before a fused measurement of m rows, after `measure_back`.

    lambda <- (I - K H)^T lambda - H^T S^-1 z.

    Parameters
    ----------
    adjoint : (n, columns) array, in place
    H : (3, n) array
        Rows; zero from m on.
    m : int
    w : (2, n, n) array
        Scratch.
    """
    n, columns = adjoint.shape
    u = w[0, :3]
    if m == 3 and columns == 1:
        u_0, u_1, u_2 = u[0, 0], u[1, 0], u[2, 0]
        for i in range(n):
            adjoint[i, 0] = adjoint[i, 0] - H[0, i] * u_0 - H[1, i] * u_1 - H[2, i] * u_2
        return
    for i in range(n):
        for a in range(m):
            h = H[a, i]
            if h != 0.0:
                for r in range(columns):
                    adjoint[i, r] -= h * u[a, r]


@kernel
def information_before_update(information: Array, H: Array, m: int, w: Array) -> None:
    """Carry Lambda (n, n) to before a fused measurement of m rows, after `measure_back`.

    Lambda <- (I - K H)^T Lambda (I - K H) + H^T S^-1 H; arguments as of `adjoint_before_update`.
    """
    n = information.shape[0]
    weight, A, Y = w[1, :3], w[1, 6:9], w[1, 12:15]
    # With Y = Lambda K: Lambda - Y H - H^T Y^T + H^T (K^T Y + S^-1) H; half of the last term on
    # either side keeps Lambda symmetric.
    if m == 1:
        s = 0.5 * (A[0, 0] + weight[0, 0])
        for i in range(n):
            Y[0, i] -= s * H[0, i]
        for i in range(n):
            h = H[0, i]
            y = Y[0, i]
            for j in range(n):
                information[i, j] -= h * Y[0, j] + y * H[0, j]
        return
    for a in range(m):
        s_0 = 0.5 * (A[a, 0] + weight[a, 0])
        s_1 = 0.5 * (A[a, 1] + weight[a, 1])
        s_2 = 0.5 * (A[a, 2] + weight[a, 2]) if m == 3 else 0.0
        for i in range(n):
            Y[a, i] = Y[a, i] - s_0 * H[0, i] - s_1 * H[1, i] - s_2 * H[2, i]
    subtract(information, H, Y, H, Y)
