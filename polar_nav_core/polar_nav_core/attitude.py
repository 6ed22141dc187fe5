"""Attitude: Euler angles of the project, direction cosine matrices, quaternions, rotation vectors.

``C_b_G = Rz(psi) Ry(theta) Rx(phi)``, body x forward, y left, z up: psi counter-clockwise from
grid east, theta > 0 nose down, phi > 0 right side down (docs/frames.md). Quaternions are
Hamilton's, in the order x, y, z, w of geometry_msgs/Quaternion. All functions are vectorised over
leading axes; angles in radians.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrices, scalar_or_array, vectors

C_RFU_TO_FLU = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Takes components in right-forward-up axes (the papers') to forward-left-up (ours)."""
C_RFU_TO_FLU.flags.writeable = False
_NO_LENGTH = 'q has zero length or is not finite: it is not an attitude'


def skew(a: ArrayLike) -> Array:
    """[a x]: the matrix of the cross product, ``skew(a) @ b = a x b``. (..., 3) -> (..., 3, 3)."""
    v = vectors(a, 'a')
    result = np.zeros((*v.shape, 3))
    result[..., 0, 1] = -v[..., 2]
    result[..., 0, 2] = v[..., 1]
    result[..., 1, 0] = v[..., 2]
    result[..., 1, 2] = -v[..., 0]
    result[..., 2, 0] = -v[..., 1]
    result[..., 2, 1] = v[..., 0]
    return result


def exp(rotation_vector: ArrayLike) -> Array:
    """Rotation matrix exp([a x]) of a rotation vector a [rad]. (..., 3) -> (..., 3, 3)."""
    a = vectors(rotation_vector, 'rotation_vector')
    S = skew(a)
    angle = np.sqrt(np.sum(a * a, axis=-1))[..., None, None]
    # np.sinc(x) = sin(pi x) / (pi x): finite at zero
    half = np.sinc(0.5 * angle / np.pi)
    result: Array = np.eye(3) + np.sinc(angle / np.pi) * S + 0.5 * half * half * (S @ S)
    return result


def log(C: ArrayLike) -> Array:
    """Rotation vector [rad] of a rotation matrix, of length at most pi. (..., 3, 3) -> (..., 3).

    By way of the quaternion, which keeps full precision at small angles and at half turns.
    """
    q = quaternion_from_matrix(C)
    if q.ndim == 1:
        return _log_of_one(q)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.sqrt(np.sum(q[..., :3] ** 2, axis=-1))
    angle = 2.0 * np.arctan2(sine, q[..., 3])
    small = sine < 1e-9
    factor = np.where(small, 2.0, angle / np.where(small, 1.0, sine))
    result: Array = factor[..., None] * q[..., :3]
    return result


def matrix_from_euler(psi: ArrayLike, theta: ArrayLike, phi: ArrayLike) -> Array:
    """C_b_G = Rz(psi) Ry(theta) Rx(phi). Three (...) [rad] -> (..., 3, 3)."""
    z, y, x = np.broadcast_arrays(
        np.asarray(psi, np.float64), np.asarray(theta, np.float64), np.asarray(phi, np.float64)
    )
    cz, sz = np.cos(z), np.sin(z)
    cy, sy = np.cos(y), np.sin(y)
    cx, sx = np.cos(x), np.sin(x)
    rows = [
        np.stack([cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx], axis=-1),
        np.stack([sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx], axis=-1),
        np.stack([-sy, cy * sx, cy * cx], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def euler_from_matrix(C_b_G: ArrayLike) -> tuple[Array, Array, Array]:
    """(psi, theta, phi) [rad] of C_b_G. (..., 3, 3) -> (...).

    psi and phi are in [-pi, pi], theta in [-pi/2, pi/2].
    Straight up or down (theta = +-pi/2) only psi -+ phi is defined: phi is set to zero there.
    """
    C = matrices(C_b_G, 'C_b_G')
    cos_theta = np.hypot(C[..., 0, 0], C[..., 1, 0])
    theta = np.arctan2(-C[..., 2, 0], cos_theta)
    vertical = cos_theta < 1e-12
    psi = np.where(
        vertical,
        np.arctan2(-C[..., 0, 1], C[..., 1, 1]),
        np.arctan2(C[..., 1, 0], C[..., 0, 0]),
    )
    phi = np.where(vertical, 0.0, np.arctan2(C[..., 2, 1], C[..., 2, 2]))
    return scalar_or_array(psi), scalar_or_array(theta), scalar_or_array(phi)


def grid_heading(C_b_G: ArrayLike) -> Array:
    """Heading of body x, clockwise from grid north [rad], in [0, 2 pi). (..., 3, 3) -> (...)."""
    psi, _, _ = euler_from_matrix(C_b_G)
    return scalar_or_array(np.asarray(np.mod(0.5 * np.pi - psi, 2.0 * np.pi)))


def quaternion_from_matrix(C: ArrayLike) -> Array:
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix. (..., 3, 3) -> (..., 4).

    Shepperd's method: the largest of the four components is found from the diagonal first.
    """
    M = matrices(C, 'C')
    if M.ndim == 2:
        return _quaternion_of_one(M)
    xx, yy, zz = M[..., 0, 0], M[..., 1, 1], M[..., 2, 2]
    xy, wz = M[..., 0, 1] + M[..., 1, 0], M[..., 1, 0] - M[..., 0, 1]
    xz, wy = M[..., 0, 2] + M[..., 2, 0], M[..., 0, 2] - M[..., 2, 0]
    yz, wx = M[..., 1, 2] + M[..., 2, 1], M[..., 2, 1] - M[..., 1, 2]
    # four times the products of each component with all four
    products = [
        [1 + xx - yy - zz, xy, xz, wx],
        [xy, 1 - xx + yy - zz, yz, wy],
        [xz, yz, 1 - xx - yy + zz, wz],
        [wx, wy, wz, 1 + xx + yy + zz],
    ]
    rows = np.stack([np.stack(row, axis=-1) for row in products], axis=-2)
    best = np.argmax(np.stack([xx, yy, zz, xx + yy + zz], axis=-1), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    result: Array = np.where(q[..., 3:] < 0.0, -q, q)
    return result


def _quaternion_of_one(C: Array) -> Array:
    """`quaternion_from_matrix` of one matrix, in plain numbers: forty times as fast."""
    (xx, ab, ac), (ba, yy, bc), (ca, cb, zz) = C.tolist()
    xy, xz, yz, wz, wy, wx = ab + ba, ac + ca, bc + cb, ba - ab, ac - ca, cb - bc
    trace = xx + yy + zz
    largest = max(xx, yy, zz, trace)
    if largest == xx:
        q = 1 + xx - yy - zz, xy, xz, wx
    elif largest == yy:
        q = xy, 1 - xx + yy - zz, yz, wy
    elif largest == zz:
        q = xz, yz, 1 - xx - yy + zz, wz
    else:
        q = wx, wy, wz, 1 + xx + yy + zz
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    length = math.copysign(length, q[3]) if q[3] else length
    return np.array([value / length for value in q])


def _log_of_one(q: Array) -> Array:
    """`log` of one quaternion with w >= 0, in plain numbers."""
    x, y, z, w = q.tolist()
    sine = math.sqrt(x * x + y * y + z * z)
    # NumPy's arctangent: the last bit is that of `log` of many.
    factor = 2.0 if sine < 1e-9 else 2.0 * float(np.arctan2(sine, w)) / sine
    return np.array([factor * x, factor * y, factor * z])


def matrix_from_quaternion(q: ArrayLike) -> Array:
    """Rotation matrix of a quaternion (x, y, z, w) of any length. (..., 4) -> (..., 3, 3)."""
    value = np.asarray(q, np.float64)
    if value.ndim == 0 or value.shape[-1] != 4:
        raise ValueError(f'q must have shape (..., 4), not {value.shape}')
    if value.ndim == 1:
        return _matrix_of_one(value)
    norm2 = np.sum(value * value, axis=-1)
    if not np.all(norm2 > 0.0):
        raise ValueError(_NO_LENGTH)
    value = value / np.sqrt(norm2)[..., None]
    x, y, z, w = value[..., 0], value[..., 1], value[..., 2], value[..., 3]
    rows = [
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1),
        np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1),
        np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def _matrix_of_one(q: Array) -> Array:
    """`matrix_from_quaternion` of one quaternion, in plain numbers: thirty times as fast."""
    x, y, z, w = q.tolist()
    norm2 = x * x + y * y + z * z + w * w
    if not norm2 > 0.0:
        raise ValueError(_NO_LENGTH)
    length = math.sqrt(norm2)
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def orthonormalised(C: ArrayLike) -> Array:
    """The rotation matrix nearest to C: for matrices from outside. (..., 3, 3) -> (..., 3, 3)."""
    left, _, right = np.linalg.svd(matrices(C, 'C'))
    sign = np.linalg.det(left @ right)
    left[..., :, 2] *= sign[..., None]
    result: Array = left @ right
    return result
