"""WGS-84: up vector and height, radii, normal gravity (docs/derivations/grid.md, section 1).

Regular at both poles, without angles.

Constants: NIMA TR8350.2 (WGS-84 defining and derived parameters); earth rate as in
polar-cooperative navigation practice, 7.292115e-5 rad/s.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel

SEMI_MAJOR = 6378137.0  # m
FLATTENING = 1.0 / 298.257223563
SEMI_MINOR = SEMI_MAJOR * (1.0 - FLATTENING)  # m
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
SECOND_ECCENTRICITY_2 = ECCENTRICITY_2 / (1.0 - ECCENTRICITY_2)
OMEGA_IE = 7.292115e-5  # rad/s
GM = 3.986004418e14  # m^3/s^2
GAMMA_EQUATOR = 9.7803253359  # m/s^2
SOMIGLIANA_K = 0.00193185265241
GRAVITY_M = OMEGA_IE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM


@kernel
def up_and_height(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Up vector u (ellipsoid normal, ECEF) and height [m] of an ECEF position [m].

    Bowring's formula, twice, in sines and in cosines divided by p = hypot(x, y): the horizontal
    part of u is (x, y) times a finite factor, so p = 0 needs no branch. Error under 1e-15 in u for
    heights from
    -100 km to 1000 km (test_earth.py). Only the centre of the earth gives NaN.
    """
    p2 = x * x + y * y
    # beta, reduced latitude: sin(beta), cos(beta)/p
    sb = SEMI_MAJOR * z
    cb = SEMI_MINOR
    for _ in range(2):
        norm = 1.0 / math.sqrt(sb * sb + cb * cb * p2)
        sb *= norm
        cb *= norm
        s = z + SECOND_ECCENTRICITY_2 * SEMI_MINOR * sb * sb * sb
        c = 1.0 - ECCENTRICITY_2 * SEMI_MAJOR * cb * cb * cb * p2
        sb = (1.0 - FLATTENING) * s
        cb = c
    norm = 1.0 / math.sqrt(s * s + c * c * p2)
    s *= norm
    c *= norm
    height = c * p2 + s * z - SEMI_MAJOR * math.sqrt(1.0 - ECCENTRICITY_2 * s * s)
    return c * x, c * y, s, height


@kernel
def radii(sin_lat: float) -> tuple[float, float]:
    """Meridian and prime-vertical radius of curvature (R_M, R_N) [m]."""
    w2 = 1.0 - ECCENTRICITY_2 * sin_lat * sin_lat
    r_n = SEMI_MAJOR / math.sqrt(w2)
    return r_n * (1.0 - ECCENTRICITY_2) / w2, r_n


@kernel
def gravity(sin_lat: float, height: float) -> float:
    """Normal gravity along -u, centrifugal part included [m/s^2].

    Somigliana on the ellipsoid, with the free-air terms in h and h^2. The true normal gravity
    above the ellipsoid has a further north component of 8e-9 h sin(2 lat), left out.
    """
    s2 = sin_lat * sin_lat
    surface = GAMMA_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / math.sqrt(1.0 - ECCENTRICITY_2 * s2)
    return surface * (
        1.0
        - 2.0 / SEMI_MAJOR * (1.0 + FLATTENING + GRAVITY_M - 2.0 * FLATTENING * s2) * height
        + 3.0 / SEMI_MAJOR**2 * height * height
    )


@kernel
def gravity_slopes(sin_lat: float, height: float) -> tuple[float, float]:
    """Derivatives of `gravity` with respect to height [1/s^2] and to sin(lat) [m/s^2]."""
    s2 = sin_lat * sin_lat
    w2 = 1.0 - ECCENTRICITY_2 * s2
    w = math.sqrt(w2)
    surface = GAMMA_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / w
    slope = 1.0 + FLATTENING + GRAVITY_M - 2.0 * FLATTENING * s2
    factor = 1.0 - 2.0 / SEMI_MAJOR * slope * height + 3.0 / SEMI_MAJOR**2 * height * height
    by_height = surface * (-2.0 / SEMI_MAJOR * slope + 6.0 / SEMI_MAJOR**2 * height)
    surface_by_s2 = GAMMA_EQUATOR * SOMIGLIANA_K / w + 0.5 * ECCENTRICITY_2 * surface / w2
    by_s2 = surface_by_s2 * factor + surface * 4.0 * FLATTENING / SEMI_MAJOR * height
    return by_height, 2.0 * sin_lat * by_s2


@entry
@kernel
def up_and_height_many(r_e: Array, u_e: Array, height: Array) -> None:
    """`up_and_height` of each row of r_e, shape (n, 3), into u_e (n, 3) and height (n,)."""
    for i in range(r_e.shape[0]):
        x, y, z, h = up_and_height(r_e[i, 0], r_e[i, 1], r_e[i, 2])
        u_e[i, 0] = x
        u_e[i, 1] = y
        u_e[i, 2] = z
        height[i] = h


@entry
@kernel
def gravity_many(r_e: Array, out: Array) -> None:
    """`gravity` at each row of r_e, shape (n, 3), into out (n,)."""
    for i in range(r_e.shape[0]):
        _, _, s, h = up_and_height(r_e[i, 0], r_e[i, 1], r_e[i, 2])
        out[i] = gravity(s, h)
