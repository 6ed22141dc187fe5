"""Axes of foreign sensors: by name, by angles or by a quaternion.

A rotation here is `C_s_b`, which takes components in the sensor's axes to the body's
(x forward, y left, z up). A name says where the sensor's x, y and z point: ``frd`` is forward,
right, down.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import matrix_from_euler, matrix_from_quaternion

_DIRECTIONS = {
    'f': (1.0, 0.0, 0.0),
    'b': (-1.0, 0.0, 0.0),
    'l': (0.0, 1.0, 0.0),
    'r': (0.0, -1.0, 0.0),
    'u': (0.0, 0.0, 1.0),
    'd': (0.0, 0.0, -1.0),
}


def named(name: str) -> Array:
    """C_s_b, shape (3, 3), of three letters out of f, b, l, r, u, d: where x, y and z point.

    Raises
    ------
    ValueError
        For other letters, and for axes that are not a right-handed system.
    """
    word = name.lower()
    if len(word) != 3 or any(c not in _DIRECTIONS for c in word):
        raise ValueError(
            f'{name!r} names no axes: three letters of f(orward), b(ackward), l(eft), r(ight), '
            'u(p), d(own), as in flu or frd'
        )
    C_s_b = np.array([_DIRECTIONS[c] for c in word]).T
    if abs(np.linalg.det(C_s_b) - 1.0) > 1e-9:
        raise ValueError(f'{name!r}: these axes are not a right-handed system')
    return C_s_b


def from_rpy_deg(rpy_deg: Sequence[float]) -> Array:
    """C_s_b of roll, pitch and yaw [deg] of the sensor in the body, Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = np.radians(np.asarray(rpy_deg, dtype=np.float64))
    return np.asarray(matrix_from_euler(yaw, pitch, roll))


def from_quaternion(xyzw: Sequence[float]) -> Array:
    """C_s_b of a quaternion (x, y, z, w), of any length but zero."""
    return np.asarray(matrix_from_quaternion(np.asarray(xyzw, dtype=np.float64)))


def all_named() -> dict[str, Array]:
    """Return the 24 right-handed systems of axes along the body's, by name."""
    found = {}
    for a in _DIRECTIONS:
        for b in _DIRECTIONS:
            for c in _DIRECTIONS:
                try:
                    found[a + b + c] = named(a + b + c)
                except ValueError:
                    continue
    return found
