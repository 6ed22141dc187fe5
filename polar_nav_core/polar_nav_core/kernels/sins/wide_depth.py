"""A depth beside a horizontal position that is uncertain by hundreds of metres.

The surface of equal depth is bent, its row of the Jacobian is a plane. Where the position is known
to sigma, plane and surface part by sigma^2 / R: 16 cm for a kilometre, more than a depth's sigma.
Every correction then turns the plane a little, the next depth takes that for a slope of the
position, and after some seconds depths place the vehicle to a few hundred metres, kilometres from
where it is. A depth says nothing of the horizontal position: where the bend counts, its row is
turned so that it has no gain there, and what that leaves out counts as noise.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .update import N

_RADIUS = 6.4e6
"""Of the Earth [m]."""
_SHARE = 0.1
"""Of a depth's sigma that plane and surface may part by."""
_DR = 6


@kernel
def level_row(P: Array, H: Array, R: Array, C_e_G: Array) -> None:
    """Turn a depth's row, the first of H, and enlarge its variance R[0, 0], where the bend counts.

    Parameters
    ----------
    P : (24, 24) array
    H : (3, 24) array, in place
    R : (3, 3) array, in place
    C_e_G : (3, 3) array
        At the estimate.
    """
    most = (_SHARE * _RADIUS) * (_SHARE * _RADIUS) * R[0, 0]
    p = P[_DR, _DR] + P[_DR + 1, _DR + 1] + P[_DR + 2, _DR + 2]
    if not p * p > most:  # nearly always
        return
    ee = 0.0
    en = 0.0
    nn = 0.0
    e = 0.0
    n = 0.0
    for i in range(3):
        for j in range(3):
            v = P[_DR + i, _DR + j]
            ee += C_e_G[0, i] * v * C_e_G[0, j]
            en += C_e_G[0, i] * v * C_e_G[1, j]
            nn += C_e_G[1, i] * v * C_e_G[1, j]
        g = 0.0
        for k in range(N):
            g += P[_DR + i, k] * H[0, k]
        e += C_e_G[0, i] * g
        n += C_e_G[1, i] * g
    det = ee * nn - en * en
    if not ((ee + nn) * (ee + nn) > most and det > 0.0):
        return
    s_e = (nn * e - en * n) / det
    s_n = (ee * n - en * e) / det
    for k in range(3):
        H[0, _DR + k] -= s_e * C_e_G[0, k] + s_n * C_e_G[1, k]
    R[0, 0] += s_e * e + s_n * n
