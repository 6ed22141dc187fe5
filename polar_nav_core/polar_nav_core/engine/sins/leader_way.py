"""Shape of the position error of a leader that dead reckons, from its way.

Derivation: docs/derivations/leader_error.md, section 2.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from .leader_drift import Drift

ALIKE = 0.3
"""Of the stated variance, the share that is the same in all directions: what a way cannot tell."""
SLOW_MPS, SLOW_S = 0.002, 300.0
"""Slow error of a leader's DVL and its correlation time: those of the leader's own defaults."""


class Way:
    """What a leader's heading error and the slow error of its DVL have made of its way so far.

    A heading that wanders has turned each part of the way by what it was off then. Per unit of
    its variance, that is a covariance of the position, and one with the heading of now.

    Parameters
    ----------
    tau_s : float
        Correlation time of the heading [s].
    """

    def __init__(self, tau_s: float) -> None:
        self._tau_s = tau_s
        self._begin(0, np.zeros(3))

    def packed(self) -> list[float]:
        """All that it has heard, sixteen numbers, for `unpack`."""
        (xx, xy), (_, yy) = self._turned.tolist()
        heard = (*self._start_e, self._farthest, self._sailed, *self._last_e)
        turned = (self._stamp_ns, *self._faded, xx, xy, yy, self._slow, self._pulled)
        return [float(value) for value in (*heard, *turned)]

    def unpack(self, values: list[float]) -> None:
        """Replace what it has heard; zeros are nothing."""
        self._start_e, self._last_e = np.array(values[:3]), np.array(values[5:8])
        self._farthest, self._sailed = values[3:5]
        self._stamp_ns, self._faded = int(values[8]), np.array(values[9:11])
        xx, xy, yy, self._slow, self._pulled = values[11:]
        self._turned = np.array([[xx, xy], [xy, yy]])

    def columns(
        self,
        stamp_ns: int,
        leader_e: Array,
        C_e_G: Array,
        turn_G: Array,
        sigmas: tuple[float, float],
        linked: float,
        drift: Drift,
    ) -> Array:
        """Columns of `leader.Split` in grid axes, (3, 3) [m].

        Parameters
        ----------
        stamp_ns : int
            Of the validity; packets may come out of order.
        leader_e : (3,) array
            ECEF [m].
        C_e_G : (3, 3) array
            Grid axes there.
        turn_G : (3,) array
            Change of the fix per radian of turn of the array [m].
        sigmas : (float, float)
            1-sigma of its position per horizontal axis (> 0) [m], of its heading [rad].
        linked : float
            Degree, 0 to 1, to which its position is dead reckoned along that heading (`Link`).
        drift : Drift
            That has heard the same packet.
        """
        position, heading = sigmas
        if drift.fell or not self._start_e.any():
            self._begin(stamp_ns, leader_e)
        self._follow(stamp_ns, leader_e, C_e_G)
        way = (C_e_G @ (leader_e - self._start_e))[:2]
        by_heading = linked * heading
        turned = math.sqrt(_largest(self._turned))
        grown = drift.grown(position)
        if by_heading * turned > grown:
            by_heading = grown / turned
        gained = drift.gained(position)
        slow = min(SLOW_MPS**2 * self._slow, gained)
        rate = math.sqrt(gained - slow) / self._farthest if self._farthest > 0.0 else 0.0
        unexplained = max(0.0, rate**2 - by_heading**2)
        P = rate**2 * np.outer(way, way) + unexplained * np.outer(_across(way), _across(way))
        P += by_heading**2 * (self._turned - np.outer(self._faded, self._faded))
        P += (drift.start**2 + slow) * np.eye(2)
        explained = min(1.0, by_heading / rate) if rate > 0.0 else 0.0
        straight = math.hypot(*way) / self._sailed if self._sailed > 0.0 else 0.0
        shaped = (1.0 - ALIKE) * (linked * min(1.0, straight)) ** 2 * explained
        A = np.zeros((3, 3))
        A[:2, :2] = _square_root(shaped * P + (1.0 - shaped) * position**2 * np.eye(2))
        A[:, 2] = heading * turn_G
        A[:2, 2] += by_heading * self._faded
        return A

    def _follow(self, stamp_ns: int, leader_e: Array, C_e_G: Array) -> None:
        if stamp_ns <= self._stamp_ns:
            return
        self._farthest = max(self._farthest, math.hypot(*(C_e_G @ (leader_e - self._start_e))[:2]))
        dt = (stamp_ns - self._stamp_ns) * 1e-9
        turn = _across((C_e_G @ (leader_e - self._last_e))[:2])
        self._sailed += math.hypot(*turn)
        crossed = np.outer(turn, self._faded)
        self._turned = self._turned + crossed + crossed.T + np.outer(turn, turn)
        self._faded = (self._faded + turn) * math.exp(-dt / self._tau_s)
        # The integral of a Markov velocity of unit variance, and its covariance with that.
        kept = math.exp(-dt / SLOW_S)
        lasting = SLOW_S * (1.0 - kept)
        self._slow += 2.0 * self._pulled * lasting + 2.0 * SLOW_S * (dt - lasting)
        self._pulled = self._pulled * kept + lasting
        self._last_e, self._stamp_ns = leader_e.copy(), stamp_ns

    def _begin(self, stamp_ns: int, start_e: Array) -> None:
        self._start_e, self._last_e, self._stamp_ns = start_e.copy(), start_e.copy(), stamp_ns
        self._farthest = self._sailed = 0.0
        self._faded = np.zeros(2)
        """Up x way, as far as the heading error of now has turned it [m]."""
        self._turned = np.zeros((2, 2))
        """Covariance of the position per variance of heading [m^2]."""
        self._slow = self._pulled = 0.0


def _across(r_G: Array) -> Array:
    """Return up x r, (2,), of the horizontal part of r."""
    return np.array([-r_G[1], r_G[0]])


def _largest(P: Array) -> float:
    (xx, xy), (_, yy) = P.tolist()
    return max(0.0, float(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)))


def _square_root(P: Array) -> Array:
    """Symmetric square root of a symmetric (2, 2) matrix without negative eigenvalues."""
    (xx, xy), (_, yy) = P.tolist()
    root = math.sqrt(max(0.0, xx * yy - xy * xy))
    scale = math.sqrt(xx + yy + 2.0 * root)
    return np.asarray((P + root * np.eye(2)) / scale)
