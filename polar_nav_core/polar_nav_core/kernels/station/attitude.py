"""Attitude of an AHRS smoothed with its rates: docs/derivations/station.md, section 3."""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel, routine
from ..sins.update import Ints

_LOST = 0.3
"""Beyond this angle [rad] the smoothed attitude starts anew."""
_SETTLED = 3.0
"""The mean of the first samples draws by more than so many times the usual share."""
MEMORY_S = 10.0
"""For how long a turn of the AHRS against its own rates is remembered [s]."""


@kernel
def turn(C: Array, x: float, y: float, z: float, D: Array) -> None:
    """D = C exp([x y z]), by the rotation vector in body axes."""
    a2 = x * x + y * y + z * z
    a = math.sqrt(a2)
    s = math.sin(a) / a if a > 1e-8 else 1.0
    k = (1.0 - math.cos(a)) / a2 if a > 1e-8 else 0.5
    for i in range(3):
        c0 = C[i, 0]
        c1 = C[i, 1]
        c2 = C[i, 2]
        # row times [r x], twice
        p0 = c1 * z - c2 * y
        p1 = c2 * x - c0 * z
        p2 = c0 * y - c1 * x
        q0 = p1 * z - p2 * y
        q1 = p2 * x - p0 * z
        q2 = p0 * y - p1 * x
        D[i, 0] = c0 + s * p0 + k * q0
        D[i, 1] = c1 + s * p1 + k * q1
        D[i, 2] = c2 + s * p2 + k * q2


@kernel
def square_up(C: Array) -> None:
    """Make the rows of a rotation matrix orthonormal again after rounding."""
    dot = 0.5 * (C[0, 0] * C[1, 0] + C[0, 1] * C[1, 1] + C[0, 2] * C[1, 2])
    for j in range(3):
        a = C[0, j]
        b = C[1, j]
        C[0, j] = a - dot * b
        C[1, j] = b - dot * a
    for i in range(2):
        n = math.sqrt(C[i, 0] * C[i, 0] + C[i, 1] * C[i, 1] + C[i, 2] * C[i, 2])
        for j in range(3):
            C[i, j] /= n
    C[2, 0] = C[0, 1] * C[1, 2] - C[0, 2] * C[1, 1]
    C[2, 1] = C[0, 2] * C[1, 0] - C[0, 0] * C[1, 2]
    C[2, 2] = C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0]


@entry
@routine
def smooth(
    stamps: Ints,
    omega_ib_b: Array,
    C_b_G: Array,
    unexplained: Array,
    first: int,
    last: int,
    tau: float,
    omega_G: Array,
) -> None:
    """Blend samples first..last-1 of C_b_G with the rates, in place; number i stands at i % n.

    The attitude turns with the rates and is drawn to what the AHRS says with the time constant tau
    [s]; in the beginning it is the mean.

    Parameters
    ----------
    stamps, omega_ib_b, C_b_G : (n,), (n, 3), (n, 3, 3) arrays
        Those before ``first`` are smoothed already.
    unexplained : (n,) array, out
        Angle about up by which the AHRS has drawn the attitude away from its rates, of the last
        seconds [rad].
    omega_G : (3,) rate of the Earth, grid axes
    """
    n = stamps.shape[0]
    if tau <= 0.0:
        return
    for i in range(max(first, 1), last):
        k = i % n
        C = C_b_G[k]
        B = C_b_G[(i - 1) % n]
        dt = (stamps[k] - stamps[(i - 1) % n]) * 1e-9
        unexplained[k] = 0.0
        if not 0.0 < dt < tau:
            continue
        before = unexplained[(i - 1) % n] * (1.0 - dt / MEMORY_S)
        x = B[0, 0] * omega_G[0] + B[1, 0] * omega_G[1] + B[2, 0] * omega_G[2]
        y = B[0, 1] * omega_G[0] + B[1, 1] * omega_G[1] + B[2, 1] * omega_G[2]
        z = B[0, 2] * omega_G[0] + B[1, 2] * omega_G[1] + B[2, 2] * omega_G[2]
        m00 = C[0, 0]
        m01 = C[0, 1]
        m02 = C[0, 2]
        m10 = C[1, 0]
        m11 = C[1, 1]
        m12 = C[1, 2]
        m20 = C[2, 0]
        m21 = C[2, 1]
        m22 = C[2, 2]
        turn(
            B,
            dt * (omega_ib_b[k, 0] - x),
            dt * (omega_ib_b[k, 1] - y),
            dt * (omega_ib_b[k, 2] - z),
            C,
        )
        # Rotation from there to the measured attitude, body axes: half the skew part of C^T M.
        x = 0.5 * (
            C[0, 2] * m01 + C[1, 2] * m11 + C[2, 2] * m21
            - C[0, 1] * m02 - C[1, 1] * m12 - C[2, 1] * m22
        )  # fmt: skip
        y = 0.5 * (
            C[0, 0] * m02 + C[1, 0] * m12 + C[2, 0] * m22
            - C[0, 2] * m00 - C[1, 2] * m10 - C[2, 2] * m20
        )  # fmt: skip
        z = 0.5 * (
            C[0, 1] * m00 + C[1, 1] * m10 + C[2, 1] * m20
            - C[0, 0] * m01 - C[1, 0] * m11 - C[2, 0] * m21
        )  # fmt: skip
        same = C[0, 0] * m00 + C[1, 0] * m10 + C[2, 0] * m20
        up = C[2, 0] * x + C[2, 1] * y + C[2, 2] * z
        if x * x + y * y + z * z > _LOST * _LOST or same < 0.0:
            unexplained[k] = before + (
                math.asin(min(max(up, -1.0), 1.0)) if same > 0.0 else math.pi
            )
            C[0, 0] = m00
            C[0, 1] = m01
            C[0, 2] = m02
            C[1, 0] = m10
            C[1, 1] = m11
            C[1, 2] = m12
            C[2, 0] = m20
            C[2, 1] = m21
            C[2, 2] = m22
        else:
            gain = max(1.0 - math.exp(-dt / tau), 1.0 / (i + 1.0))
            # The first samples make the mean: they draw, but against no attitude yet.
            unexplained[k] = before + (gain * up if gain < _SETTLED * dt / tau else 0.0)
            turn(C, gain * x, gain * y, gain * z, C)
            square_up(C)
