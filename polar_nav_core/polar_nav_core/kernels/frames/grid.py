"""Grid frame from the up vector, earth rate and transport rate in it (docs/derivations/grid.md).

G: x grid east, y grid north, z up. Grid north is the horizontal direction without an ECEF y
component. Nothing here knows latitude or longitude, so the poles are ordinary places. The only
singular places are where up is along +-e_y: on the equator at longitude +-90 degrees (Delta = 0).
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel
from .earth import (
    ECCENTRICITY_2,
    OMEGA_IE,
    SECOND_ECCENTRICITY_2,
    SEMI_MAJOR,
    SEMI_MINOR,
    radii,
    up_and_height,
)


@kernel
def delta(u_x: float, u_z: float) -> float:
    """Delta = sqrt(1 - u_y^2), without loss of digits; zero where the grid frame is singular."""
    return math.sqrt(u_x * u_x + u_z * u_z)


@kernel
def excess_curvature(u_z: float, height: float, i_n: float) -> float:
    """Curvature q [1/m]: q cos^2(lat) = 1/(R_M + h) - 1/(R_N + h); u_z is sin(lat).

    i_n: 1 / (R_N + h) [1/m].
    """
    w2 = 1.0 - ECCENTRICITY_2 * u_z * u_z
    w3 = w2 * math.sqrt(w2)
    return (
        i_n * (ECCENTRICITY_2 * SEMI_MAJOR) / ((1.0 - ECCENTRICITY_2) * SEMI_MAJOR + height * w3)
    )


@kernel
def curvatures(
    p_E: float, p_N: float, u_z: float, height: float, i_n: float
) -> tuple[float, float, float]:
    """Curvatures (k_EE, k_EN, k_NN) [1/m] of the height surface in grid axes.

    p_E, p_N: components of the spin axis in the horizontal plane, grid axes; p_E^2 + p_N^2 =
    cos^2(lat). i_n: 1 / (R_N + h) [1/m].
    """
    q = excess_curvature(u_z, height, i_n)
    return i_n + q * p_E * p_E, q * p_E * p_N, i_n + q * p_N * p_N


@kernel
def frame_near(x: float, y: float, z: float) -> tuple[float, float, float, float, float, float]:
    """(u_x, u_y, u_z, 1/Delta, 1/(R_N + h), h) by one pass of Bowring's formula.

    For the strapdown step. Error in u: 2e-14 at 4 km from the ellipsoid, 1.4e-13 at 10 km, 1.3e-11
    at 100 km, growing as h^2. Both norms are taken of the same vector, so that they can be
    computed side by side.
    """
    p2 = x * x + y * y
    sb = SEMI_MAJOR * z
    i = 1.0 / math.sqrt(sb * sb + SEMI_MINOR * SEMI_MINOR * p2)
    sb *= i
    cb = SEMI_MINOR * i
    s = z + SECOND_ECCENTRICITY_2 * SEMI_MINOR * sb * sb * sb
    c = 1.0 - ECCENTRICITY_2 * SEMI_MAJOR * cb * cb * cb * p2
    x_n = c * x
    y_n = c * y
    d2 = x_n * x_n + s * s
    norm = math.sqrt(d2 + y_n * y_n)
    i = 1.0 / norm
    u_z = s * i
    height = (c * p2 + s * z) * i - SEMI_MAJOR * math.sqrt(1.0 - ECCENTRICITY_2 * u_z * u_z)
    # (R_N + h) cos(lat) = p
    return x_n * i, y_n * i, u_z, norm / math.sqrt(d2), c * i, height


@kernel
def fill_C_e_G(u_x: float, u_y: float, u_z: float, C_e_G: Array) -> None:
    """C_e_G, shape (3, 3): rows grid east, grid north, up, in ECEF."""
    d = delta(u_x, u_z)
    i = 1.0 / d
    C_e_G[0, 0] = -u_x * u_y * i
    C_e_G[0, 1] = d
    C_e_G[0, 2] = -u_y * u_z * i
    C_e_G[1, 0] = -u_z * i
    C_e_G[1, 1] = 0.0
    C_e_G[1, 2] = u_x * i
    C_e_G[2, 0] = u_x
    C_e_G[2, 1] = u_y
    C_e_G[2, 2] = u_z


@kernel
def fill_rates(r_e: Array, v_G: Array, omega_ie_G: Array, omega_eG_G: Array) -> None:
    """Earth and transport rate (3,) [rad/s] at r_e [m] for v_G [m/s], exact on the ellipsoid."""
    u_x, u_y, u_z, h = up_and_height(r_e[0], r_e[1], r_e[2])
    i = 1.0 / delta(u_x, u_z)
    p_E = -u_y * u_z * i
    p_N = u_x * i
    _, r_n = radii(u_z)
    k_EE, k_EN, k_NN = curvatures(p_E, p_N, u_z, h, 1.0 / (r_n + h))
    omega_ie_G[0] = OMEGA_IE * p_E
    omega_ie_G[1] = OMEGA_IE * p_N
    omega_ie_G[2] = OMEGA_IE * u_z
    w_x = -(k_EN * v_G[0] + k_NN * v_G[1])
    omega_eG_G[0] = w_x
    omega_eG_G[1] = k_EE * v_G[0] + k_EN * v_G[1]
    omega_eG_G[2] = u_y * i * w_x


@entry
@kernel
def fill_C_e_G_many(r_e: Array, C_e_G: Array) -> None:
    """`fill_C_e_G` at each row of r_e, shape (n, 3), into C_e_G (n, 3, 3)."""
    for i in range(r_e.shape[0]):
        u_x, u_y, u_z, _ = up_and_height(r_e[i, 0], r_e[i, 1], r_e[i, 2])
        fill_C_e_G(u_x, u_y, u_z, C_e_G[i])


@entry
@kernel
def fill_rates_many(r_e: Array, v_G: Array, omega_ie_G: Array, omega_eG_G: Array) -> None:
    """`fill_rates` at each row; all of shape (n, 3)."""
    for i in range(r_e.shape[0]):
        fill_rates(r_e[i], v_G[i], omega_ie_G[i], omega_eG_G[i])
