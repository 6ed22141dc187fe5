"""One step of the augmented model of station mode.

Equations in docs/derivations/station.md. A step can be linearised at another point than the
state: `clone` filters the past again with the slopes that were stored.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel, routine
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from ..vehicle.model import relative_acceleration, relative_acceleration_jacobian, surge_drag
from . import state as ss
from .common import transform
from .gap import cross_gap, doubt_heading
from .state import Bank, Settings, Streams, Tape, Work
from .tape import tape_step

THRUST_SHARE = 0.3
"""1-sigma of a thrust that nobody states, in shares of the drag at the stated speed."""
THRUST_TAU = 20.0
"""How long it lasts [s]."""


@kernel
def turned(R: Array, C: Array, bias: float) -> None:
    """R = Rz(-bias) C: the attitude without the heading's bias."""
    c = math.cos(bias)
    s = math.sin(bias)
    for j in range(3):
        R[0, j] = c * C[0, j] + s * C[1, j]
        R[1, j] = c * C[1, j] - s * C[0, j]
        R[2, j] = C[2, j]


@kernel
def locate(b: Bank, at: Array, c: Settings, w: Work) -> None:
    """Vertical, height and grid axes at the place of the first member of ``at``, (B, 12)."""
    p = at[0]
    x = c.origin_e[0]
    y = c.origin_e[1]
    z = c.origin_e[2]
    for i in range(3):
        k = ss.POSITION + i
        x += c.C_e_A[i, 0] * p[k]
        y += c.C_e_A[i, 1] * p[k]
        z += c.C_e_A[i, 2] * p[k]
        b.flat[ss.PLACE + i] = p[k]
    u_x, u_y, u_z, height = up_and_height(x, y, z)
    fill_C_e_G(u_x, u_y, u_z, w.C_G)
    b.flat[ss.HEIGHT] = height
    for i in range(3):
        b.flat[ss.UP + i] = c.C_e_A[i, 0] * u_x + c.C_e_A[i, 1] * u_y + c.C_e_A[i, 2] * u_z
        for j in range(3):
            b.flat[ss.AXES + 3 * i + j] = (
                w.C_G[i, 0] * c.C_e_A[j, 0]
                + w.C_G[i, 1] * c.C_e_A[j, 1]
                + w.C_G[i, 2] * c.C_e_A[j, 2]
            )


@kernel
def to_station(C_A: Array, C_b_G: Array, b: Bank) -> None:
    """Turn C_b_G into the station frame: C_A = C_G_A C_b_G."""
    for i in range(3):
        for j in range(3):
            C_A[i, j] = (
                b.flat[ss.AXES + i] * C_b_G[0, j]
                + b.flat[ss.AXES + 3 + i] * C_b_G[1, j]
                + b.flat[ss.AXES + 6 + i] * C_b_G[2, j]
            )


@kernel
def slopes(at: Array, c: Settings, w: Work) -> tuple[float, float, float, float]:
    """Fill the rate of the state at a point and its slopes.

    ``w`` holds the attitude C_A, the rate ``omega``, the vertical ``up`` and thrust ``g``, body
    axes. Into it: acceleration ``a`` and its slope ``F`` with v_r, attitude ``R`` without the
    heading's bias, velocity through the water ``v3``, station axes.

    Returns
    -------
    tuple
        Slopes of the surge acceleration with ln Dt and f, of the velocity along x and y with b.
    """
    # A share outside of [0, 1] is a drag that pushes: a vehicle without a steady speed runs away.
    share = min(max(at[ss.SHARE], 0.0), 1.0)
    d1, d2 = surge_drag(at[ss.DRAG], share, c.speed)
    w.d1[0] = d1
    w.d2[0] = d2
    relative_acceleration(w.a, at, w.omega, w.up, w.g, c.inertia, w.d1, w.d2, c.net_buoyancy)
    relative_acceleration_jacobian(w.F, at, w.omega, c.inertia, w.d1, w.d2)
    v = at[0]
    total = math.exp(at[ss.DRAG])
    f_drag = -(d1 + d2 * abs(v)) * v / c.inertia[0]
    f_share = -total * (abs(v) * v / c.speed - v) / (c.speed * c.inertia[0])
    turned(w.R, w.C_A, at[ss.HEADING])
    for i in range(3):
        w.v3[i] = w.R[i, 0] * at[0] + w.R[i, 1] * at[1] + w.R[i, 2] * at[2]
    # Rz(-b) turns the velocity clockwise as b grows.
    return f_drag, f_share, w.v3[1], -w.v3[0]


@kernel
def move(
    x: Array,
    at: Array,
    h: float,
    e: float,
    f_drag: float,
    f_share: float,
    g_x: float,
    g_y: float,
    w: Work,
) -> None:
    """State x <- f(at) + F (x - at) over h seconds; e: decay of the station's error."""
    F, R, d = w.F, w.R, w.d
    for i in range(ss.N):
        d[i] = x[i] - at[i]
    slope = f_drag * d[ss.DRAG] + f_share * d[ss.SHARE]
    for i in range(3):
        rate = w.a[i] + (F[i, 0] * d[0] + F[i, 1] * d[1] + F[i, 2] * d[2])
        velocity = w.v3[i] + (R[i, 0] * d[0] + R[i, 1] * d[1] + R[i, 2] * d[2])
        if i == 0:
            rate += slope
            velocity += x[ss.CURRENT] + g_x * d[ss.HEADING]
        elif i == 1:
            velocity += x[ss.CURRENT + 1] + g_y * d[ss.HEADING]
        x[i] += h * rate
        x[ss.POSITION + i] += h * velocity
    x[ss.STATION] *= e


@kernel
def spread(
    P: Array,
    h: float,
    q_c: float,
    e: float,
    q_e: float,
    f_drag: float,
    f_share: float,
    g_x: float,
    g_y: float,
    c: Settings,
    w: Work,
) -> None:
    """P <- F P F^T + Q over a step, symmetric to the bit.

    Parameters
    ----------
    P : (12, 12) array, in place
    h : float
        Length of the step [s].
    q_c : float
        Density of the current's random walk [m^2/s^3].
    e, q_e : float
        Decay [-] and added variance [rad^2] of the station's heading error over the step.
    f_drag, f_share : float
        Slopes of the surge acceleration with ln Dt and f [m/s^2], as `slopes` returns them.
    g_x, g_y : float
        Slopes of the velocity along x and y with the heading's bias [m/s], as it returns them.
    c : Settings
    w : Work
        Slopes F and R as `slopes` left them; M is scratch.
    """
    F, R, M = w.F, w.R, w.M
    for i in range(3):
        f0 = h * F[i, 0]
        f1 = h * F[i, 1]
        f2 = h * F[i, 2]
        r0 = h * R[i, 0]
        r1 = h * R[i, 1]
        r2 = h * R[i, 2]
        for j in range(ss.N):
            M[i, j] = P[i, j] + (f0 * P[0, j] + f1 * P[1, j] + f2 * P[2, j])
            M[i + 3, j] = P[i + 3, j] + (r0 * P[0, j] + r1 * P[1, j] + r2 * P[2, j])
    f_drag *= h
    f_share *= h
    g_x *= h
    g_y *= h
    for j in range(ss.N):
        M[0, j] += f_drag * P[ss.DRAG, j] + f_share * P[ss.SHARE, j]
        M[3, j] += h * P[ss.CURRENT, j] + g_x * P[ss.HEADING, j]
        M[4, j] += h * P[ss.CURRENT + 1, j] + g_y * P[ss.HEADING, j]
    for i in range(ss.DYNAMIC):
        m0 = M[i, 0]
        m1 = M[i, 1]
        m2 = M[i, 2]
        for j in range(3):
            if j <= i:
                P[i, j] = M[i, j] + h * (F[j, 0] * m0 + F[j, 1] * m1 + F[j, 2] * m2)
            if j + 3 <= i:
                P[i, j + 3] = M[i, j + 3] + h * (R[j, 0] * m0 + R[j, 1] * m1 + R[j, 2] * m2)
        P[i, 0] += f_drag * M[i, ss.DRAG] + f_share * M[i, ss.SHARE]
        if i >= 3:
            P[i, 3] += h * M[i, ss.CURRENT] + g_x * M[i, ss.HEADING]
        if i >= 4:
            P[i, 4] += h * M[i, ss.CURRENT + 1] + g_y * M[i, ss.HEADING]
    for i in range(ss.DYNAMIC):
        for j in range(i):
            P[j, i] = P[i, j]
        for j in range(ss.DYNAMIC, ss.N):
            P[i, j] = M[i, j]
            P[j, i] = M[i, j]
    if q_e > 0.0:
        for i in range(ss.STATION):
            P[i, ss.STATION] *= e
            P[ss.STATION, i] = P[i, ss.STATION]
        P[ss.STATION, ss.STATION] = e * e * P[ss.STATION, ss.STATION] + q_e
    for i in range(3):
        P[i, i] += h * c.q_v
    P[ss.POSITION, ss.POSITION] += h * c.q_xy
    P[ss.POSITION + 1, ss.POSITION + 1] += h * c.q_xy
    P[5, 5] += h * c.q_z
    P[ss.CURRENT, ss.CURRENT] += h * q_c
    P[ss.CURRENT + 1, ss.CURRENT + 1] += h * q_c
    P[ss.DRAG, ss.DRAG] += h * c.q_drag
    P[ss.SHARE, ss.SHARE] += h * c.q_drag
    P[ss.HEADING, ss.HEADING] += h * c.q_heading


@kernel
def step_published(x: Array, P: Array, h: float, c: Settings, w: Work) -> None:
    """Eqs. 5-8: X <- (I + h A) X + h b, P <- F P F^T + Q for X = (v, p), v over ground.

    Drag is frozen at the speed of now ("linear"). ``x`` holds current and drag as known.
    """
    M, R = w.M, w.R
    d1, d2 = surge_drag(x[ss.DRAG], x[ss.SHARE], c.speed)
    w.d1[0] = d1
    w.d2[0] = d2
    turned(R, w.C_A, 0.0)
    u = w.a  # the current in body axes
    for i in range(3):
        u[i] = R[0, i] * x[ss.CURRENT] + R[1, i] * x[ss.CURRENT + 1]
    o = w.omega
    # C = S(omega) M + d, and S(omega) A11 + d; A11 is what the current's rate adds to.
    for i in range(3):
        for j in range(3):
            w.F[i, j] = 0.0
    w.F[0, 1] = -o[2]
    w.F[0, 2] = o[1]
    w.F[1, 0] = o[2]
    w.F[1, 2] = -o[0]
    w.F[2, 0] = -o[1]
    w.F[2, 1] = o[0]
    for i in range(3):
        # v' = -M^-1 (S M + d) (v - v_c) - S v_c: the mass alone does not turn with the water.
        drag = w.d1[i] + w.d2[i] * abs(x[i] - u[i])
        rate = w.g[i] + c.net_buoyancy * w.up[i]
        turning = 0.0
        for j in range(3):
            rate -= w.F[i, j] * c.inertia[j] * (x[j] - u[j])
            turning += w.F[i, j] * u[j]
        rate -= drag * (x[i] - u[i])
        w.d[i] = rate / c.inertia[i] - turning
        w.d[3 + i] = R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2]
        for j in range(3):
            w.F[i, j] *= -c.inertia[j] / c.inertia[i]
        w.F[i, i] -= drag / c.inertia[i]
    for i in range(6):
        x[i] += h * w.d[i]
    for i in range(3):
        for j in range(6):
            M[i, j] = P[i, j] + h * (
                w.F[i, 0] * P[0, j] + w.F[i, 1] * P[1, j] + w.F[i, 2] * P[2, j]
            )
            M[3 + i, j] = P[3 + i, j] + h * (
                R[i, 0] * P[0, j] + R[i, 1] * P[1, j] + R[i, 2] * P[2, j]
            )
    for i in range(6):
        for j in range(3):
            if j <= i:
                P[i, j] = M[i, j] + h * (
                    w.F[j, 0] * M[i, 0] + w.F[j, 1] * M[i, 1] + w.F[j, 2] * M[i, 2]
                )
            if j + 3 <= i:
                P[i, 3 + j] = M[i, 3 + j] + h * (
                    R[j, 0] * M[i, 0] + R[j, 1] * M[i, 1] + R[j, 2] * M[i, 2]
                )
    for i in range(6):
        for j in range(i):
            P[j, i] = P[i, j]
    for i in range(3):
        P[i, i] += h * c.q_v
    P[ss.POSITION, ss.POSITION] += h * c.q_xy
    P[ss.POSITION + 1, ss.POSITION + 1] += h * c.q_xy
    P[5, 5] += h * c.q_z


@kernel
def prepare_step(b: Bank, c: Settings, w: Work, streams: Streams, i: int) -> None:
    """Fill attitude, rate against the Earth, vertical and thrust of IMU sample i's interval."""
    n = streams.imu_stamps.shape[0]
    for r in range(3):
        for k in range(3):  # attitude in the middle of the interval
            w.C_G[r, k] = 0.5 * (streams.C_b_G[(i - 1) % n, r, k] + streams.C_b_G[i % n, r, k])
    to_station(w.C_A, w.C_G, b)
    for k in range(3):
        earth = (
            w.C_A[0, k] * c.omega_ie_A[0]
            + w.C_A[1, k] * c.omega_ie_A[1]
            + w.C_A[2, k] * c.omega_ie_A[2]
        )
        w.omega[k] = streams.omega_ib_b[i % n, k] - earth
        w.up[k] = w.C_G[2, k]
        w.g[k] = b.flat[ss.FORCE + k]
        w.d1[k] = c.drag_linear[k]
        w.d2[k] = c.drag_quadratic[k]


@kernel
def clear(jump: Array) -> None:
    """Fill an array (B, 12) with zeros."""
    for m in range(jump.shape[0]):
        for k in range(ss.N):
            jump[m, k] = 0.0


@routine
def imu_event(
    b: Bank,
    c: Settings,
    w: Work,
    streams: Streams,
    points: Array,
    jumps: Array,
    tape: Tape,
    frozen: bool,
) -> None:
    """Advance all members to the stamp of the next IMU sample.

    ``points`` (n, B, 12) takes the states before it, or, where ``frozen``, says where the step is
    linearised. ``jumps``, of the same shape or empty, will take the corrections that follow. A
    thrust without a newer one holds on, but after `Settings.thrust_ns` it is only a guess: the
    surge velocity gets the noise of one that is off by a share of the drag for some time.
    """
    i = b.counters[ss.IMU]
    stamp = streams.imu_stamps[i % streams.imu_stamps.shape[0]]
    dt = (stamp - b.counters[ss.STAMP]) * 1e-9
    parts = max(1, math.ceil(dt / c.max_step_s - 1e-6))
    h = dt / parts
    e = 1.0
    q_e = 0.0
    sigma = b.flat[ss.SIGMA]
    if sigma > 0.0:
        e = math.exp(-h / c.station_tau)
        q_e = sigma * sigma * (1.0 - e * e)
    unknown = c.thrust_ns > 0 and stamp - b.counters[ss.THRUST_NS] > c.thrust_ns
    place = points[i % points.shape[0]]
    if not frozen:
        for m in range(b.x.shape[0]):
            for k in range(ss.N):
                place[m, k] = b.x[m, k]
    locate(b, place, c, w)
    prepare_step(b, c, w, streams, i)
    for m in range(b.x.shape[0]):
        for k in range(ss.N):
            w.point[k] = place[m, k]
        for part in range(parts):
            if c.published:
                step_published(b.x[m], b.P[m], h, c, w)
                continue
            f_drag, f_share, g_x, g_y = slopes(w.point, c, w)
            move(b.x[m], w.point, h, e, f_drag, f_share, g_x, g_y, w)
            q_c = c.q_current[m] + b.loose[ss.EXTRA]
            spread(b.P[m], h, q_c, e, q_e, f_drag, f_share, g_x, g_y, c, w)
            tape_step(tape, m, h, e, f_drag, f_share, g_x, g_y, w)
            if unknown:
                a = THRUST_SHARE * math.exp(w.point[ss.DRAG]) / c.inertia[0]
                b.P[m, 0, 0] += h * 2.0 * THRUST_TAU * a * a
            if c.shares:
                transform(b.S[m], h, f_drag, f_share, g_x, g_y, w)
                for k in range(ss.COMMON):
                    b.S[m, ss.STATION, k] *= e
            if part + 1 < parts:
                move(w.point, w.point, h, e, f_drag, f_share, g_x, g_y, w)
    cross_gap(b, c, streams, i, place)
    doubt_heading(b, c, streams, i)
    if jumps.shape[0] > 0:
        clear(jumps[i % jumps.shape[0]])
    b.counters[ss.STAMP] = stamp
    b.counters[ss.IMU] = i + 1


@kernel
def lever_arm(b: Bank, w: Work, streams: Streams, i: int, lever_b: Array) -> None:
    """Fill ``w`` with the attitude C_A at IMU sample i and with a lever arm in station axes."""
    to_station(w.C_A, streams.C_b_G[i % streams.imu_stamps.shape[0]], b)
    for i in range(3):
        w.lever[i] = w.C_A[i, 0] * lever_b[0] + w.C_A[i, 1] * lever_b[1] + w.C_A[i, 2] * lever_b[2]
