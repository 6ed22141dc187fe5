"""Plain NumPy twins of the kernels: the same equations in matrices, written apart from them."""

import numpy as np
from scipy.spatial.transform import Rotation

A_E = 6378137.0
F_E = 1.0 / 298.257223563
E2 = F_E * (2.0 - F_E)
B_E = A_E * (1.0 - F_E)
W_IE = 7.292115e-5
GM = 3.986004418e14


def cross(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0.0]])


def geodetic(r):
    """Up vector and height by fixed-point iteration on the latitude (not Bowring's formula)."""
    p = np.hypot(r[0], r[1])
    lat = np.arctan2(r[2], p * (1.0 - E2))
    for _ in range(12):
        N = A_E / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
        lat = np.arctan2(r[2] + E2 * N * np.sin(lat), p)
    s, c = np.sin(lat), np.cos(lat)
    h = p * c + r[2] * s - A_E * np.sqrt(1.0 - E2 * s * s)
    horizontal = np.array([r[0], r[1]]) / p if p > 0.0 else np.zeros(2)
    return np.array([c * horizontal[0], c * horizontal[1], s]), h


def gravity(s, h):
    s2 = s * s
    m = W_IE**2 * A_E**2 * B_E / GM
    g0 = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - E2 * s2)
    return g0 * (1.0 - 2.0 / A_E * (1.0 + F_E + m - 2.0 * F_E * s2) * h + 3.0 * h * h / A_E**2)


def axes(u):
    """C_e_G by cross products."""
    N = np.cross(u, [0.0, 1.0, 0.0])
    N = N / np.linalg.norm(N)
    return np.array([np.cross(N, u), N, u])


def curvature(u, h):
    """Horizontal 2 x 2 curvature in grid axes, from the principal radii."""
    s = u[2]
    W = np.sqrt(1.0 - E2 * s * s)
    R_N, R_M = A_E / W, A_E * (1.0 - E2) / W**3
    C = axes(u)
    p = (C @ [0.0, 0.0, 1.0])[:2]
    c2 = p @ p
    if c2 < 1e-20:
        return np.eye(2) / (R_N + h)
    north = np.outer(p, p) / c2
    # true north components turn with R_M, east ones with R_N
    return north / (R_M + h) + (np.eye(2) - north) / (R_N + h)


def rates(r, v):
    """omega_ie_G and omega_eG_G, from the turn of up and grid north without a y part."""
    u, h = geodetic(r)
    C = axes(u)
    K = curvature(u, h)
    du = K @ v[:2]
    w_x, w_y = -du[1], du[0]
    # grid north keeps no e_y component: d/dt (N . e_y) = (w x N) . e_y = 0
    w_z = u[1] / np.hypot(u[0], u[2]) * w_x
    return W_IE * C[:, 2], np.array([w_x, w_y, w_z])


def derivatives(C, v, r, w_b, f_b):
    """Right-hand side of the grid mechanization."""
    w_ie, w_eG = rates(r, v)
    u, h = geodetic(r)
    dC = C @ cross(w_b) - cross(w_ie + w_eG) @ C
    dv = C @ f_b - np.cross(2.0 * w_ie + w_eG, v) - [0.0, 0.0, gravity(u[2], h)]
    return dC, dv, axes(u).T @ v


def step(C, v, r, dth, dvel, dth_prev, dvel_prev, dt):
    """The kernel's step in matrices: returns new C, v, r."""
    sigma = dth + np.cross(dth_prev, dth) / 12.0
    angle2 = sigma @ sigma
    b = 0.5 - angle2 / 24.0 + angle2**2 / 720.0 - angle2**3 / 40320.0
    c = 1.0 / 6.0 - angle2 / 120.0 + angle2**2 / 5040.0
    w = dvel + b * np.cross(dth, dvel) + c * np.cross(dth, np.cross(dth, dvel))
    w = w + (np.cross(dth_prev, dvel) + np.cross(dvel_prev, dth)) / 12.0
    d = C @ w
    p = 0.5 * dt * d
    r_mid = r + 0.5 * dt * axes(geodetic(r)[0]).T @ v
    u, h = geodetic(r_mid)
    w_ie, w_eG = rates(r_mid, v)
    zeta = w_ie + w_eG
    moment = dt * d - p
    moment = moment - dt / 3.0 * np.cross(zeta, moment)
    g = gravity(u[2], h) * dt * np.array([0.0, 0.0, 1.0])
    d = d - np.cross(zeta, moment) - g
    p = p - dt / 3.0 * np.cross(zeta, p)
    mean = v + p / dt - 0.5 * dt * np.cross(2.0 * w_ie + w_eG, v) - 0.5 * g
    _, w_eG = rates(r_mid, mean)
    v_new = v + d - dt * np.cross(2.0 * w_ie + w_eG, mean)
    r_new = r + dt * axes(u).T @ mean
    turn = Rotation.from_rotvec(-dt * (w_ie + w_eG)).as_matrix()
    return turn @ C @ Rotation.from_rotvec(sigma).as_matrix(), v_new, r_new
