"""Common errors (constants that are not estimated): sensitivity and added covariance of the state.

A constant error b that measurements share (the zero of depth, a turned DVL, a scale error of
ranges) moves the estimate by S b, whatever the filter believes: with any gain K the error obeys
e <- Phi e and e <- e - K (H e + J b), which is linear in b. The sensitivity S (24, COLUMNS) is
carried beside the covariance, the gain stays what it was, and what is published is
P + S B S^T with B = diag(sigma^2) (docs/derivations/common_errors.md).
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel
from .update import MARKOV, NAV, N

# Columns of S and J, and places of their sigmas.
RANGE_SCALE = 0
ARRAY_TURN = 1
CLOCK = 2
OFFSET = 3  # three, grid axes
DVL_YAW = 6
DVL_PITCH = 7
DVL_LEVER_X = 8
DVL_LEVER_Y = 9
DVL_LATENCY = 10
DEPTH_ZERO = 11
LEADER = 12  # four: turn and scale of the leader's way, its error at the start east and north
COLUMNS = 16

PHI = 0
DV = 3
DR = 6


@kernel
def predict_sensitivity(S: Array, Phi: Array, M: Array) -> None:
    """S <- Phi S for a transition that is full in its first nine rows and diagonal below.

    Parameters
    ----------
    S : (24, COLUMNS) array, in place
        Change of the estimated error per unit of each common error.
    Phi : (24, 24) array
        Full in rows 0..8 and columns 0..14; diagonal below, ones to MARKOV.
    M : array of at least (9, COLUMNS)
        Scratch.
    """
    n = S.shape[1]
    for i in range(NAV):  # one expression of COUPLED products
        for c in range(n):
            M[i, c] = (
                Phi[i, 0] * S[0, c] + Phi[i, 1] * S[1, c] + Phi[i, 2] * S[2, c]
                + Phi[i, 3] * S[3, c] + Phi[i, 4] * S[4, c] + Phi[i, 5] * S[5, c]
                + Phi[i, 6] * S[6, c] + Phi[i, 7] * S[7, c] + Phi[i, 8] * S[8, c]
                + Phi[i, 9] * S[9, c] + Phi[i, 10] * S[10, c] + Phi[i, 11] * S[11, c]
                + Phi[i, 12] * S[12, c] + Phi[i, 13] * S[13, c] + Phi[i, 14] * S[14, c]
            )  # fmt: skip
    for i in range(NAV):
        for c in range(n):
            S[i, c] = M[i, c]
    for i in range(MARKOV, N):
        d = Phi[i, i]
        for c in range(n):
            S[i, c] *= d


@kernel
def innovation_sensitivity(J: Array, H: Array, S: Array, m: int) -> None:
    """J <- H S + J: change of the innovation per unit of each common error, first m rows."""
    for k in range(N):
        for a in range(m):
            h = H[a, k]
            if h != 0.0:
                for c in range(S.shape[1]):
                    J[a, c] += h * S[k, c]


@kernel
def late_sensitivity(J: Array, S: Array, delay: float) -> None:
    """J of a fix that was valid ``delay`` [s] ago less what S has moved since: first order.

    The rows of a late fix are those of the position then, S is that of now; position has moved by
    the velocity's part since. J (3, COLUMNS) in grid axes, before `innovation_sensitivity`.
    """
    for a in range(3):
        for c in range(COLUMNS):
            J[a, c] -= delay * S[DV + a, c]


@kernel
def _add_three(
    S: Array,
    i: int,
    sigma: Array,
    s_00: float,
    s_10: float,
    s_11: float,
    s_20: float,
    s_21: float,
    s_22: float,
) -> tuple[float, float, float, float, float, float]:
    """Lower half of a block (3, 3) plus S B S^T of rows i to i + 2: six sums side by side."""
    for c in range(COLUMNS):
        x, y, z = S[i, c] * sigma[c], S[i + 1, c] * sigma[c], S[i + 2, c] * sigma[c]
        s_00 += x * x
        s_10 += y * x
        s_11 += y * y
        s_20 += z * x
        s_21 += z * y
        s_22 += z * z
    return s_00, s_10, s_11, s_20, s_21, s_22


@kernel
def widen(wide: Array, S_zz: Array, J: Array, sigma: Array, m: int) -> None:
    """Innovation covariance with the common errors: wide = S_zz + J B J^T, first m rows."""
    if m == 3:
        s_00, s_11, s_22 = S_zz[0, 0], S_zz[1, 1], S_zz[2, 2]
        s_10, s_20, s_21 = S_zz[1, 0], S_zz[2, 0], S_zz[2, 1]
        sums = _add_three(J, 0, sigma, s_00, s_10, s_11, s_20, s_21, s_22)
        s_00, s_10, s_11, s_20, s_21, s_22 = sums
        wide[0, 0], wide[1, 1], wide[2, 2] = s_00, s_11, s_22
        wide[0, 1] = wide[1, 0] = s_10
        wide[0, 2] = wide[2, 0] = s_20
        wide[1, 2] = wide[2, 1] = s_21
        return
    for a in range(m):
        for b in range(a + 1):
            s = S_zz[a, b]
            for c in range(COLUMNS):
                s += J[a, c] * J[b, c] * sigma[c] * sigma[c]
            wide[a, b] = s
            wide[b, a] = s


@entry
@kernel
def update_sensitivity(S: Array, K: Array, J: Array, m: int) -> None:
    """S <- S - K J, with J as `innovation_sensitivity` leaves it and K (3, 24) transposed."""
    if m == 3:
        for i in range(N):
            k_0, k_1, k_2 = K[0, i], K[1, i], K[2, i]
            for c in range(S.shape[1]):
                S[i, c] = S[i, c] - k_0 * J[0, c] - k_1 * J[1, c] - k_2 * J[2, c]
        return
    for a in range(m):
        for i in range(N):
            gain = K[a, i]
            for c in range(S.shape[1]):
                S[i, c] -= gain * J[a, c]


@entry
@kernel
def add_common(P: Array, S: Array, sigma: Array, T: Array) -> None:
    """P <- P + S B S^T: covariance with the common errors, (n, n) in place.

    Of all states, or of the leading ones. T, (COLUMNS, n) or more, is scratch: B^(1/2) S^T, whose
    rows stand along memory.
    """
    n = P.shape[0]
    for c in range(COLUMNS):
        for i in range(n):
            T[c, i] = sigma[c] * S[i, c]
    for i in range(n):  # one expression of COLUMNS products; below the diagonal it counts
        x_0, x_1, x_2, x_3 = T[0, i], T[1, i], T[2, i], T[3, i]
        x_4, x_5, x_6, x_7 = T[4, i], T[5, i], T[6, i], T[7, i]
        x_8, x_9, x_10, x_11 = T[8, i], T[9, i], T[10, i], T[11, i]
        x_12, x_13, x_14, x_15 = T[12, i], T[13, i], T[14, i], T[15, i]
        for j in range(n):
            P[i, j] = (
                P[i, j]
                + x_0 * T[0, j] + x_1 * T[1, j] + x_2 * T[2, j] + x_3 * T[3, j]
                + x_4 * T[4, j] + x_5 * T[5, j] + x_6 * T[6, j] + x_7 * T[7, j]
                + x_8 * T[8, j] + x_9 * T[9, j] + x_10 * T[10, j] + x_11 * T[11, j]
                + x_12 * T[12, j] + x_13 * T[13, j] + x_14 * T[14, j] + x_15 * T[15, j]
            )  # fmt: skip
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]


@kernel
def add_common_blocks(P: Array, S: Array, sigma: Array) -> None:
    """`add_common` in the blocks of three on the diagonal alone, to the same bits."""
    for i in range(0, N, 3):
        s_00, s_11, s_22 = P[i, i], P[i + 1, i + 1], P[i + 2, i + 2]
        s_10, s_20, s_21 = P[i + 1, i], P[i + 2, i], P[i + 2, i + 1]
        sums = _add_three(S, i, sigma, s_00, s_10, s_11, s_20, s_21, s_22)
        s_00, s_10, s_11, s_20, s_21, s_22 = sums
        P[i, i], P[i + 1, i + 1], P[i + 2, i + 2] = s_00, s_11, s_22
        P[i, i + 1] = P[i + 1, i] = s_10
        P[i, i + 2] = P[i + 2, i] = s_20
        P[i + 1, i + 2] = P[i + 2, i + 1] = s_21


@entry
@kernel
def add_conflict(P: Array, u: Array) -> None:
    """P <- P + u u^T: covariance that reaches to where refused fixes say that the vehicle is.

    Parameters
    ----------
    P : (24, 24) array, in place
    u : (6,) array
        What velocity (grid axes) [m/s] and position (ECEF) [m] are off by if they are right.
    """
    for i in range(6):
        if u[i] != 0.0:
            for j in range(6):
                P[DV + i, DV + j] += u[i] * u[j]


@kernel
def clear(J: Array) -> None:
    """J <- 0."""
    for a in range(3):
        for c in range(COLUMNS):
            J[a, c] = 0.0


@kernel
def dvl_common(
    J: Array,
    C_b_G: Array,
    H: Array,
    omega_b: Array,
    a_b: Array,
    lever_b: Array,
) -> None:
    """Innovation of a DVL ping per unit of each common error of the DVL.

    A turn of the DVL and one of the vehicle differ by the lever arm alone. Both therefore take
    the velocity that the ping's rows of attitude hold: were they to take two, the noise between
    them would pass for a difference that shows one and the other.

    Parameters
    ----------
    J : (3, COLUMNS) out, grid axes
        Per radian of yaw and pitch of the mounting, per metre of lever arm along x and y, per
        second of latency.
    C_b_G : (3, 3)
        Attitude.
    H : (3, N), grid axes
        Rows of the ping.
    omega_b, a_b : (3,)
        Rate [rad/s], and the change of the velocity in body axes [m/s^2] (swing).
    lever_b : (3,)
        Place of the instrument, body axes [m].
    """
    clear(J)
    V_x, V_y, V_z = H[1, PHI + 2], -H[0, PHI + 2], H[0, PHI + 1]  # those rows are -[V x]
    # Velocity of the instrument, body axes.
    x = C_b_G[0, 0] * V_x + C_b_G[1, 0] * V_y + C_b_G[2, 0] * V_z
    y = C_b_G[0, 1] * V_x + C_b_G[1, 1] * V_y + C_b_G[2, 1] * V_z
    z = C_b_G[0, 2] * V_x + C_b_G[1, 2] * V_y + C_b_G[2, 2] * V_z
    x += omega_b[1] * lever_b[2] - omega_b[2] * lever_b[1]
    y += omega_b[2] * lever_b[0] - omega_b[0] * lever_b[2]
    z += omega_b[0] * lever_b[1] - omega_b[1] * lever_b[0]
    for i in range(3):
        b_x = C_b_G[i, 0]
        b_y = C_b_G[i, 1]
        b_z = C_b_G[i, 2]
        J[i, DVL_YAW] = b_x * y - b_y * x  # -C (e_z x v)
        J[i, DVL_PITCH] = b_z * x - b_x * z  # -C (e_y x v)
        J[i, DVL_LEVER_X] = -(b_y * omega_b[2] - b_z * omega_b[1])  # -C (omega x e_x)
        J[i, DVL_LEVER_Y] = b_x * omega_b[2] - b_z * omega_b[0]  # -C (omega x e_y)
        J[i, DVL_LATENCY] = b_x * a_b[0] + b_y * a_b[1] + b_z * a_b[2]


@kernel
def depth_common(J: Array) -> None:
    """Innovation of a depth per unit of its zero: one row."""
    clear(J)
    J[0, DEPTH_ZERO] = 1.0


@entry
@kernel
def fix_common(J: Array, C_e_G: Array, relative_e: Array, v_G: Array, common_e: Array) -> None:
    """Innovation of a position fix per unit of each common error of fixes.

    Parameters
    ----------
    J : (3, COLUMNS) out, grid axes
        Per unit of range scale, per radian of turn of the array, per second of clock, per metre of
        offset, per sigma of the leader's constant errors.
    C_e_G : (3, 3)
    relative_e : (3,)
        From the leader's array to the follower's transponder, ECEF [m]; zero for an absolute fix.
    v_G : (3,)
        Velocity, grid axes [m/s].
    common_e : (3, 7)
        Change of the fix per sigma of its leader's errors, ECEF [m]; the last four are constant.
    """
    clear(J)
    for i in range(3):
        r = 0.0
        for k in range(3):
            r += C_e_G[i, k] * relative_e[k]
        J[i, RANGE_SCALE] = -r
        J[i, CLOCK] = -v_G[i]
        J[i, OFFSET + i] = -1.0
        for c in range(LEADER, COLUMNS):
            for k in range(3):
                J[i, c] -= C_e_G[i, k] * common_e[k, 3 + c - LEADER]
    J[0, ARRAY_TURN] = -J[1, RANGE_SCALE]  # -(up x r)
    J[1, ARRAY_TURN] = J[0, RANGE_SCALE]
