"""What a leader's position error has in it that stays the same for a whole dive.

Derivation: docs/derivations/leader_error.md, section 4.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...link.fields import SIGMA_RATIO

COLUMNS = 4
"""Turn and scale of the leader's way, error at its start (grid east, north)."""
FALL = 0.2
"""A logarithm of sigma that falls by more from packet to packet: the leader got a fix itself."""
UNLINKED = (1.1, 1.6)
"""Heading sigma times distance, over position sigma: up to the first the position is taken for
dead reckoned along that heading, from the second on for held by something else."""
SHOWN = 2.0
"""So many packets in a row have to show the latter for it to be kept (`Link`)."""


def link(by_heading: float, position: float) -> float:
    """Degree, 0 to 1, to which a leader's position is dead reckoned along its stated heading.

    Parameters
    ----------
    by_heading, position : float
        Heading sigma times the distance, 1-sigma of position per horizontal axis (> 0) [m].
    """
    low, high = UNLINKED
    return min(1.0, max(0.0, (high - by_heading / position) / (high - low)))


class Link:
    """Degree to which a leader's position is dead reckoned along its stated heading, so far.

    A leader that was far enough for its packets to show that something else holds it stays so when
    it comes back to where it began, where `link` could not tell. One packet that is off is no
    proof: it takes two in a row, and of a leader that may be linked in part nothing is kept. Nor
    has a heading brought about more than the position's sigma has grown by.

    Parameters
    ----------
    keeps : bool
        False: present packets alone tell, as up to engine 8.
    """

    def __init__(self, *, keeps: bool) -> None:
        self._keeps = keeps
        self._shown = 0.0  # packets in a row that showed it, up to those it takes

    @property
    def most(self) -> float:
        """Largest degree that the packets so far allow: 1, or 0 for good."""
        return float(self._shown < SHOWN)

    def packed(self) -> list[float]:
        """What it has heard, one number, for `unpack`."""
        return [self._shown]

    def unpack(self, values: list[float]) -> None:
        """Replace what it has heard; zero is nothing."""
        (self._shown,) = values

    def at(self, by_heading: float, position: float, grown: float) -> float:
        """Degree at a packet, with arguments as of `link` (position > 0) and `Drift.grown`."""
        degree = link(by_heading, position)
        if not self._keeps:
            return degree
        if self._shown < SHOWN:
            self._shown = self._shown + 1.0 if degree == 0.0 else 0.0
        return min(self.most, degree, grown / by_heading) if by_heading > 0.0 else self.most


class Drift:
    """Constant errors of a leader that dead reckons, from the sigmas in its packets.

    Its way since it began to drift is turned by a constant angle and too long by a constant share,
    and its error at the start stays. The sigma of both rates is that by which the stated sigma has
    grown over the farthest distance from there.
    """

    def __init__(self) -> None:
        self._start_e = np.zeros(3)
        self._start = 0.0  # sigma there; 0: nothing is known
        self._newest, self._newest_ns = 0.0, 0
        self._farthest = 0.0
        self._fell = False

    @property
    def fell(self) -> bool:
        """Whether the packet heard last states that the leader got a fix itself."""
        return self._fell

    @property
    def start(self) -> float:
        """Sigma of its position where it began to drift [m]; 0 if nothing is known."""
        return self._start

    def packed(self) -> list[float]:
        """All that it has heard, seven numbers, for `unpack`."""
        heard = (*self._start_e, self._start, self._newest, self._newest_ns, self._farthest)
        return [float(value) for value in heard]

    def unpack(self, values: list[float]) -> None:
        """Replace what it has heard; zeros are nothing."""
        *start_e, self._start, self._newest, newest_ns, self._farthest = values
        self._start_e, self._newest_ns = np.array(start_e), int(newest_ns)

    def grown(self, sigma: float) -> float:
        """Most by which a sigma has grown since the drift began [m]; both were rounded."""
        least = self._start if self._start > 0.0 else sigma
        return math.sqrt(max(0.0, SIGMA_RATIO * sigma * sigma - least * least))

    def gained(self, sigma: float) -> float:
        """Variance that a sigma has gained since then [m^2]."""
        return max(0.0, sigma * sigma - self._start * self._start)

    def columns(
        self,
        stamp_ns: int,
        leader_e: Array,
        C_e_G: Array,
        sigma: float,
        heading: float,
        most: float = 1.0,
    ) -> Array:
        """Change of a fix per sigma of each constant error, (3, COLUMNS), grid axes [m].

        Parameters
        ----------
        stamp_ns : int
            Of the validity; packets may come out of order.
        leader_e : (3,) array
            ECEF [m].
        C_e_G : (3, 3) array
            Grid axes there.
        sigma, heading : float
            1-sigma of its position per horizontal axis [m], of its heading [rad].
        most : float
            `Link.most`.
        """
        columns = np.zeros((3, COLUMNS))
        self._fell = False
        if not sigma > 0.0:
            return columns
        way_G = C_e_G @ (leader_e - self._start_e)
        if stamp_ns > self._newest_ns or self._start == 0.0:
            self._fell = sigma < self._newest * math.exp(-FALL)
            if self._start == 0.0 or sigma <= self._start or self._fell:
                self._start_e, self._start, self._farthest = leader_e.copy(), sigma, 0.0
                way_G = np.zeros(3)
            self._newest, self._newest_ns = sigma, stamp_ns
            self._farthest = max(self._farthest, math.hypot(way_G[0], way_G[1]))
        grown = math.sqrt(self.gained(sigma))
        if not (grown > 0.0 and self._farthest > 0.0):
            return columns
        rate = grown / self._farthest
        # Of a linked leader the filter has the turn of the way among its states (leader.columns).
        by_states = min(most, link(heading * self._farthest, sigma)) * heading
        turn = math.sqrt(max(0.0, rate * rate - by_states * by_states))
        columns[:2, 0] = -turn * way_G[1], turn * way_G[0]
        columns[:2, 1] = rate * way_G[:2]
        columns[0, 2] = columns[1, 3] = self._start * grown / sigma
        return columns
