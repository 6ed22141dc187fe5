"""Algebra of the model-aided filter: seven more states beside the 24, in block form.

The error e = (v_r, V_c, ln Dt, f): velocity through the water (body), current (grid east, north),
surge drag at a stated speed and its quadratic share; estimate minus truth. Held are
P_xe = cov(x, e), shape (24, 7), and P_ee, shape (7, 7). e drives nothing of x, so that the
transition of the 31 states is [[Phi, 0], [Phi_ex, Phi_ee]] and the 24 states' own prediction stays
as it is. Derivation: docs/derivations/model_aiding.md.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from ..vehicle.model import rate_jacobian, relative_acceleration, relative_acceleration_jacobian
from .rows import DV, GYRO, PHI
from .update import COUPLED, NAV, N

E = 7
MOVING = 3
"""States of e with dynamics, its first; the others are random walks."""
CURRENT = 3
LOG_DRAG = 5
SHARE = 6


@kernel
def fill_model_slopes(
    F_ee: Array,
    F_ex: Array,
    G: Array,
    J: Array,
    v_r_b: Array,
    omega_eb_b: Array,
    C_b_G: Array,
    omega_ie_G: Array,
    inertia: Array,
    drag_linear: Array,
    drag_quadratic: Array,
    net_buoyancy: float,
    speed: float,
) -> None:
    """Slope of v_r' with the errors e, into F_ee (3, 7), and x, into F_ex (3, 24).

    x enters by attitude, through the vertical that buoyancy acts along and through the Earth rate
    that is taken off the gyro's, and by the gyro bias.

    Parameters
    ----------
    G, J : (3, 3) out
        Slope of v_r' with the rate and with v_r.
    v_r_b, omega_eb_b : (3,)
        Velocity through the water [m/s]; rate against the Earth [rad/s]; body axes.
    C_b_G, omega_ie_G : (3, 3), (3,)
        Attitude; Earth rate, grid axes [rad/s].
    inertia, drag_linear, drag_quadratic : (3,)
        Mass plus added mass [kg], d1 [N s/m], d2 [N s^2/m^2], of surge as estimated.
    net_buoyancy : float
        Buoyancy minus weight [N].
    speed : float
        At which ln Dt and f are stated [m/s].
    """
    rate_jacobian(G, v_r_b, inertia)
    relative_acceleration_jacobian(J, v_r_b, omega_eb_b, inertia, drag_linear, drag_quadratic)
    for i in range(MOVING):
        for k in range(E):
            F_ee[i, k] = 0.0
        for k in range(N):
            F_ex[i, k] = 0.0
        for k in range(3):
            F_ee[i, k] = J[i, k]
            F_ex[i, GYRO + k] = G[i, k]
    u = v_r_b[0]
    total = (drag_linear[0] + drag_quadratic[0] * speed) * speed
    F_ee[0, LOG_DRAG] = -(drag_linear[0] + drag_quadratic[0] * abs(u)) * u / inertia[0]
    F_ee[0, SHARE] = -total * (abs(u) / speed - 1.0) * (u / speed) / inertia[0]
    w_x = omega_ie_G[0]
    w_y = omega_ie_G[1]
    w_z = omega_ie_G[2]
    for i in range(MOVING):
        # -P_z C^T [e_z x] / M of the vertical
        lift = net_buoyancy / inertia[i]
        F_ex[i, PHI] = -lift * C_b_G[1, i]
        F_ex[i, PHI + 1] = lift * C_b_G[0, i]
        # G C^T [w_ie x] of the Earth rate
        g_x = 0.0
        g_y = 0.0
        g_z = 0.0
        for k in range(3):
            g_x += G[i, k] * C_b_G[0, k]
            g_y += G[i, k] * C_b_G[1, k]
            g_z += G[i, k] * C_b_G[2, k]
        F_ex[i, PHI] += g_y * w_z - g_z * w_y
        F_ex[i, PHI + 1] += g_z * w_x - g_x * w_z
        F_ex[i, PHI + 2] += g_x * w_y - g_y * w_x


@kernel
def fill_model_transition(
    Phi_ee: Array, Phi_ex: Array, F_ee: Array, F_ex: Array, F15: Array, dt: float
) -> None:
    """First three rows of the lower blocks of I + F dt + (F dt)^2/2, F of all 31 states.

    Parameters
    ----------
    Phi_ee, Phi_ex : (3, 7), (3, 24) out
    F_ee, F_ex : (3, 7), (3, 24) from `fill_model_slopes`
    F15 : (15, 15) system matrix of the first 15 states; rows below nine are zero
    dt : step [s]
    """
    half = 0.5 * dt * dt
    for i in range(MOVING):
        for j in range(E):
            s = 0.0
            for k in range(MOVING):  # rows of F_ee below three are zero
                s += F_ee[i, k] * F_ee[k, j]
            Phi_ee[i, j] = F_ee[i, j] * dt + s * half
        Phi_ee[i, i] += 1.0
        for j in range(N):
            s = 0.0
            for k in range(MOVING):
                s += F_ee[i, k] * F_ex[k, j]
            if j < COUPLED:
                for k in range(NAV):
                    s += F_ex[i, k] * F15[k, j]
            Phi_ex[i, j] = F_ex[i, j] * dt + s * half


@kernel
def move_relative_velocity(
    v_r_b: Array,
    a_b: Array,
    mid_b: Array,
    omega_eb_b: Array,
    up_b: Array,
    force_b: Array,
    inertia: Array,
    drag_linear: Array,
    drag_quadratic: Array,
    net_buoyancy: float,
    dt: float,
    longest: float,
) -> None:
    """Move v_r over dt by the midpoint rule, in steps of ``longest`` or less.

    Parameters
    ----------
    v_r_b : (3,) array, in place
        Velocity through the water, body axes [m/s].
    a_b, mid_b : (3,) arrays
        Scratch: acceleration and midpoint.
    omega_eb_b, up_b, force_b : (3,) arrays
        Rate against the Earth [rad/s], vertical [-] and thrust [N], body axes, held over dt.
    inertia, drag_linear, drag_quadratic : (3,) arrays
        Mass plus added mass [kg], d1 [N s/m], d2 [N s^2/m^2].
    net_buoyancy : float
        Buoyancy minus weight [N].
    dt, longest : float
        Time to move over, longest step [s].
    """
    count = 1
    while dt > longest * count:
        count += 1
    h = dt / count
    for _ in range(count):
        relative_acceleration(
            a_b, v_r_b, omega_eb_b, up_b, force_b,
            inertia, drag_linear, drag_quadratic, net_buoyancy,
        )  # fmt: skip
        for k in range(3):
            mid_b[k] = v_r_b[k] + 0.5 * h * a_b[k]
        relative_acceleration(
            a_b, mid_b, omega_eb_b, up_b, force_b,
            inertia, drag_linear, drag_quadratic, net_buoyancy,
        )  # fmt: skip
        for k in range(3):
            v_r_b[k] += h * a_b[k]


@kernel
def _times_lower_blocks(out: Array, X: Array, Y: Array, Phi_ee: Array, Phi_ex: Array) -> None:
    """Out = X Phi_ex^T + Y Phi_ee^T for X (n, 24), Y (n, 7); the blocks as of `predict_block`."""
    for i in range(out.shape[0]):
        for a in range(MOVING):
            s = 0.0
            for k in range(COUPLED):
                s += X[i, k] * Phi_ex[a, k]
            for b in range(E):
                s += Y[i, b] * Phi_ee[a, b]
            out[i, a] = s
        for a in range(MOVING, E):
            out[i, a] = Y[i, a]


@kernel
def predict_block(
    P_xe: Array,
    P_ee: Array,
    P: Array,
    Phi: Array,
    Phi_ee: Array,
    Phi_ex: Array,
    A: Array,
    B: Array,
) -> None:
    """Predict P_xe, P_ee: their blocks of Phi P Phi^T of all 31 states, before P is predicted.

    A = P Phi_ex^T + P_xe Phi_ee^T and B = P_ex Phi_ex^T + P_ee Phi_ee^T lead to P_xe <- Phi A and
    P_ee <- Phi_ex A + Phi_ee B.

    Parameters
    ----------
    P_xe, P_ee : (24, 7), (7, 7) in place
    P, Phi : (24, 24) covariance before the step, transition
    Phi_ee, Phi_ex : (3, 7), (3, 24): below them Phi_ee is the identity and Phi_ex zero
    A, B : (24, 7), (7, 7) scratch
    """
    _times_lower_blocks(A, P, P_xe, Phi_ee, Phi_ex)
    _times_lower_blocks(B, P_xe.T, P_ee, Phi_ee, Phi_ex)
    for i in range(NAV):
        for a in range(E):
            s = 0.0
            for k in range(COUPLED):
                s += Phi[i, k] * A[k, a]
            P_xe[i, a] = s
    for i in range(NAV, N):
        for a in range(E):
            P_xe[i, a] = Phi[i, i] * A[i, a]
    for a in range(MOVING):
        for b in range(a, E):
            s = 0.0
            for k in range(COUPLED):
                s += Phi_ex[a, k] * A[k, b]
            for c in range(E):
                s += Phi_ee[a, c] * B[c, b]
            P_ee[a, b] = s
            P_ee[b, a] = s


@kernel
def add_model_noise(
    P_xe: Array, P_ee: Array, q: Array, C_b_G: Array, G: Array, rate_variance: float, dt: float
) -> None:
    """Noise of a step: diagonal, and what the gyro's noise does to v_r as well as to attitude.

    Parameters
    ----------
    P_xe, P_ee : in place
    q : (3,) variances per second of v_r, V_c and both parameters of the drag
    C_b_G, G : (3, 3) attitude; slope of v_r' with the rate
    rate_variance : float
        Variance density of the gyro [rad^2/s]
    dt : step [s]
    """
    for i in range(MOVING):
        P_ee[i, i] += q[0] * dt
        for j in range(MOVING):
            s = 0.0
            c = 0.0
            for k in range(3):
                s += G[i, k] * G[j, k]
                c += C_b_G[i, k] * G[j, k]
            P_ee[i, j] += s * (rate_variance * dt)
            P_xe[PHI + i, j] -= c * (rate_variance * dt)
    P_ee[CURRENT, CURRENT] += q[1] * dt
    P_ee[CURRENT + 1, CURRENT + 1] += q[1] * dt
    P_ee[LOG_DRAG, LOG_DRAG] += q[2] * dt
    P_ee[SHARE, SHARE] += q[2] * dt


@kernel
def model_rows(
    H: Array, H_e: Array, z: Array, C_b_G: Array, v_G: Array, v_r_b: Array, current: Array
) -> None:
    """Velocity over ground is that through the water plus current: z = v_G - C_b_G v_r - V_c.

    The current has no vertical part. H is (3, 24), H_e (3, 7), current (2,).
    """
    for a in range(3):
        for k in range(N):
            H[a, k] = 0.0
        for k in range(E):
            H_e[a, k] = 0.0
    for a in range(3):
        V = 0.0
        for k in range(3):
            V += C_b_G[a, k] * v_r_b[k]
            H_e[a, k] = -C_b_G[a, k]
        H[a, DV + a] = 1.0
        z[a] = v_G[a] - V
        # -[V x] phi
        n = (a + 1) % 3
        m = (a + 2) % 3
        H[n, PHI + m] = V
        H[m, PHI + n] = -V
    for a in range(2):
        H_e[a, CURRENT + a] = -1.0
        z[a] -= current[a]
