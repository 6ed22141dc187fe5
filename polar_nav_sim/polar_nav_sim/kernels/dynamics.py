"""Vehicle of six degrees of freedom in moving water, with its loops (docs/simulation.md).

    M_RB nu' + C_RB(nu) nu + M_A nu_r' + C_A(nu_r) nu_r + D(nu_r) nu_r + g(eta) = tau
    eta' = J(eta) nu        nu_r = nu - (R^T V_c, 0)

Fossen's equations with the Coriolis terms in Lagrangian form. eta holds position and the angles
phi, theta, psi of R = Rz(psi) Ry(theta) Rx(phi), nu velocity and rate in body axes (forward, left,
up); the reference axes have z up and are taken for inertial.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from polar_nav_core.arrays import Array
from polar_nav_core.kernels.cache import entry, kernel, routine

STATES = 12
"""Numbers of a state: position, phi, theta, psi, velocity, rate."""
_ERROR_LIMIT = 0.3
"""Largest heading error that its loop acts on [rad]: a large step is turned at a steady rate."""


class Body(NamedTuple):
    """The vehicle: SI, body axes.

    ``inverse`` is that of M_RB + M_A, shape (6, 6); ``inertia`` (3, 3) is about the body's origin;
    ``added`` are the positive added masses, shape (6,).
    """

    inverse: Array
    mass: float
    r_g: Array
    inertia: Array
    added: Array
    drag_linear: Array
    drag_quadratic: Array
    weight: float
    buoyancy: float
    r_b: Array


class Water(NamedTuple):
    """The current: speed (1 + change sin(2 pi t / period)) towards direction + turn sin(...).

    ``direction`` counts counter-clockwise from x; ``rise`` is the vertical velocity.
    """

    speed: float
    direction: float
    rise: float
    change: float
    turn: float
    period: float


class Loops(NamedTuple):
    """Control loops of the vehicle: set points and gains.

    ``surge`` [N] and ``heading`` [rad] are laws of time: mean, then amplitude, rate, phase of two
    sines. ``gains``: heading, its rate, pitch, its rate, depth, its rate, speed. ``limits`` are
    the largest forces and torques, shape (6,).
    """

    surge: Array
    heading: Array
    depth: float
    speed: float
    gains: Array
    limits: Array
    origin_depth: float
    half_curvature: float


@entry
@kernel
def law(coefficients: Array, t: float) -> float:
    """Mean and two sines of time."""
    c = coefficients
    value: float = c[0] + c[1] * math.sin(c[2] * t + c[3]) + c[4] * math.sin(c[5] * t + c[6])
    return value


@routine
def current(V: Array, dV: Array, t: float, water: Water) -> None:
    """Velocity of the water [m/s] and its rate, reference axes, into V and dV, shape (3,)."""
    w = 2.0 * math.pi / water.period
    s, c = math.sin(w * t), math.cos(w * t)
    speed, speed_rate = water.speed * (1.0 + water.change * s), water.speed * water.change * w * c
    angle, angle_rate = water.direction + water.turn * s, water.turn * w * c
    V[0], V[1], V[2] = speed * math.cos(angle), speed * math.sin(angle), water.rise
    dV[0] = speed_rate * math.cos(angle) - V[1] * angle_rate
    dV[1] = speed_rate * math.sin(angle) + V[0] * angle_rate
    dV[2] = 0.0


@kernel
def rotation(R: Array, x: Array) -> None:
    """R of the angles of a state, body to reference, into R, shape (3, 3)."""
    s_phi, c_phi = math.sin(x[3]), math.cos(x[3])
    s_theta, c_theta = math.sin(x[4]), math.cos(x[4])
    s_psi, c_psi = math.sin(x[5]), math.cos(x[5])
    R[0, 0], R[1, 0], R[2, 0] = c_psi * c_theta, s_psi * c_theta, -s_theta
    R[0, 1] = c_psi * s_theta * s_phi - s_psi * c_phi
    R[1, 1] = s_psi * s_theta * s_phi + c_psi * c_phi
    R[2, 1] = c_theta * s_phi
    R[0, 2] = c_psi * s_theta * c_phi + s_psi * s_phi
    R[1, 2] = s_psi * s_theta * c_phi - c_psi * s_phi
    R[2, 2] = c_theta * c_phi


@kernel
def _add_cross(out: Array, at: int, a: Array, b: Array, factor: float) -> None:
    """Add factor a x b to three numbers of out."""
    out[at] += factor * (a[1] * b[2] - a[2] * b[1])
    out[at + 1] += factor * (a[2] * b[0] - a[0] * b[2])
    out[at + 2] += factor * (a[0] * b[1] - a[1] * b[0])


@routine
def derivative(
    dx: Array, x: Array, tau: Array, V: Array, dV: Array, body: Body, scratch: Array
) -> None:
    """Rate of the state, into dx.

    Parameters
    ----------
    x, dx : (12,) position, phi, theta, psi, velocity and rate in body axes; their rates
    tau : (6,) force [N] and torque [N m], body axes
    V, dV : (3,) velocity of the water and its rate, reference axes
    scratch : (10, 3) working memory
    """
    R, v_c, v_r, force = scratch[0:3], scratch[3], scratch[4], scratch[5:7].reshape(6)
    a, b, rate_c = scratch[7], scratch[8], scratch[9]
    v, w = x[6:9], x[9:12]
    rotation(R, x)
    for i in range(3):
        v_c[i] = R[0, i] * V[0] + R[1, i] * V[1] + R[2, i] * V[2]
        v_r[i] = v[i] - v_c[i]
        rate_c[i] = R[0, i] * dV[0] + R[1, i] * dV[1] + R[2, i] * dV[2]
    _add_cross(rate_c, 0, w, v_c, -1.0)
    for i in range(3):
        drag = (body.drag_linear[i] + body.drag_quadratic[i] * abs(v_r[i])) * v_r[i]
        up = R[2, i] * (body.buoyancy - body.weight)
        force[i] = tau[i] - drag + up + body.added[i] * rate_c[i]
        j = i + 3
        drag = (body.drag_linear[j] + body.drag_quadratic[j] * abs(w[i])) * w[i]
        force[j] = tau[j] - drag
    # Rigid body: m (w x v + w x (w x r_g)); w x I w + m r_g x (w x v).
    for i in range(3):
        a[i] = 0.0
        b[i] = 0.0
    _add_cross(a, 0, w, v, 1.0)
    _add_cross(force, 3, body.r_g, a, -body.mass)
    _add_cross(b, 0, w, body.r_g, 1.0)
    _add_cross(a, 0, w, b, 1.0)
    for i in range(3):
        force[i] -= body.mass * a[i]
        b[i] = (
            body.inertia[i, 0] * w[0] + body.inertia[i, 1] * w[1] + body.inertia[i, 2] * w[2]
        ) + body.added[i + 3] * w[i]
    _add_cross(force, 3, w, b, -1.0)
    # Added mass: w x A v_r; v_r x A v_r (the Munk moment), its rotational part stands above.
    for i in range(3):
        a[i] = body.added[i] * v_r[i]
    _add_cross(force, 0, w, a, -1.0)
    _add_cross(force, 3, v_r, a, -1.0)
    # Weight at r_g, buoyancy at r_b.
    for i in range(3):
        a[i] = body.buoyancy * body.r_b[i] - body.weight * body.r_g[i]
    _add_cross(force, 3, a, R[2], 1.0)
    s_phi, c_phi = math.sin(x[3]), math.cos(x[3])
    across = s_phi * w[1] + c_phi * w[2]
    dx[3] = w[0] + math.tan(x[4]) * across
    dx[4] = c_phi * w[1] - s_phi * w[2]
    dx[5] = across / math.cos(x[4])
    for i in range(3):
        dx[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += body.inverse[i, j] * force[j]
        dx[6 + i] = total


@routine
def thrust(
    tau: Array, t: float, x: Array, V: Array, body: Body, loops: Loops, wanted: Array
) -> None:
    """Force and torque of the loops at a time, into tau, shape (6,).

    Parameters
    ----------
    wanted : (4,) heading [rad], pitch [rad], depth [m], speed [m/s] in place of the laws; NaN
        leaves a loop to its law, and depth wins over pitch
    """
    g = loops.gains
    s_theta, c_theta = math.sin(x[4]), math.cos(x[4])
    s_phi, c_phi = math.sin(x[3]), math.cos(x[3])
    s_psi, c_psi = math.sin(x[5]), math.cos(x[5])
    up_z = c_theta * c_phi
    heading = law(loops.heading, t) if math.isnan(wanted[0]) else wanted[0]
    held = not math.isnan(wanted[2]) or math.isnan(wanted[1])
    pitch = 0.0 if held else wanted[1]
    speed = loops.speed if math.isnan(wanted[3]) else wanted[3]
    if math.isnan(speed):
        tau[0] = law(loops.surge, t)
    else:
        along = c_psi * c_theta * V[0] + s_psi * c_theta * V[1] - s_theta * V[2]
        drag = (body.drag_linear[0] + body.drag_quadratic[0] * abs(speed)) * speed
        tau[0] = drag + g[6] * (speed - (x[6] - along))
    tau[1] = 0.0
    tau[2] = (body.weight - body.buoyancy) * up_z
    if held:
        depth = loops.origin_depth - x[2] - loops.half_curvature * (x[0] * x[0] + x[1] * x[1])
        target = loops.depth if math.isnan(wanted[2]) else wanted[2]
        rise = -s_theta * x[6] + c_theta * s_phi * x[7] + up_z * x[8]
        tau[2] += g[4] * (depth - target) - g[5] * rise
    tau[3] = 0.0
    tau[4] = g[2] * (pitch - x[4]) - g[3] * x[10]
    error = heading - x[5]
    error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
    error = min(max(error, -_ERROR_LIMIT), _ERROR_LIMIT)
    tau[5] = g[0] * error - g[1] * x[11]
    for i in range(6):
        tau[i] = min(max(tau[i], -loops.limits[i]), loops.limits[i])


@entry
@routine
def run(
    x: Array,
    tau: Array,
    rate_start: Array,
    rate_end: Array,
    first: int,
    count: int,
    h: float,
    body: Body,
    water: Water,
    loops: Loops,
    wanted: Array,
    wrench: Array,
    scratch: Array,
) -> None:
    """Integrate steps first .. first + count - 1 by the classical Runge-Kutta method.

    Thrust is held over each step: what stands in row k of ``tau`` acts from t_k = k h to t_(k+1).

    Parameters
    ----------
    x : (n + 1, 12) states; row ``first`` is given, those after it are written
    tau : (n, 6) thrust of each step, written
    rate_start, rate_end : (n, 12) rates of the state at both ends of each step, with its thrust
    wanted : (4,) as for thrust
    wrench : (6,) thrust in place of that of the loops; NaN: the loops'
    scratch : (30, 3) working memory
    """
    V, dV, inner = scratch[10], scratch[11], scratch[0:10]
    k2, k3 = scratch[12:16].reshape(12), scratch[16:20].reshape(12)
    y, k4 = scratch[20:24].reshape(12), scratch[24:28].reshape(12)
    for k in range(first, first + count):
        t = k * h
        current(V, dV, t, water)
        if math.isnan(wrench[0]):
            thrust(tau[k], t, x[k], V, body, loops, wanted)
        else:
            for i in range(6):
                tau[k, i] = wrench[i]
        k1 = rate_start[k]
        derivative(k1, x[k], tau[k], V, dV, body, inner)
        current(V, dV, t + 0.5 * h, water)
        for i in range(STATES):
            y[i] = x[k, i] + 0.5 * h * k1[i]
        derivative(k2, y, tau[k], V, dV, body, inner)
        for i in range(STATES):
            y[i] = x[k, i] + 0.5 * h * k2[i]
        derivative(k3, y, tau[k], V, dV, body, inner)
        current(V, dV, t + h, water)
        for i in range(STATES):
            y[i] = x[k, i] + h * k3[i]
        derivative(k4, y, tau[k], V, dV, body, inner)
        for i in range(STATES):
            x[k + 1, i] = x[k, i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        derivative(rate_end[k], x[k + 1], tau[k], V, dV, body, inner)
