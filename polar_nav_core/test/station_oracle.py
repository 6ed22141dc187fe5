"""The augmented model of station mode in plain NumPy: an oracle for the kernels."""

import math

import numpy as np

from polar_nav_core import earth, grid
from polar_nav_core.kernels.station import state as ss


def skew(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0.0]])


def turned(C, bias):
    c, s = np.cos(bias), np.sin(bias)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) @ C


def rates(x, C_A, omega, up, force, c):
    """x' of the state (12,); the errors of headings are constants."""
    total, share = math.exp(x[ss.DRAG]), x[ss.SHARE]
    d1, d2 = c.drag_linear.copy(), c.drag_quadratic.copy()
    d1[0], d2[0] = (1 - share) * total / c.speed, share * total / c.speed**2
    v = x[:3]
    a = -np.cross(omega, c.inertia * v) - (d1 + d2 * np.abs(v)) * v
    result = np.zeros(12)
    result[:3] = (a + force + c.net_buoyancy * up) / c.inertia
    result[3:6] = turned(C_A, x[ss.HEADING]) @ v
    result[3:5] += x[6:8]
    return result


def slopes(x, C_A, omega, c):
    """Jacobian of `rates`, written out."""
    total, share, v = math.exp(x[ss.DRAG]), x[ss.SHARE], x[:3]
    d1, d2 = c.drag_linear.copy(), c.drag_quadratic.copy()
    d1[0], d2[0] = (1 - share) * total / c.speed, share * total / c.speed**2
    F = np.zeros((12, 12))
    F[:3, :3] = -skew(omega) @ np.diag(c.inertia) - np.diag(d1 + 2 * d2 * np.abs(v))
    F[0, ss.DRAG] = -(d1[0] + d2[0] * abs(v[0])) * v[0]
    F[0, ss.SHARE] = -total * (abs(v[0]) * v[0] / c.speed**2 - v[0] / c.speed)
    F[:3] /= c.inertia[:, None]
    R = turned(C_A, x[ss.HEADING])
    F[3:6, :3] = R
    F[3, 6] = F[4, 7] = 1.0
    F[3:6, ss.HEADING] = -np.cross([0, 0, 1.0], R @ v)
    return F


def added(c, h, q_c):
    """Q of h seconds, a diagonal; nothing for the station's heading."""
    return h * np.array(
        [*[c.q_v] * 3, c.q_xy, c.q_xy, c.q_z, q_c, q_c, c.q_drag, c.q_drag, c.q_heading, 0.0]
    )


def place(p, c):
    """Vertical in the station frame, height and C_G_A at a place in the station frame."""
    r_e = c.origin_e + c.C_e_A.T @ p
    up = c.C_e_A @ earth.up(r_e)
    return up, float(earth.geodetic_from_ecef(r_e)[2]), c.C_e_A @ grid.ecef_to_grid(r_e).T


def range_and_bearing(x, C_A, fix, dt=0.0):
    """h(x) of a fix: slant range, bearing from the station's stated heading."""
    d = displaced(x, C_A, fix, dt)
    bearing = math.atan2(d[1], d[0]) - fix[ss.PSI] + x[ss.STATION]
    return np.array([np.linalg.norm(d), bearing])


def displaced(x, C_A, fix, dt):
    """From the station to the vehicle dt after the state."""
    v = turned(C_A, x[ss.HEADING]) @ x[:3] + np.array([x[6], x[7], 0.0])
    return x[3:6] + dt * v - fix[:3]


def fix_slopes(x, C_A, fix, dt=0.0):
    """Jacobian of `range_and_bearing` by complex steps: exact but for rounding."""
    columns = []
    for i in range(12):
        y = x.astype(complex)
        y[i] += 1e-30j
        d = displaced(y, C_A, fix, dt)
        # the imaginary part of atan2
        angle = (d[0].real * d[1].imag - d[1].real * d[0].imag) / (d[0].real ** 2 + d[1].real ** 2)
        columns.append([np.sqrt(np.sum(d**2)).imag, angle + y[ss.STATION].imag])
    return np.array(columns).T / 1e-30
