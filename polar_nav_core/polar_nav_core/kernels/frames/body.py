"""The fast part of the strapdown: rotation and velocity of one IMU sample in the body frame.

Two-sample coning and sculling from the previous increments, and the rotation compensation of the
velocity increment that is exact for constant rate and force (docs/derivations/grid.md, section 4).
"""

from __future__ import annotations

import math

from ..cache import kernel

EQUAL_INTERVALS = 1.0 / 12.0
"""`coning_weight` of two intervals of one length."""

# Powers of a^2 in sin(a/2)/a, cos(a/2) and (a - sin a)/a^3.
_S = tuple(0.5 * (-0.25) ** k / math.factorial(2 * k + 1) for k in range(4))
_C = tuple((-0.25) ** k / math.factorial(2 * k) for k in range(4))
_D = tuple((-1.0) ** k / math.factorial(2 * k + 3) for k in range(4))


@kernel
def rotation_coefficients(angle2: float) -> tuple[float, float, float]:
    """(sin(a/2)/a, cos(a/2), (a - sin a)/a^3) of a^2; by series below 0.05 rad."""
    if angle2 < 0.0025:
        return (
            _S[0] + angle2 * (_S[1] + angle2 * (_S[2] + angle2 * _S[3])),
            _C[0] + angle2 * (_C[1] + angle2 * (_C[2] + angle2 * _C[3])),
            _D[0] + angle2 * (_D[1] + angle2 * (_D[2] + angle2 * _D[3])),
        )
    angle = math.sqrt(angle2)
    return (
        math.sin(0.5 * angle) / angle,
        math.cos(0.5 * angle),
        (angle - math.sin(angle)) / (angle2 * angle),
    )


@kernel
def coning_weight(dt: float, dt_prev: float) -> float:
    """Weight of (previous x current) increments: 1/12 for equal intervals, 0 for the first.

    From rate and force linear in time over both intervals: dt^2 / (6 dt_prev (dt + dt_prev)).
    """
    if dt_prev <= 0.0:
        return 0.0
    return dt * dt / (6.0 * dt_prev * (dt + dt_prev))


@kernel
def body_sample(
    a_x: float, a_y: float, a_z: float,
    f_x: float, f_y: float, f_z: float,
    ap_x: float, ap_y: float, ap_z: float,
    fp_x: float, fp_y: float, fp_z: float,
    weight: float,
) -> tuple[float, float, float, float, float, float, float]:  # fmt: skip
    """Rotation and velocity gained in one sample, in the body frame of its start.

    The coning term is perpendicular to a; taking |a + coning| for |a| in the rotation of f changes
    terms of sixth order.

    Parameters
    ----------
    a_x, a_y, a_z : float
        Increment of angle, integral of omega_ib_b [rad].
    f_x, f_y, f_z : float
        Increment of velocity, integral of the specific force f_b [m/s].
    ap_x, ap_y, ap_z, fp_x, fp_y, fp_z : float
        The same of the interval before; zero for the first.
    weight : float
        Of previous x current increments, by `coning_weight` [-].

    Returns
    -------
    tuple
        Quaternion (x, y, z, w), end to start; velocity (x, y, z) [m/s].
    """
    s_x = a_x + weight * (ap_y * a_z - ap_z * a_y)
    s_y = a_y + weight * (ap_z * a_x - ap_x * a_z)
    s_z = a_z + weight * (ap_x * a_y - ap_y * a_x)
    s, c, d = rotation_coefficients(s_x * s_x + s_y * s_y + s_z * s_z)
    # f + (1 - cos)/a^2 a x f + (a - sin)/a^3 a x (a x f) + sculling
    b = 2.0 * s * s
    x = a_y * f_z - a_z * f_y
    y = a_z * f_x - a_x * f_z
    z = a_x * f_y - a_y * f_x
    w_x = f_x + b * x + d * (a_y * z - a_z * y)
    w_y = f_y + b * y + d * (a_z * x - a_x * z)
    w_z = f_z + b * z + d * (a_x * y - a_y * x)
    w_x += weight * (ap_y * f_z - ap_z * f_y + fp_y * a_z - fp_z * a_y)
    w_y += weight * (ap_z * f_x - ap_x * f_z + fp_z * a_x - fp_x * a_z)
    w_z += weight * (ap_x * f_y - ap_y * f_x + fp_x * a_y - fp_y * a_x)
    return s * s_x, s * s_y, s * s_z, c, w_x, w_y, w_z
