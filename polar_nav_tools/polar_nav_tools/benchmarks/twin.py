"""Plain NumPy twins of the core's kernels: matrices and vectors, nothing by component.

They measure the gain of compiling. Written for clarity and without waste: latitude in closed
form, each quantity computed once.
"""

from __future__ import annotations

import numpy as np

from polar_nav_core.arrays import Array

_A = 6378137.0
_F = 1.0 / 298.257223563
_E2 = _F * (2.0 - _F)
_B = _A * (1.0 - _F)
_OMEGA_IE = 7.292115e-5
_M = _OMEGA_IE**2 * _A**2 * _B / 3.986004418e14


def skew(a: Array) -> Array:
    """[a x], so that [a x] b = a x b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def _exp(a: Array) -> Array:
    """Rotation matrix of the rotation vector a, by Rodrigues."""
    angle2 = a @ a
    angle = np.sqrt(angle2)
    X = skew(a)
    if angle < 1e-4:
        return np.eye(3) + X + 0.5 * X @ X
    return np.eye(3) + np.sin(angle) / angle * X + (1.0 - np.cos(angle)) / angle2 * X @ X


def _up_and_height(r_e: Array) -> tuple[Array, float]:
    """Up vector and height, by Bowring's formula."""
    p = np.hypot(r_e[0], r_e[1])
    beta = np.arctan2(r_e[2] * _A, p * _B)
    tangent = np.array(
        [p - _E2 * _A * np.cos(beta) ** 3, r_e[2] + _E2 / (1.0 - _E2) * _B * np.sin(beta) ** 3]
    )
    c, s = tangent / np.linalg.norm(tangent)
    up = np.array([c * r_e[0] / p, c * r_e[1] / p, s])
    return up, float(p * c + r_e[2] * s - _A * np.sqrt(1.0 - _E2 * s * s))


def _frame(up: Array) -> Array:
    """C_e_G from the up vector."""
    north = np.array([-up[2], 0.0, up[0]])
    north /= np.linalg.norm(north)
    return np.array([skew(north) @ up, north, up])


def _transport(C_e_G: Array, height: float, v_G: Array) -> Array:
    """Rate of the grid frame over the ellipsoid, from the principal radii."""
    up = C_e_G[2]
    W = np.sqrt(1.0 - _E2 * up[2] ** 2)
    R_N = _A / W + height
    R_M = _A * (1.0 - _E2) / W**3 + height
    pole = C_e_G[:2, 2]
    c2 = pole @ pole
    turn = v_G[:2] / R_N
    if c2 > 1e-20:
        turn = turn + pole * ((pole @ v_G[:2]) / c2 * (1.0 / R_M - 1.0 / R_N))
    w_x = -turn[1]
    return np.array([w_x, turn[0], up[1] / np.hypot(up[0], up[2]) * w_x])


def _gravity(s: float, h: float) -> float:
    """Somigliana's formula with height, s: sine of latitude [m/s^2]."""
    s2 = s * s
    g = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - _E2 * s2)
    linear = 2.0 / _A * (1.0 + _F + _M - 2.0 * _F * s2) * h
    return float(g * (1.0 - linear + 3.0 * h * h / _A**2))


def strapdown(
    C_b_G: Array, v_G: Array, r_e: Array, dtheta_b: Array, dvel_b: Array, dt: float
) -> tuple[Array, Array, Array]:
    """State after increments (n, 3) over the intervals dt [s]."""
    dtheta_prev = dvel_prev = np.zeros(3)
    for dtheta, dvel in zip(dtheta_b, dvel_b, strict=True):
        sigma = dtheta + skew(dtheta_prev) @ dtheta / 12.0
        angle2 = sigma @ sigma
        X = skew(dtheta)
        lever = X @ dvel
        d = dvel + (0.5 - angle2 / 24.0) * lever + (1.0 / 6.0 - angle2 / 120.0) * (X @ lever)
        d = C_b_G @ (d + (skew(dtheta_prev) @ dvel + skew(dvel_prev) @ dtheta) / 12.0)

        C_e_G = _frame(_up_and_height(r_e)[0])
        up, height = _up_and_height(r_e + 0.5 * dt * C_e_G.T @ v_G)
        C_e_G = _frame(up)
        omega_ie = _OMEGA_IE * C_e_G[:, 2]
        g = np.array([0.0, 0.0, _gravity(up[2], height) * dt])
        zeta = omega_ie + _transport(C_e_G, height, v_G)
        d = d - 0.5 * dt * skew(zeta) @ d - g
        mean = v_G + 0.5 * (d - dt * skew(omega_ie + zeta) @ v_G)
        zeta = omega_ie + _transport(C_e_G, height, mean)
        v_G = v_G + d - dt * skew(omega_ie + zeta) @ mean
        r_e = r_e + dt * C_e_G.T @ mean
        C_b_G = _exp(-dt * zeta) @ C_b_G @ _exp(sigma)
        dtheta_prev, dvel_prev = dtheta, dvel
    return C_b_G, v_G, r_e


def predict(P: Array, Phi: Array, Q: Array) -> Array:
    """Phi P Phi^T + Q."""
    return Phi @ P @ Phi.T + Q


def update(P: Array, H: Array, R: Array, z: Array) -> tuple[Array, Array]:
    """Estimated error and covariance after an update in Joseph's form."""
    PHt = P @ H.T
    S = H @ PHt + R
    K = np.linalg.solve(S, PHt.T).T
    IKH = np.eye(len(P)) - K @ H
    return K @ z, IKH @ P @ IKH.T + K @ R @ K.T
