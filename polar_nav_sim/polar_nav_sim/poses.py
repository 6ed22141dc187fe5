"""Poses of a vehicle at any time, by its exact truth or by its last truth messages.

The acoustic models need ends that move while sound travels; they ask a :class:`Poses` and do not
know which kind it is.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, earth, grid

from .trajectory import Truth
from .truth_cdr import TruthSample, decode

Floats = NDArray[np.float64]


class NotYet(Exception):
    """The requested pose lies in the future; ``needed_ns`` is its time."""

    def __init__(self, needed_ns: int) -> None:
        super().__init__(f'no pose at {needed_ns} ns yet')
        self.needed_ns = needed_ns


class NotKept(ValueError):
    """The requested pose lies before the oldest stored truth."""


class Pose(NamedTuple):
    """Position of base_link (ECEF [m]), body to earth, and depth [m]."""

    r_e: Floats
    C_b_e: Floats
    depth: float

    def point(self, arm_b: Floats) -> tuple[Floats, float]:
        """Position of a point of the vehicle, ECEF [m], and its depth [m]."""
        arm_e = self.C_b_e @ arm_b
        return np.asarray(self.r_e + arm_e), self.depth - float(earth.up(self.r_e) @ arm_e)


class Poses(Protocol):
    """Poses of one vehicle over a stretch of time."""

    def pose(self, t_ns: int) -> Pose:
        """Pose at a time [ns]; raises :class:`NotYet` for one in the future."""


class TrajectoryPoses:
    """Poses of an exact truth."""

    def __init__(self, trajectory: Truth) -> None:
        self._trajectory = trajectory

    def pose(self, t_ns: int) -> Pose:
        """Pose at a time [ns]."""
        s = self._trajectory.state(t_ns)
        return Pose(s.r_e, s.C_e_G.T @ s.C_b_G, float(s.depth))


class StillPoses:
    """Poses of a fixed vehicle."""

    def __init__(self, pose: Pose) -> None:
        self._pose = pose

    def pose(self, _t_ns: int) -> Pose:
        """The pose."""
        return self._pose


class TruthHistory:
    """Truth messages of the last seconds, decoded only for requested poses.

    Between two messages the position is the quintic that has their positions, velocities and
    accelerations, and the rotation from one to the other a cubic that has their angular rates:
    with messages 10 ms apart both are exact to rounding.

    Parameters
    ----------
    horizon_ns : int
        Length of the stored past [ns].
    """

    def __init__(self, horizon_ns: int) -> None:
        self._horizon_ns = horizon_ns
        self._stamps: deque[int] = deque()
        self._records: deque[bytes] = deque()
        self._ends: dict[int, _End] = {}

    @property
    def newest_ns(self) -> int:
        """Stamp of the last message [ns]; -1 before the first."""
        return self._stamps[-1] if self._stamps else -1

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest stored message [ns]; -1 before the first."""
        return self._stamps[0] if self._stamps else -1

    def add(self, stamp_ns: int, data: bytes) -> bool:
        """Store a serialized message; False if it is not newer than the last one."""
        if stamp_ns <= self.newest_ns:
            return False
        self._stamps.append(stamp_ns)
        self._records.append(data)
        while stamp_ns - self._stamps[0] > self._horizon_ns:
            self._ends.pop(self._stamps.popleft(), None)
            self._records.popleft()
        return True

    def pose(self, t_ns: int) -> Pose:
        """Pose at a time [ns].

        Raises
        ------
        NotYet
            After the newest message.
        NotKept
            Before the oldest stored one.
        """
        if t_ns > self.newest_ns:
            raise NotYet(t_ns)
        if t_ns < self.oldest_ns:
            raise NotKept(f'no pose at {t_ns} ns: kept are {self.oldest_ns} to {self.newest_ns}')
        i = bisect_left(self._stamps, t_ns)
        if self._stamps[i] == t_ns:
            end = self._end(i)
            return Pose(end.r_e, end.C_b_e, end.depth)
        return _between(self._end(i - 1), self._end(i), t_ns)

    def _end(self, i: int) -> _End:
        stamp_ns = self._stamps[i]
        if stamp_ns not in self._ends:
            self._ends[stamp_ns] = _end_of(decode(self._records[i]))
        return self._ends[stamp_ns]


class _End(NamedTuple):
    stamp_ns: int
    r_e: Floats
    v_e: Floats
    a_e: Floats
    C_b_e: Floats
    omega_eb_b: Floats
    depth: float


def _end_of(s: TruthSample) -> _End:
    r_e, v_G, C_b_G = s.vector('r_e'), s.vector('v_g'), s.C_b_G
    C_G_e = grid.ecef_to_grid(r_e).T
    C_b_e = C_G_e @ C_b_G
    v_e = C_G_e @ v_G
    spin_e = np.array([0.0, 0.0, earth.OMEGA_IE])
    a_e = (
        C_b_e @ s.vector('f_b')
        - 2.0 * np.cross(spin_e, v_e)
        - float(earth.gravity(r_e)) * earth.up(r_e)
    )
    omega_eb_b = s.vector('omega_ib_b') - C_b_e.T @ spin_e
    return _End(s.stamp_ns, r_e, v_e, a_e, C_b_e, omega_eb_b, s.number('depth'))


def _between(a: _End, b: _End, t_ns: int) -> Pose:
    h = (b.stamp_ns - a.stamp_ns) * 1e-9
    x = (t_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)
    x3 = x * x * x
    # Quintic Hermite polynomials for value, slope and curvature at both ends.
    p1 = x3 * (10.0 + x * (-15.0 + 6.0 * x))
    m0 = x + x3 * (-6.0 + x * (8.0 - 3.0 * x))
    m1 = x3 * (-4.0 + x * (7.0 - 3.0 * x))
    c0 = 0.5 * x * x + x3 * (-1.5 + x * (1.5 - 0.5 * x))
    c1 = x3 * (0.5 + x * (-1.0 + 0.5 * x))
    r_e = (
        a.r_e
        + p1 * (b.r_e - a.r_e)
        + h * (m0 * a.v_e + m1 * b.v_e)
        + h * h * (c0 * a.a_e + c1 * b.a_e)
    )
    turn = attitude.log(a.C_b_e.T @ b.C_b_e)
    # Rate of the rotation vector at its end: the inverse right Jacobian is I + [turn x]/2 + ...
    slope0 = h * a.omega_eb_b
    slope1 = h * (b.omega_eb_b + 0.5 * np.cross(turn, b.omega_eb_b))
    part = x * x * (3.0 - 2.0 * x) * turn + x * (1.0 - x) * ((1.0 - x) * slope0 - x * slope1)
    depth = (1.0 - x) * a.depth + x * b.depth
    return Pose(r_e, a.C_b_e @ attitude.exp(part), depth)
