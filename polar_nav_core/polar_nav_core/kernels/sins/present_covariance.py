"""Covariance of the state at the newest IMU sample: that of the filter's newest state, carried on.

The navigation states and the biases of the IMU; what is bled off meanwhile counts as error.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel, routine
from . import state as fs
from .ahead import STAMP
from .consider import add_common, add_conflict
from .offset import Profile, offset_at
from .present import Scratch, Track, last_sample
from .settings import Settings
from .state import State
from .update import N

_DV, _DR, _GYRO, _ACCEL = 3, 6, 9, 12


STATES = 15
"""Attitude, velocity, position and biases of the IMU."""


@kernel
def _add_rows(P: Array, to: int, share: Array, of: int, factor: float) -> None:
    """Add factor share (3, 3) times three rows of P to three others."""
    for j in range(STATES):
        x, y, z = P[of, j], P[of + 1, j], P[of + 2, j]
        for i in range(3):
            P[to + i, j] += factor * (share[i, 0] * x + share[i, 1] * y + share[i, 2] * z)


@kernel
def _transform(P: Array, B: Array, S: Array, E: Array, dt: float) -> None:
    """P <- F P for the transition F over dt [s]: each row before the rows that it takes from."""
    _add_rows(P, _DR, E, _DV, dt)
    _add_rows(P, _DV, S, 0, dt)
    _add_rows(P, _DV, B, _ACCEL, dt)
    _add_rows(P, 0, B, _GYRO, -dt)


@kernel
def _transpose(P: Array) -> None:
    for i in range(STATES):
        for j in range(i):
            P[i, j], P[j, i] = P[j, i], P[i, j]


@kernel
def _add_square(P: Array, at: int, x: float, y: float, z: float) -> None:
    """P <- P + u u^T in a block of three, u = (x, y, z)."""
    u = (x, y, z)
    for i in range(3):
        for j in range(3):
            P[at + i, at + j] += u[i] * u[j]


@entry
@routine
def covariance_now(
    s: State, c: Settings, t: Track, offset: Profile, turn: Profile, out: Array, w: Scratch
) -> None:
    """Fill the covariance (STATES, STATES) of the published track, at the IMU.

    That of the filter's state with common errors and conflicts, grown by the transition of the
    time ahead, plus the squares of the offsets that are still to be bled off: the track is off
    by them.
    """
    P, B, S, E = w.P, t.C_b_G, w.rotations[0], w.rotations[1]
    for i in range(N):
        for j in range(N):
            P[i, j] = s.P[i, j]
    if s.counters[fs.CONSIDERS] == 1:
        add_common(P, s.sensitivity, c.common, w.columns)
    add_conflict(P, s.conflict)
    dt = (t.marks[STAMP] - s.counters[fs.STAMP]) * 1e-9
    f_G = w.vectors[0]
    for i in range(3):
        f_G[i] = 0.0
        for k in range(3):
            f_G[i] += B[i, k] * last_sample(t, 1, k)
            E[i, k] = t.C_e_G[k, i]
        S[i, i] = 0.0
    S[0, 1], S[0, 2], S[1, 2] = -f_G[2], f_G[1], -f_G[0]
    S[1, 0], S[2, 0], S[2, 1] = f_G[2], -f_G[1], f_G[0]
    for _ in range(2):  # F P, then (F (F P)^T)^T, which is symmetric
        _transform(P, B, S, E, dt)
        _transpose(P)
    grown = dt * (1.0 + s.excess[0])
    for k in range(3):
        P[k, k] += grown * c.densities[0]
        P[_DV + k, _DV + k] += grown * c.densities[1]
    b, a = w.vectors[:2], w.vectors[2:]
    offset_at(offset, t.marks[STAMP], b)
    offset_at(turn, t.marks[STAMP], a)
    C = t.C_e_G
    _add_square(P, _DR, b[0, 0], b[0, 1], b[0, 2])
    for rows, at in ((b[1], _DV), (a[0], 0)):
        x, y, z = rows[0], rows[1], rows[2]
        _add_square(
            P,
            at,
            C[0, 0] * x + C[0, 1] * y + C[0, 2] * z,
            C[1, 0] * x + C[1, 1] * y + C[1, 2] * z,
            C[2, 0] * x + C[2, 1] * y + C[2, 2] * z,
        )
    for i in range(STATES):
        for j in range(STATES):
            out[i, j] = P[i, j]
