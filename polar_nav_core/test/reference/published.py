"""The paper's printed matrices, as printed and as corrected on the sphere.

Source: the paper's equations (5), (6), (7), (14) and the observation matrix of its section 4.2
[polarcoop2018]. The filter runs on `kernels.sins.error_model`, which is exact. What is wrong with
each printed matrix, and the test that shows it, stands in docs/misprints.md. All take latitude L
and longitude lam [rad] and a radius [m], for which R_N + h is the best choice; grid axes and signs
are the project's (phi is estimate minus truth), which for these matrices are the paper's too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from polar_nav_core.arrays import Array, vectors
from polar_nav_core.attitude import skew
from polar_nav_core.earth import ECCENTRICITY_2, OMEGA_IE, SEMI_MAJOR, geodetic_from_ecef
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid

from . import error_model


def _trig(lat: float, lon: float) -> tuple[float, float, float, float, float]:
    """Sines and cosines of latitude and longitude, and Delta = sqrt(1 - cos^2 L sin^2 lam)."""
    s_L, c_L, s_lon, c_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    delta = np.hypot(c_L * c_lon, s_L)
    if delta < 1e-8:
        raise ValueError('the grid frame is undefined on the equator at longitude +-90 deg')
    return float(s_L), float(c_L), float(s_lon), float(c_lon), float(delta)


def C_wieR(lat: float, lon: float, radius: float, corrected: bool = False) -> Array:
    """Error of the earth rate by position error, (6): (3, 3) [rad/s/m].

    Corrected: elements (1,1), (1,2), (1,3), and row 3 without the common factor 1/Delta^3.
    """
    s_L, c_L, s_l, c_l, D = _trig(lat, lon)
    D3 = D**3
    row_2 = [s_L**2 / D3, 0.0, -s_L * c_L * c_l / D3]
    row_3 = np.array([-s_L * c_L * c_l, -s_L * c_L * s_l, c_L**2])
    if corrected:
        row_1 = [
            (1.0 + D**2) * c_L**2 * s_L * s_l * c_l / D3,
            -s_L * D,
            c_L * s_l * (s_L**2 - D**2 * c_L**2) / D3,
        ]
    else:
        row_1 = [
            2.0 * c_L**2 * s_L * s_l * c_l / D3,
            -s_L * (c_l**2 + s_l**2 * (s_L**2 - c_L**2)) / D3,
            s_L**2 * c_L * s_l / D3,
        ]
        row_3 = row_3 / D3
    return OMEGA_IE / radius * np.array([row_1, row_2, row_3])


def C_weGR(
    lat: float, lon: float, radius: float, v_E: float, v_N: float, corrected: bool = False
) -> Array:
    """Error of the transport rate by position error, (7): (3, 3) [rad/s/m].

    v_E, v_N: grid axes [m/s]. Corrected: element (3,2) is -v_N Delta, and 2 becomes 1 + Delta^2 in
    (3,1) and (3,3).
    """
    s_L, c_L, s_l, c_l, D = _trig(lat, lon)
    two = 1.0 + D**2 if corrected else 2.0
    return (
        np.array(
            [
                [v_N * c_L * c_l, v_N * c_L * s_l, v_N * s_L],
                [-v_E * c_L * c_l, -v_E * c_L * s_l, -v_E * s_L],
                [
                    two * v_N * c_L**2 * s_l * c_l / D**3,
                    -v_N * D if corrected else -v_N / D,
                    two * v_N * s_L * c_L * s_l / D**3,
                ],
            ]
        )
        / radius**2
    )


def C_betaR(lat: float, lon: float, radius: float, corrected: bool = False) -> Array:
    """Turn of the grid frame by position error, (14): (3, 3) [rad/m].

    Corrected: element (2,1) is negative.
    """
    s_L, c_L, s_l, c_l, D = _trig(lat, lon)
    sign = -1.0 if corrected else 1.0
    return (
        np.array(
            [
                [s_L / D, 0.0, -c_l * c_L / D],
                [sign * s_l * c_l * c_L**2 / D, D, -s_l * s_L * c_L / D],
                [c_L * s_L * s_l / D**2, 0.0, -(c_L**2) * s_l * c_l / D**2],
            ]
        )
        / radius
    )


def C_omega(phi_x: float, phi_y: float) -> Array:
    """Rates of the misalignment angles to angular rate, (5): (3, 3); right as printed.

    The sequence is z, x, y. Its inverse multiplies a bracket that is already linear in phi: at
    first order it is the unit matrix.
    """
    s_x, c_x, s_y, c_y = np.sin(phi_x), np.cos(phi_x), np.sin(phi_y), np.cos(phi_y)
    return np.array([[c_y, 0.0, -s_y * c_x], [0.0, 1.0, s_x], [s_y, 0.0, c_y * c_x]])


def observation_matrix(corrected: bool = False) -> Array:
    """H of section 4.2 for the observation (velocity, position), 24 states.

    As printed it is 24 x 6 (transposed) and its first identity stands on phi. Corrected, (6, 24):
    velocity and position. Neither has a column for the DVL errors, the USBL bias, or [V x] on phi.
    """
    H = np.zeros((6, X.size))
    H[:3, X.dv_G if corrected else X.phi_G] = np.eye(3)
    H[3:, X.dr_e] = np.eye(3)
    return H if corrected else H.T


def system_matrix(
    r_e: ArrayLike, v_G: ArrayLike, C_b_G: ArrayLike, f_b: ArrayLike, corrected: bool = False
) -> Array:
    """A_SINS of section 4.1, (15, 15), from (6), (7), (14).

    The error of gravity is dropped, as in the paper. What the paper uses without printing it
    (C_weGv) is exact. Arguments as `error_model.system_matrix`.
    """
    F = error_model.system_matrix(r_e, v_G, C_b_G, f_b)
    lat, lon, height = (float(value) for value in geodetic_from_ecef(r_e))
    radius = SEMI_MAJOR / float(np.sqrt(1.0 - ECCENTRICITY_2 * np.sin(lat) ** 2)) + height
    v = vectors(v_G, 'v_G')
    earth = C_wieR(lat, lon, radius, corrected)
    transport = C_weGR(lat, lon, radius, float(v[0]), float(v[1]), corrected)
    turn = C_betaR(lat, lon, radius, corrected)
    F[X.phi_G, X.dr_e] = earth + transport
    F[X.dv_G, X.dr_e] = skew(v) @ (2.0 * earth + transport)
    F[X.dr_e, X.dr_e] = -ecef_to_grid(r_e).T @ skew(v) @ turn
    return F
