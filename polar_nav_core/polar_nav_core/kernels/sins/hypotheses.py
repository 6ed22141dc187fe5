"""Bank of hypotheses about slow faults: their signatures in state and residuals, and the evidence.

A hypothesis is a fault of one kind with unit size that began at a given time. Its signature s, the
change of the estimated error per unit of it, obeys the equation of a common error (`consider`):
s <- Phi s + drive, s <- s - K g with g = H s + direct, the change of the innovation. So does the
change d of what innovations show of the common errors (`shared`). With the residual's change
h = g - J d and covariance V,

    Lambda = sum h^T V^-1 h,    zeta = sum h^T V^-1 e,    T = zeta^2 / Lambda

is a generalized likelihood ratio (Willsky, Jones 1976), chi-square (1) while residuals e are white
with V, whatever the signature, as long as h depends on residuals before only. So signatures may be
approximate, which costs power only: pings and depths are added up over a window and answered at
its end, with the gain and the transition of then. The rows are those of its first residual: those
of the DVL's scale are the estimated velocity, which each ping moves, so that rows of the end would
be correlated with the residuals of the window. Derivation: docs/derivations/signatures.md.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from ..evidence import pair_statistic
from .consider import COLUMNS
from .update import ACCEL, DV, GYRO, MARKOV, NAV, SCALE, USBL, N

# Kinds of faults; the unit of each.
FIX_EAST = 0  # fixes drift to grid east, 1 m/s
FIX_NORTH = 1  # fixes drift to grid north, 1 m/s
SCALE_GROWS = 2  # the DVL's scale grows, 1/s
SCALE_STEP = 3  # the DVL's scale has changed, 1
GYRO_X = 4  # the bias of the gyro about body x has changed, 1 rad/s
GYRO_Y = 5  # the bias of the gyro about body y has changed, 1 rad/s
STEP_EAST = 6  # fixes have moved to grid east, 1 m
STEP_NORTH = 7  # fixes have moved to grid north, 1 m
ACCEL_GROWS = 8  # the bias of the accelerometer along body z grows, 1 m/s^3
KINDS = 9
PAIRS = (FIX_EAST, GYRO_X, STEP_EAST)
"""Kinds of which each is one direction, the next kind the other: they have one statistic."""
SLOTS = 12
"""Beginnings that are kept; hypothesis of kind k that began at slot i: column i * KINDS + k."""

# Rows of the bank.
LEARNED = N  # COLUMNS rows: d, per stated sigma
LAMBDA = N + COLUMNS
ZETA = LAMBDA + 1
CROSS = LAMBDA + 2  # Lambda between both of a pair, at the first of them
STATISTIC = LAMBDA + 3  # T; of a pair together chi-square (2)
ROWS = LAMBDA + 4
SCRATCH = NAV

FIRST_H = 4
FIRST_J = FIRST_H + 3 * N
WINDOW = FIRST_J + 3 * COLUMNS
"""Of a window: sum of V^-1 e (3), number, rows H and J (per sigma) of its first residual."""
MOST_AT_ONCE = 50


@kernel
def advance_signatures(bank: Array, Phi: Array, step: float, dt: float, M: Array) -> None:
    """Signatures dt [s] later, with the transition of a step [s] in proportion.

    Parameters
    ----------
    bank : (ROWS, n) array, in place
    Phi : (24, 24) array
        As in `consider.predict_sensitivity`.
    step, dt : float
        [s].
    M : (SCRATCH, n) scratch
    """
    ratio = dt / step
    for i in range(NAV):  # one expression of COUPLED products
        x_0, x_1, x_2 = _part(Phi, i, 0, ratio), _part(Phi, i, 1, ratio), _part(Phi, i, 2, ratio)
        x_3, x_4, x_5 = _part(Phi, i, 3, ratio), _part(Phi, i, 4, ratio), _part(Phi, i, 5, ratio)
        x_6, x_7, x_8 = _part(Phi, i, 6, ratio), _part(Phi, i, 7, ratio), _part(Phi, i, 8, ratio)
        x_9, x_10 = _part(Phi, i, 9, ratio), _part(Phi, i, 10, ratio)
        x_11, x_12 = _part(Phi, i, 11, ratio), _part(Phi, i, 12, ratio)
        x_13, x_14 = _part(Phi, i, 13, ratio), _part(Phi, i, 14, ratio)
        for c in range(bank.shape[1]):
            M[i, c] = (
                bank[i, c]
                + x_0 * bank[0, c] + x_1 * bank[1, c] + x_2 * bank[2, c]
                + x_3 * bank[3, c] + x_4 * bank[4, c] + x_5 * bank[5, c]
                + x_6 * bank[6, c] + x_7 * bank[7, c] + x_8 * bank[8, c]
                + x_9 * bank[9, c] + x_10 * bank[10, c] + x_11 * bank[11, c]
                + x_12 * bank[12, c] + x_13 * bank[13, c] + x_14 * bank[14, c]
            )  # fmt: skip
    for i in range(NAV):
        for c in range(bank.shape[1]):
            bank[i, c] = M[i, c]
    markov = Phi[MARKOV, MARKOV] ** ratio
    usbl = Phi[USBL, USBL] ** ratio
    for k in range(3):
        for c in range(bank.shape[1]):
            bank[MARKOV + k, c] *= markov
            bank[USBL + k, c] *= usbl


@kernel
def _part(Phi: Array, i: int, k: int, ratio: float) -> float:
    """That part of an element of a step's change of the error, Phi - I."""
    part: float = ratio * (Phi[i, k] - (1.0 if i == k else 0.0))
    return part


@kernel
def grow(bank: Array, slot: int, dt: float) -> None:
    """Let what grows in a slot, a scale and a bias, act for dt [s]."""
    for k in range(3):
        bank[SCALE + k, slot * KINDS + SCALE_GROWS] += dt
    bank[ACCEL + 2, slot * KINDS + ACCEL_GROWS] += dt


@kernel
def begin_slot(bank: Array, slot: int) -> None:
    """Begin the hypotheses of a slot now; steps are in the state at once."""
    for kind in range(KINDS):
        for i in range(bank.shape[0]):
            bank[i, slot * KINDS + kind] = 0.0
    for k in range(3):
        bank[SCALE + k, slot * KINDS + SCALE_STEP] = 1.0
    bank[GYRO, slot * KINDS + GYRO_X] = 1.0
    bank[GYRO + 1, slot * KINDS + GYRO_Y] = 1.0


@kernel
def change_of_innovation(g: Array, bank: Array, H: Array, delay: float, m: int) -> None:
    """Change of an innovation by state: g <- H s, m rows.

    Rows that were valid ``delay`` [s] ago are treated as in `consider.late_sensitivity`.
    """
    for a in range(m):
        for c in range(g.shape[1]):
            g[a, c] = -delay * bank[DV + a, c]
    if m == 3:
        for k in range(0, N, 3):  # a vector's three states at once
            if _are_zero(H, k):
                continue
            x_0, x_1, x_2 = H[0, k], H[0, k + 1], H[0, k + 2]
            y_0, y_1, y_2 = H[1, k], H[1, k + 1], H[1, k + 2]
            z_0, z_1, z_2 = H[2, k], H[2, k + 1], H[2, k + 2]
            for c in range(g.shape[1]):
                b_0, b_1, b_2 = bank[k, c], bank[k + 1, c], bank[k + 2, c]
                g[0, c] = g[0, c] + x_0 * b_0 + x_1 * b_1 + x_2 * b_2
                g[1, c] = g[1, c] + y_0 * b_0 + y_1 * b_1 + y_2 * b_2
                g[2, c] = g[2, c] + z_0 * b_0 + z_1 * b_1 + z_2 * b_2
        return
    for a in range(m):
        for k in range(N):
            h = H[a, k]
            if h != 0.0:
                for c in range(g.shape[1]):
                    g[a, c] += h * bank[k, c]


@kernel
def _are_zero(H: Array, k: int) -> bool:
    """Whether three rows are zero in columns k to k + 2."""
    for a in range(3):
        for i in range(3):
            if H[a, k + i] != 0.0:
                return False
    return True


@kernel
def change_of_residual(h: Array, g: Array, bank: Array, J: Array, L: Array, m: int) -> None:
    """Change of the whitened residual: h <- L^-1 (g - J d); J (3, COLUMNS) per sigma."""
    for a in range(m):
        for c in range(h.shape[1]):
            h[a, c] = g[a, c]
    if m == 3:
        for k in range(COLUMNS):
            x_0, x_1, x_2 = J[0, k], J[1, k], J[2, k]
            if x_0 != 0.0 or x_1 != 0.0 or x_2 != 0.0:
                for c in range(h.shape[1]):
                    d = bank[LEARNED + k, c]
                    h[0, c] -= x_0 * d
                    h[1, c] -= x_1 * d
                    h[2, c] -= x_2 * d
        l_10, l_20, l_21 = L[1, 0], L[2, 0], L[2, 1]
        i_0, i_1, i_2 = 1.0 / L[0, 0], 1.0 / L[1, 1], 1.0 / L[2, 2]
        for c in range(h.shape[1]):
            h_0 = h[0, c] * i_0
            h_1 = (h[1, c] - l_10 * h_0) * i_1
            h[0, c] = h_0
            h[1, c] = h_1
            h[2, c] = (h[2, c] - l_20 * h_0 - l_21 * h_1) * i_2
        return
    for a in range(m):
        for k in range(COLUMNS):
            x = J[a, k]
            if x != 0.0:
                for c in range(h.shape[1]):
                    h[a, c] -= x * bank[LEARNED + k, c]
        for b in range(a):
            x = L[a, b]
            for c in range(h.shape[1]):
                h[a, c] -= x * h[b, c]
        x = 1.0 / L[a, a]
        for c in range(h.shape[1]):
            h[a, c] *= x


@kernel
def add_evidence(bank: Array, h: Array, v: Array, number: float, m: int) -> None:
    """Add ``number`` residuals to the evidence; v (3,) is the sum of them, whitened."""
    for a in range(m):
        x = v[a]
        for c in range(h.shape[1]):
            bank[LAMBDA, c] += number * h[a, c] * h[a, c]
            bank[ZETA, c] += x * h[a, c]
        for slot in range(SLOTS):
            for kind in PAIRS:
                i = slot * KINDS + kind
                bank[CROSS, i] += number * h[a, i] * h[a, i + 1]
    for c in range(h.shape[1]):
        square = bank[ZETA, c] * bank[ZETA, c]
        bank[STATISTIC, c] = square / bank[LAMBDA, c] if bank[LAMBDA, c] > 0.0 else 0.0
    for slot in range(SLOTS):
        for kind in PAIRS:
            _add_pair(bank, slot * KINDS + kind)


@kernel
def _add_pair(bank: Array, i: int) -> None:
    """Fill the statistic of columns i and i + 1 together."""
    both = pair_statistic(
        bank[LAMBDA, i], bank[LAMBDA, i + 1], bank[CROSS, i], bank[ZETA, i], bank[ZETA, i + 1]
    )
    bank[STATISTIC, i] = both
    bank[STATISTIC, i + 1] = both


@kernel
def repeated(X: Array, A: Array, B: Array, number: int, m: int) -> None:
    """X <- sum of (I - A B^T)^i over i < number, (m, m); rows of A and B of one length."""
    for a in range(m):
        for b in range(m):
            s = 0.0
            for k in range(A.shape[1]):
                s += A[a, k] * B[b, k]
            X[3 + a, b] = s
            X[a, b] = 1.0 if a == b else 0.0
    for _ in range(number - 1):
        for b in range(m):
            for a in range(m):
                s = 0.0
                for k in range(m):
                    s += X[3 + a, k] * X[k, b]
                X[6 + a, b] = s
        for a in range(m):
            for b in range(m):
                X[a, b] += (1.0 if a == b else 0.0) - X[6 + a, b]


@kernel
def mean_change(mean: Array, X: Array, g: Array, number: int, m: int) -> None:
    """Change of an innovation on average over so many equal updates: mean <- X g / number.

    Each of them takes a part of the change out of the next.
    """
    for a in range(m):
        for c in range(g.shape[1]):
            mean[a, c] = 0.0
        for b in range(m):
            x = X[a, b] / number
            for c in range(g.shape[1]):
                mean[a, c] += x * g[b, c]


@kernel
def answer(bank: Array, first: int, K: Array, X: Array, g: Array, sign: float, m: int) -> None:
    """Rows from ``first`` on += sign K^T X g: what a gain K (m, rows) makes of a change g."""
    if m == 3:
        for i in range(K.shape[1]):
            k_0, k_1, k_2 = K[0, i], K[1, i], K[2, i]
            gain_0 = sign * (k_0 * X[0, 0] + k_1 * X[1, 0] + k_2 * X[2, 0])
            gain_1 = sign * (k_0 * X[0, 1] + k_1 * X[1, 1] + k_2 * X[2, 1])
            gain_2 = sign * (k_0 * X[0, 2] + k_1 * X[1, 2] + k_2 * X[2, 2])
            if gain_0 != 0.0 or gain_1 != 0.0 or gain_2 != 0.0:
                row = bank[first + i]
                for c in range(g.shape[1]):
                    row[c] = row[c] + gain_0 * g[0, c] + gain_1 * g[1, c] + gain_2 * g[2, c]
        return
    for b in range(m):
        for i in range(K.shape[1]):
            gain = 0.0
            for a in range(m):
                gain += K[a, i] * X[a, b]
            gain *= sign
            if gain != 0.0:
                for c in range(g.shape[1]):
                    bank[first + i, c] += gain * g[b, c]
