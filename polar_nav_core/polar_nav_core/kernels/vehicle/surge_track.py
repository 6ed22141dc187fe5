"""Surge and sway through the water along a logged run, and their slopes with the surge drag.

The reduced model of `vehicle_model` in the horizontal plane, stepped from log entry to log entry;
docs/derivations/identification.md, eqs (3)-(6).
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, routine


@entry
@routine
def surge_track(
    seconds: Array,
    psi: Array,
    cos_pitch: Array,
    yaw_rate: Array,
    force: Array,
    inertia: Array,
    drag_linear: Array,
    drag_quadratic: Array,
    track: Array,
    slopes: Array,
    speed: Array,
) -> None:
    """Follow the log with one step per interval, into track, slopes and speed.

    The step is linearly implicit, ``u += h f / (1 - h f_u / 2)``: second order in h for surge, and
    stable for any drag. ``slopes`` is the exact derivative of these very steps.

    Parameters
    ----------
    seconds, psi, cos_pitch, yaw_rate : (n,) [s], [rad], [-], [rad/s]
        Grid in time; heading counter-clockwise from x, cosine of pitch, rate about the vertical.
    force : (n,) surge force that holds from each time to the next [N]
    inertia, drag_linear, drag_quadratic : (2,) mass plus added mass, d1, d2 of surge and sway
    track : (n, 2) out, distance through the water since the first time, axes of psi [m]
    slopes : (n, 2, 2) out, slope of track with d1x (``[..., 0]``) and d2x (``[..., 1]``)
    speed : (n,) out, surge speed through the water [m/s]
    """
    m_u, m_v = inertia[0], inertia[1]
    d1, d2 = drag_linear[0], drag_quadratic[0]
    root = math.sqrt(d1 * d1 + 4.0 * d2 * abs(force[0]))
    u, u_1, u_2 = 0.0, 0.0, 0.0
    if root > 0.0:
        u = 2.0 * force[0] / (d1 + root)
        u_1, u_2 = -u / root, -u * abs(u) / root
    v, v_1, v_2 = 0.0, 0.0, 0.0
    c, s = math.cos(psi[0]) * cos_pitch[0], math.sin(psi[0]) * cos_pitch[0]
    sway_c, sway_s = math.cos(psi[0]), math.sin(psi[0])
    x, x_1, x_2, y, y_1, y_2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(2):
        track[0, j] = 0.0
        slopes[0, j, 0] = 0.0
        slopes[0, j, 1] = 0.0
    speed[0] = u
    for k in range(1, len(seconds)):
        h = seconds[k] - seconds[k - 1]
        r = 0.5 * (yaw_rate[k] + yaw_rate[k - 1])
        # Velocity over the ground's axes at the start of the step, and its slopes.
        vx, vx_1, vx_2 = c * u - sway_s * v, c * u_1 - sway_s * v_1, c * u_2 - sway_s * v_2
        vy, vy_1, vy_2 = s * u + sway_c * v, s * u_1 + sway_c * v_1, s * u_2 + sway_c * v_2

        f = (force[k - 1] + m_v * r * v - (d1 + d2 * abs(u)) * u) / m_u
        g = -(d1 + 2.0 * d2 * abs(u)) / m_u
        g_u = -2.0 * d2 * math.copysign(1.0, u) / m_u
        below = 1.0 - 0.5 * h * g
        scale = h / below
        bend = 0.5 * h * scale * f / below
        old, old_1, old_2 = u, u_1, u_2
        u += scale * f
        u_1 += scale * (m_v * r * v_1 / m_u - old / m_u + g * old_1) + bend * (
            g_u * old_1 - 1.0 / m_u
        )
        u_2 += scale * (m_v * r * v_2 / m_u - old * abs(old) / m_u + g * old_2) + bend * (
            g_u * old_2 - 2.0 * abs(old) / m_u
        )

        mean, mean_1, mean_2 = 0.5 * (old + u), 0.5 * (old_1 + u_1), 0.5 * (old_2 + u_2)
        e1, e2 = drag_linear[1], drag_quadratic[1]
        f = (-m_u * r * mean - (e1 + e2 * abs(v)) * v) / m_v
        g = -(e1 + 2.0 * e2 * abs(v)) / m_v
        g_v = -2.0 * e2 * math.copysign(1.0, v) / m_v
        below = 1.0 - 0.5 * h * g
        scale = h / below
        bend = 0.5 * h * scale * f / below * g_v
        v += scale * f
        v_1 += scale * (-m_u * r * mean_1 / m_v + g * v_1) + bend * v_1
        v_2 += scale * (-m_u * r * mean_2 / m_v + g * v_2) + bend * v_2

        sway_c, sway_s = math.cos(psi[k]), math.sin(psi[k])
        c, s = sway_c * cos_pitch[k], sway_s * cos_pitch[k]
        half = 0.5 * h
        x += half * (vx + c * u - sway_s * v)
        y += half * (vy + s * u + sway_c * v)
        x_1 += half * (vx_1 + c * u_1 - sway_s * v_1)
        y_1 += half * (vy_1 + s * u_1 + sway_c * v_1)
        x_2 += half * (vx_2 + c * u_2 - sway_s * v_2)
        y_2 += half * (vy_2 + s * u_2 + sway_c * v_2)
        track[k, 0], track[k, 1], speed[k] = x, y, u
        slopes[k, 0, 0], slopes[k, 1, 0] = x_1, y_1
        slopes[k, 0, 1], slopes[k, 1, 1] = x_2, y_2
