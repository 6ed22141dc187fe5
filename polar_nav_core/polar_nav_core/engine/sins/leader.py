"""What a fix shares with the fixes before it: position and heading error of its leader.

Derivation: docs/derivations/leader_error.md.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from ... import grid
from ...arrays import Array
from ...link.fields import SIGMA_RATIO
from ..events import Fix
from .leader_drift import COLUMNS, Drift, Link
from .leader_way import SLOW_S, Way

ROUNDING = 1.0 / 1.13
"""Share of a stated variance that is sure to be there: a packet rounds sigmas up by 6 %."""
WHITE_SHARE = 0.1
"""Of the white noise that a fix states, in the direction of the turn, at least so much stays."""
JUMP = 0.2
"""A logarithm of sigma that changes by more has changed at once: the leader got a fix itself."""
FAST_SHARE, FAST_S = 0.1, 25.0
"""Of the variance that a leader's position has gained, what changes fast, and how fast: ours. In
the model of two vehicles in the plane 10 s or 100 s change no RMS by more than 2 %."""
KEPT = 4096
"""Splits that are stored, because whole runs hand a fix in again that was not reached."""
NO_LEADER = np.zeros((3, 3 + COLUMNS))
_INFINITE = 1e300
"""What is not finite in a saved state."""
_SMOOTH_BOUNDS = (
    (-_INFINITE, 20.0), (0.0, 1e19), (0.0, 1e8), (0.0, 1e19), (-_INFINITE, 20.0),
    (-_INFINITE, 20.0), (1e-9, _INFINITE),
)  # fmt: skip
_BOUNDS = np.array(
    [
        *[(-1e8, 1e8)] * 3,
        *_SMOOTH_BOUNDS,
        *_SMOOTH_BOUNDS,
        *((0.0, _INFINITE), (0.0, 1e19), (1e-9, _INFINITE)),
        *[(-1e8, 1e8)] * 3,
        *((0.0, 1e9), (0.0, 1e9), (0.0, 1e19), (0.0, 1e8)),
        (0.0, 2.0),
        *[(-1e8, 1e8)] * 3,
        *((0.0, 1e8), (0.0, _INFINITE)),
        *[(-1e8, 1e8)] * 3,
        (0.0, 1e19),
        *[(-1e8, 1e8)] * 2,
        *((0.0, 1e16), (-1e16, 1e16), (0.0, 1e16)),
        *((0.0, 1e19), (0.0, SLOW_S)),
    ]
)
"""Least and largest of each number of `LeaderError.packed`."""
HEARD = len(_BOUNDS)
WAY = 16
"""Of these, those of `Way`."""


class Split(NamedTuple):
    """A fix's error in parts.

    Attributes
    ----------
    common_e : (3, 7) array
        Change of the fix per unit of errors of unit variance; columns in ECEF [m]. Three are
        estimated: position along the leader's grid east and north, heading. Four constant ones
        are considered: those of `Drift`.
    covariance_e : (3, 3) array
        Of what it shares with no other fix, ECEF [m^2].
    """

    common_e: Array
    covariance_e: Array

    @property
    def columns_e(self) -> Array:
        """Columns of the three that are estimated, (3, 3)."""
        return self.common_e[:, :3]

    @property
    def constants_e(self) -> Array:
        """Columns of the four that are considered, (3, 4)."""
        return self.common_e[:, 3:]


class Smooth:
    """Sigma behind the rounded one of a stream of packets.

    A rounded sigma stands still and jumps by 6 %. Taken as it is, an error of so many sigmas would
    have to jump, too, and fixes show that it does not: a filter would be sure within minutes that
    the error is nil. But a sigma that is rounded up and jumps is then at the edge of a step; from
    there it goes on to the next edge, as fast as from the last one, and never jumps itself.

    Nor does it fall faster than to 1/e in ``hold_s``: where a leader turns back its sigma shrinks
    for a while, but its error is not the same one grown smaller.

    Parameters
    ----------
    hold_s : float
        [s]
    """

    def __init__(self, hold_s: float) -> None:
        self._hold_s = hold_s
        self._held, self._held_ns = -math.inf, 0  # logarithm of the largest, when
        self._stated = 0.0
        self._since_ns = 0
        self._from = self._to = 0.0  # logarithms, over the time _takes_s
        self._takes_s = 1.0

    def packed(self) -> list[float]:
        """All that it has heard, for `unpack`."""
        heard = (self._held, self._held_ns, self._stated, self._since_ns, self._from, self._to)
        return [float(value) for value in (*heard, self._takes_s)]

    def unpack(self, values: list[float]) -> None:
        """Replace what it has heard."""
        self._held, held_ns, self._stated, since_ns, self._from, self._to, self._takes_s = values
        self._held_ns, self._since_ns = int(held_ns), int(since_ns)

    def at(self, stamp_ns: int, stated: float) -> float:
        """Sigma at a stamp [ns] of which a packet states this; packets may come out of order."""
        before = self._stated
        if not (before > 0.0 and stated > 0.0 and abs(math.log(stated / before)) < JUMP):
            self._stated, self._since_ns = stated, stamp_ns
            self._from = self._to = math.log(stated) if stated > 0.0 else -math.inf
            self._held, self._held_ns = self._from, stamp_ns
        elif stated != before and stamp_ns > self._since_ns:
            self._from = self._now(stamp_ns)
            self._to = math.log(stated if stated > before else stated / SIGMA_RATIO)
            self._takes_s = (stamp_ns - self._since_ns) * 1e-9
            self._stated, self._since_ns = stated, stamp_ns
        now = self._now(stamp_ns)
        held = self._held - max(0.0, (stamp_ns - self._held_ns) * 1e-9) / self._hold_s
        if now < held:
            return math.exp(held)
        if stamp_ns > self._held_ns:
            self._held, self._held_ns = now, stamp_ns
        return math.exp(now)

    def _now(self, stamp_ns: int) -> float:
        if self._from == self._to:
            return self._from
        done = max(0.0, (stamp_ns - self._since_ns) * 1e-9) / self._takes_s
        return self._from + (self._to - self._from) * min(done, 1.0)


class Growth:
    """White variance that stands for the fast part of a growing error, in a stream of packets.

    An error that grows is not the old one grown larger: along the course, across it and by the
    slow error of a DVL it grows by parts that come and go with the leader's way.

    Parameters
    ----------
    hold_s : float
        The variance gained is that above the least sigma of late, which rises to e in this [s].
    """

    def __init__(self, hold_s: float) -> None:
        self._hold_s = hold_s
        self._least = math.inf
        self._stamp_ns = 0
        self._apart_s = math.inf

    def packed(self) -> list[float]:
        """All that it has heard, for `unpack`."""
        return [self._least, float(self._stamp_ns), self._apart_s]

    def unpack(self, values: list[float]) -> None:
        """Replace what it has heard."""
        self._least, stamp_ns, self._apart_s = values
        self._stamp_ns = int(stamp_ns)

    def at(self, stamp_ns: int, sigma: float) -> float:
        """Variance [m^2] of a fix at a stamp [ns] with this sigma; they may come out of order.

        Of a first-order Markov error with variance q and correlation time T, samples at intervals
        d have the same mean over long times as white ones with q coth(d / 2 T).
        """
        if math.isinf(self._least):
            self._least, self._stamp_ns = sigma, stamp_ns
        elif stamp_ns > self._stamp_ns:
            self._apart_s = (stamp_ns - self._stamp_ns) * 1e-9
            self._least = min(
                sigma, self._least * math.exp(min(self._apart_s / self._hold_s, 50.0))
            )
            self._stamp_ns = stamp_ns
        gained = max(0.0, sigma * sigma - self._least * self._least)
        return FAST_SHARE * gained / math.tanh(0.5 * self._apart_s / FAST_S)


class LeaderError:
    """Splits fixes of one leader.

    Parameters
    ----------
    tau_s : float
        Correlation time of the leader's errors [s]; 0: all of a fix's error is its own.
    keeps : bool
        As of `Link`.
    shaped : bool
        Whether the position error of a leader that dead reckons has the shape of its way (`Way`),
        or is the same in all directions, as up to engine 26.
    """

    def __init__(self, tau_s: float, *, keeps: bool = True, shaped: bool = True) -> None:
        self._on = tau_s > 0.0
        self._start_e: Array | None = None
        self._position, self._heading = Smooth(tau_s), Smooth(tau_s)
        self._growth = Growth(tau_s)
        self._drift = Drift()
        self._link = Link(keeps=keeps)
        self._way = Way(tau_s) if shaped else None
        self._known: OrderedDict[tuple[int, int, int], Split] = OrderedDict()

    @property
    def stated(self) -> bool:
        """Whether any packet stated the leader's own uncertainty."""
        return self._start_e is not None

    def packed(self) -> Array:
        """All that was heard of the leader, finite numbers (44,), for `unpack`; zeros: nothing."""
        if self._start_e is None:
            return np.zeros(HEARD)
        heard = [*self._position.packed(), *self._heading.packed(), *self._growth.packed()]
        heard += [*self._drift.packed(), *self._link.packed()]
        heard += [0.0] * WAY if self._way is None else self._way.packed()
        packed: Array = np.clip([*self._start_e, *heard], -_INFINITE, _INFINITE)
        return packed

    def unpack(self, values: Array) -> None:
        """Replace what was heard of the leader by that of an earlier run."""
        if not values[:3].any():
            return
        known = values.tolist()
        heard = [x if abs(x) < _INFINITE else math.copysign(math.inf, x) for x in known]
        self._start_e = np.array(heard[:3])
        self._position.unpack(heard[3:10])
        self._heading.unpack(heard[10:17])
        self._growth.unpack(heard[17:20])
        self._drift.unpack(heard[20:27])
        self._link.unpack(heard[27:28])
        if self._way is not None:
            self._way.unpack(heard[28:])

    def split(self, fix: Fix) -> Split:
        """Split of the error of a fix; fixes come in the order of reception, some repeatedly.

        The first one that has a leader fixes where it began.
        """
        if not self._on or not (fix.leader_sigma > 0.0 or fix.leader_heading_sigma > 0.0):
            return Split(NO_LEADER, fix.covariance_e)
        key = (fix.validity_ns, fix.order, fix.arrival)
        if key not in self._known:
            self._known[key] = self._split(fix)
            if len(self._known) > KEPT:
                self._known.popitem(last=False)
        return self._known[key]

    def _split(self, fix: Fix) -> Split:
        leader_e = fix.r_e - fix.relative_e
        if self._start_e is None:
            self._start_e = leader_e
        C_e_G = np.asarray(grid.ecef_to_grid(leader_e))
        turn_G = _across(C_e_G @ fix.relative_e)
        drift_G = _across(C_e_G @ (leader_e - self._start_e))
        sigma = self._position.at(fix.validity_ns, fix.leader_sigma)
        heading = self._heading.at(fix.validity_ns, fix.leader_heading_sigma)
        by_heading = heading * math.hypot(drift_G[0], drift_G[1])
        grown = self._drift.grown(sigma)
        linked = self._link.at(by_heading, sigma, grown) if sigma > 0.0 else 0.0
        place = fix.validity_ns, leader_e, C_e_G
        constants_G = self._drift.columns(*place, sigma, heading, self._link.most)
        if self._way is None or not sigma > 0.0:
            columns_G = columns(sigma, heading, turn_G, drift_G, linked)
        else:
            sigmas = sigma, heading
            columns_G = self._way.columns(*place, turn_G, sigmas, linked, self._drift)
        rest_G = C_e_G @ fix.covariance_e @ C_e_G.T
        fast = self._growth.at(fix.validity_ns, sigma)
        level = np.diag([1.0, 1.0, 0.0])
        own_G = 0.5 * (rest_G + rest_G.T) - fix.leader_sigma**2 * level
        left_G = _without_turn(own_G, fix.leader_heading_sigma * turn_G)
        covariance_e = fix.covariance_e if left_G is None else C_e_G.T @ left_G @ C_e_G
        covariance_e = covariance_e + fast * (C_e_G.T @ level @ C_e_G)
        covariance_e = np.ascontiguousarray(0.5 * (covariance_e + covariance_e.T))
        common_G = np.hstack([columns_G, constants_G])
        return Split(np.ascontiguousarray(C_e_G.T @ common_G), covariance_e)


def heard_problem(values: Array) -> str:
    """Sentence about numbers that no `LeaderError.packed` has given; empty for good ones."""
    low, high = _BOUNDS.T
    if values.any() and not ((values >= low) & (values <= high)).all():
        return 'what the state has of the leader makes no sense'
    return ''


def _across(r_G: Array) -> Array:
    """Return up x r: how a turn by one radian about up moves the end of r, grid axes."""
    return np.array([-r_G[1], r_G[0], 0.0])


def columns(
    position: float, heading: float, turn_G: Array, drift_G: Array, linked: float
) -> Array:
    """Columns of `Split` in grid axes, (3, 3) [m].

    Where the leader may have dead reckoned along its heading, the heading's error has turned the
    way since the start, too. That comes on top of the stated variance, which is not split between
    both: the share of the rest would go up and down with each turn of the leader, and a position
    error that follows it shows itself to the filter within one leg.

    Parameters
    ----------
    position, heading : float
        1-sigma of the leader's position per horizontal axis [m], of its heading [rad].
    turn_G, drift_G : (3,) arrays
        Change of the fix per radian of turn: of the array, of the leader's way so far [m].
    linked : float
        Degree, 0 to 1, to which its position is dead reckoned along that heading (`Link`).
    """
    A = np.zeros((3, 3))
    A[0, 0] = A[1, 1] = position
    A[:, 2] = heading * turn_G
    distance = math.hypot(drift_G[0], drift_G[1])
    by_heading = heading * distance
    if by_heading > 0.0 and position > 0.0:
        A[:2, 2] += min(linked * by_heading, position) * drift_G[:2] / distance
    return A


def _without_turn(P: Array, turn: Array) -> Array | None:
    """P less the part of turn turn^T that is in it for sure; None if P is not definite."""
    try:
        L = np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        return None
    whitened = np.linalg.solve(L, turn)
    part = float(whitened @ whitened)
    if part > 0.0:
        P = P - min(ROUNDING, (1.0 - WHITE_SHARE) / part) * np.outer(turn, turn)
    return P
