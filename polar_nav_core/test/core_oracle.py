"""An exact trajectory, its IMU signal, and an independent ECEF mechanization of that signal.

The trajectory is analytic in ECEF coordinates: x(t), y(t) are smooth, z(t) keeps the point on the
ellipsoid with axes a + h, b + h. Attitude is a fixed frame with the paper's oscillation (4, 5, 3
degrees; 3, 5, 7 s), which grows from zero in the first minute: a start in full swing leaves, after
two-sample coning, a constant of order dt^3 (test_strapdown.py has that case). Nothing of the
package is used: neither grid frame nor Bowring's formula.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

W_IE = 7.292115e-5
A_E = 6378137.0
F_E = 1.0 / 298.257223563
B_E = A_E * (1.0 - F_E)
E2 = F_E * (2.0 - F_E)
GM = 3.986004418e14
M_E = W_IE**2 * A_E**2 * B_E / GM
AMPLITUDES = (math.radians(4.0), math.radians(5.0), math.radians(3.0))
PERIODS = (3.0, 5.0, 7.0)


@dataclass
class Trajectory:
    """Start (x, y), velocity in ECEF, hemisphere, height, sway, growth time of oscillation."""

    x0: float
    y0: float
    v_x: float
    v_y: float
    sign: float = 1.0
    height: float = -100.0
    sway: float = 0.5
    sway_period: float = 11.0
    growth: float = 20.0

    def _sample(self, t):
        path = (
            self.x0,
            self.y0,
            self.v_x,
            self.v_y,
            self.sign,
            self.height,
            self.sway,
            self.sway_period,
        )
        t = np.ascontiguousarray(t, dtype=float)
        out = np.empty((len(t), 24))
        _sample(t, np.array(path), self.growth, self.frame(), out)
        return out

    def path(self, t):
        """r_e and v_e, each (n, 3)."""
        out = self._sample(t)
        return out[:, 0:3], out[:, 3:6]

    def attitude(self, t):
        """C_b_e, (n, 3, 3)."""
        return self._sample(t)[:, 6:15].reshape(-1, 3, 3)

    def imu(self, t):
        """omega_ib_b, f_b (n, 3): exact at the times t."""
        out = self._sample(t)
        return np.ascontiguousarray(out[:, 15:18]), np.ascontiguousarray(out[:, 18:21])

    def frame(self):
        """C_L_e of the start: z axis up, y axis horizontal, parallel to the Greenwich plane."""
        z = self.sign * (B_E + self.height)
        q = (self.x0**2 + self.y0**2) / (A_E + self.height) ** 2
        u, _ = up_height([self.x0, self.y0, z * math.sqrt(1.0 - q)])
        N = np.cross(u, [0.0, 1.0, 0.0])
        N /= np.linalg.norm(N)
        return np.ascontiguousarray(np.column_stack([np.cross(N, u), N, u]))

    def increments(self, duration, dt, begin=0.0):
        """Integrals of the IMU signal over steps of dt, by Gauss-Legendre: two (n, 3)."""
        n = round(duration / dt)
        nodes, weights = np.polynomial.legendre.leggauss(3 if dt <= 0.02 else 6)
        dtheta, dvel = np.zeros((n, 3)), np.zeros((n, 3))
        starts = begin + np.arange(n) * dt
        for node, weight in zip(nodes, weights, strict=True):
            omega, f = self.imu(starts + 0.5 * dt * (1.0 + node))
            dtheta += 0.5 * dt * weight * omega
            dvel += 0.5 * dt * weight * f
        return dtheta, dvel

    def start(self):
        """C_b_e, v_e, r_e at t = 0."""
        r, v = self.path([0.0])
        return self.attitude([0.0])[0], v[0], r[0]


@numba.njit
def _sample(t, path, growth, C_L_e, out):
    """r, v, C_b_e, omega_ib_b, f_b at each time into rows of out."""
    x0, y0, v_x, v_y, sign, height, a, period = path
    k = 2.0 * math.pi / period
    A2 = (A_E + height) ** 2
    B = sign * (B_E + height)
    angle = np.empty(3)
    rate = np.empty(3)
    R = np.empty((3, 3))
    for i in range(len(t)):
        s, c = math.sin(k * t[i]), math.cos(k * t[i])
        x, y = x0 + v_x * t[i] + a * s, y0 + v_y * t[i] + a * c
        dx, dy = v_x + a * k * c, v_y - a * k * s
        ddx, ddy = -a * k * k * s, -a * k * k * c
        root = math.sqrt(1.0 - (x * x + y * y) / A2)
        dq = 2.0 * (x * dx + y * dy) / A2
        ddq = 2.0 * (dx * dx + x * ddx + dy * dy + y * ddy) / A2
        z, dz = B * root, -0.5 * B * dq / root
        ddz = -0.5 * B * (ddq / root + 0.5 * dq * dq / root**3)

        for j in range(3):
            w = 2.0 * math.pi / PERIODS[j]
            e, de = 1.0, 0.0
            if growth > 0.0:
                decay = math.exp(-((t[i] / growth) ** 2))
                e, de = 1.0 - decay, 2.0 * t[i] / growth**2 * decay
            angle[j] = AMPLITUDES[j] * e * math.sin(w * t[i])
            rate[j] = AMPLITUDES[j] * (de * math.sin(w * t[i]) + e * w * math.cos(w * t[i]))
        cx, sx, cy, sy = (
            math.cos(angle[0]),
            math.sin(angle[0]),
            math.cos(angle[1]),
            math.sin(angle[1]),
        )
        cz, sz = math.cos(angle[2] + 0.7), math.sin(angle[2] + 0.7)
        R[0, 0], R[0, 1], R[0, 2] = cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx
        R[1, 0], R[1, 1], R[1, 2] = sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx
        R[2, 0], R[2, 1], R[2, 2] = -sy, cy * sx, cy * cx
        r = np.array([x, y, z])
        g = gravity_e(r)
        f_e = (ddx - 2.0 * W_IE * dy - g[0], ddy + 2.0 * W_IE * dx - g[1], ddz - g[2])
        out[i, 0:3] = r
        out[i, 3], out[i, 4], out[i, 5] = dx, dy, dz
        out[i, 15] = rate[0] - rate[2] * sy
        out[i, 16] = rate[1] * cx + rate[2] * cy * sx
        out[i, 17] = -rate[1] * sx + rate[2] * cy * cx
        out[i, 18:21] = 0.0
        for m in range(3):
            for n in range(3):
                C = 0.0
                for q in range(3):
                    C += C_L_e[m, q] * R[q, n]
                out[i, 6 + 3 * m + n] = C
                out[i, 18 + n] += C * f_e[m]
        for n in range(3):
            out[i, 15 + n] += W_IE * out[i, 12 + n]


def up_height(r):
    """Up and height by Newton iteration on the parametric latitude."""
    return _up_height(float(r[0]), float(r[1]), float(r[2]))


@numba.njit
def _up_height(x, y, z):
    p = math.sqrt(x * x + y * y)
    beta = math.atan2(z * A_E, p * B_E)
    for _ in range(8):
        # distance to the ellipse is stationary: g(beta) = 0
        s, c = math.sin(beta), math.cos(beta)
        g = (A_E * A_E - B_E * B_E) * s * c - p * A_E * s + z * B_E * c
        dg = (A_E * A_E - B_E * B_E) * (c * c - s * s) - p * A_E * c - z * B_E * s
        beta -= g / dg
    s, c = math.sin(beta), math.cos(beta)
    n_p, n_z = c / A_E, s / B_E
    norm = math.sqrt(n_p * n_p + n_z * n_z)
    n_p /= norm
    n_z /= norm
    h = (p - A_E * c) * n_p + (z - B_E * s) * n_z
    if p > 0.0:
        return np.array([n_p * x / p, n_p * y / p, n_z]), h
    return np.array([0.0, 0.0, n_z]), h


@numba.njit
def gravity_e(r):
    """Gravity vector (centrifugal part included), ECEF."""
    u, h = _up_height(r[0], r[1], r[2])
    s2 = u[2] * u[2]
    g = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / math.sqrt(1.0 - E2 * s2)
    g *= 1.0 - 2.0 / A_E * (1.0 + F_E + M_E - 2.0 * F_E * s2) * h + 3.0 * (h / A_E) ** 2
    return -g * u


@numba.njit
def _rates(y, w, f):
    """Derivative of (quaternion w x y z of C_b_e, v_e, r_e)."""
    a, b, c, d = y[0], y[1], y[2], y[3]
    out = np.empty(10)
    # 1/2 (q w_ib - w_ie q)
    out[0] = 0.5 * (-b * w[0] - c * w[1] - d * w[2] + W_IE * d)
    out[1] = 0.5 * (a * w[0] + c * w[2] - d * w[1] + W_IE * c)
    out[2] = 0.5 * (a * w[1] + d * w[0] - b * w[2] - W_IE * b)
    out[3] = 0.5 * (a * w[2] + b * w[1] - c * w[0] - W_IE * a)
    n = a * a + b * b + c * c + d * d
    g = gravity_e(y[7:10])
    f_x = (
        (a * a + b * b - c * c - d * d) * f[0]
        + 2 * (b * c - a * d) * f[1]
        + 2 * (b * d + a * c) * f[2]
    ) / n
    f_y = (
        2 * (b * c + a * d) * f[0]
        + (a * a - b * b + c * c - d * d) * f[1]
        + 2 * (c * d - a * b) * f[2]
    ) / n
    f_z = (
        2 * (b * d - a * c) * f[0]
        + 2 * (c * d + a * b) * f[1]
        + (a * a - b * b - c * c + d * d) * f[2]
    ) / n
    out[4] = f_x + g[0] + 2 * W_IE * y[5]
    out[5] = f_y + g[1] - 2 * W_IE * y[4]
    out[6] = f_z + g[2]
    out[7:10] = y[4:7]
    return out


@numba.njit
def integrate(y, omega, f, dt, height, held):
    """RK4 in ECEF, in place; omega, f at 0, dt/2, dt, ... (2n+1, 3); held: height is kept."""
    for k in range((len(omega) - 1) // 2):
        i = 2 * k
        k1 = _rates(y, omega[i], f[i])
        k2 = _rates(y + 0.5 * dt * k1, omega[i + 1], f[i + 1])
        k3 = _rates(y + 0.5 * dt * k2, omega[i + 1], f[i + 1])
        k4 = _rates(y + dt * k3, omega[i + 2], f[i + 2])
        y += dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        y[:4] /= math.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2 + y[3] ** 2)
        if held:
            u, h = _up_height(y[7], y[8], y[9])
            y[7:10] += (height[k] - h) * u
            y[4:7] -= (y[4] * u[0] + y[5] * u[1] + y[6] * u[2]) * u


def state_vector(C, v, r):
    """(quaternion w x y z, v, r) of a start."""
    w = 0.5 * math.sqrt(max(0.0, 1.0 + np.trace(C)))
    if w > 0.1:
        q = np.array(
            [w, *(np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]]) / (4 * w))]
        )
    else:
        values, vectors = np.linalg.eig(C)
        axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
        angle = math.acos(max(-1.0, min(1.0, 0.5 * (np.trace(C) - 1.0))))
        sense = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]]) @ axis
        q = np.array(
            [math.cos(angle / 2), *(math.copysign(1.0, sense) * math.sin(angle / 2) * axis)]
        )
    return np.concatenate([q, v, r])
