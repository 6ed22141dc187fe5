"""Acceleration of the vehicle in its own axes, as a ping that is late by some time has missed it.

A ping that is late by b shows the velocity C^T v of a time b ago. To the first order that is off
by -b a, a the change of C^T v; to the second by -b a + b^2/2 da/dt, which of a vehicle that swings
is as large as the noise of a ping once b is a tenth of a second. With the acceleration of a time
tau ago, -b a(t - tau) = -b a + b tau da/dt, least is left over the ages that `dvl_latency_sigma`
states (half-normal) with tau = E b^3 / (2 E b^2) = sqrt(2/pi) sigma. A low-pass filter of that
time constant is late by tau (docs/derivations/common_errors.md).
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel

USUAL_AGE = math.sqrt(2.0 / math.pi)
"""Age of the acceleration, per sigma of the latency."""


@kernel
def body_acceleration(
    a_b: Array, C_b_G: Array, v_G: Array, omega_b: Array, f_b: Array, gravity: float
) -> None:
    """Change of the velocity in body axes: acceleration over ground less omega x v.

    Parameters
    ----------
    a_b : (3,) array, out
        d/dt (C_b_G^T v_G) [m/s^2].
    C_b_G, v_G : (3, 3), (3,) array
        Attitude, velocity [m/s].
    omega_b, f_b : (3,) array
        Rate [rad/s] and specific force [m/s^2], body axes.
    gravity : float
        [m/s^2].
    """
    x = C_b_G[0, 0] * v_G[0] + C_b_G[1, 0] * v_G[1] + C_b_G[2, 0] * v_G[2]
    y = C_b_G[0, 1] * v_G[0] + C_b_G[1, 1] * v_G[1] + C_b_G[2, 1] * v_G[2]
    z = C_b_G[0, 2] * v_G[0] + C_b_G[1, 2] * v_G[1] + C_b_G[2, 2] * v_G[2]
    a_b[0] = f_b[0] - gravity * C_b_G[2, 0] - (omega_b[1] * z - omega_b[2] * y)
    a_b[1] = f_b[1] - gravity * C_b_G[2, 1] - (omega_b[2] * x - omega_b[0] * z)
    a_b[2] = f_b[2] - gravity * C_b_G[2, 2] - (omega_b[0] * y - omega_b[1] * x)


@kernel
def follow(mean_b: Array, a_b: Array, sigma: float, dt: float, first: bool, share: Array) -> None:
    """Low-pass filter of an acceleration, late by what pings of that latency are.

    Parameters
    ----------
    mean_b : (3,) array, in place
    a_b : (3,) array
        Mean over the dt [s] that end now.
    sigma : float
        Of the latency [s], above 0.
    dt : float
    first : bool
        Whether there is none before.
    share : (2,) array, in place
        The last dt and what it was worth with this sigma: intervals hardly ever change.
    """
    if dt != share[0]:
        share[0], share[1] = dt, -math.expm1(-dt / (USUAL_AGE * sigma))
    taken = 1.0 if first else share[1]
    for k in range(3):
        mean_b[k] += taken * (a_b[k] - mean_b[k])
