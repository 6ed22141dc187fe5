"""A stated start beside the navigation that it replaces: what the two contradict one another by.

Whoever states where the vehicle is has a reason, and is obeyed. But a navigation that was sure of
another place is evidence, and dropped with it: so that is said until fixes show which was right.
Where both agree it goes on to be evidence while the first fixes are used: one that leads the start
away from both (a leader whose position froze) fits the sigma of the start, and would not be told
of before it was followed by others that are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..attitude import euler_from_matrix
from ..earth import ecef_from_geodetic
from ..error_model import X
from ..grid import ecef_to_grid
from .driver import Driver
from .events import InitialState
from .health.conditions import Condition, Culprit, Level
from .saved import SavedState
from .sins.fusion import Fusion

_BEYOND = 5.0
"""Sigmas of both together from which on they contradict one another."""
_AFTER_S = 60.0
"""For so long it is an error: nothing can have shown yet which of the two is right."""
_SHOWN_S = 300.0
"""For so long a heading is in doubt: fixes pull positions back long before they show the cause."""
SETTLED = 10
"""Fixes used since a start that settle it."""
_WAY = 0.02
"""Of the way since, by which dead reckoning may be off: a turn of 1 deg."""


@dataclass(frozen=True)
class Replaced:
    """A contradiction of a stated start [m], [rad], its sigmas, and when it was stated [ns].

    ``by_fixes``: of what the fixes used since have made of the start.
    """

    stamp_ns: int
    metres: float
    turn: float
    sigmas: float
    by_fixes: bool = False

    def heading_doubt(self, stamp_ns: int) -> float:
        """By how much the heading may be off at a stamp, for all that was stated [rad]."""
        return self.turn if (stamp_ns - self.stamp_ns) * 1e-9 < _SHOWN_S else 0.0

    def conditions(self, stamp_ns: int, fused: int) -> list[Condition]:
        """The condition at a stamp, until fixes have settled it; ``fused`` since the start."""
        if fused >= SETTLED:
            return []
        early = (stamp_ns - self.stamp_ns) * 1e-9 < _AFTER_S
        degrees = abs(math.degrees(self.turn))
        what = f'the stated start lies {self.metres:.0f} m and {degrees:.0f} deg'
        if self.by_fixes:
            what = f'the first fixes have led the stated start {self.metres:.0f} m'
        sentence = (
            f'{what} ({self.sigmas:.0f} sigma) from the navigation that it replaced: one of the '
            f'two is wrong ({fused} of {SETTLED} fixes used that settle it)'
        )
        level = Level.ERROR if early else Level.WARN
        return [Condition('start contradicted', level, Culprit.UNEXPLAINED, sentence)]


class Before:
    """The navigation that a stated start replaced, beside the one that began there.

    Parameters
    ----------
    old : Fusion
        As it was last.
    start : InitialState
        Stated, of the point that is navigated.
    stamp_ns : int
        When [ns].
    """

    def __init__(self, old: Fusion, start: InitialState, stamp_ns: int) -> None:
        r_e, psi = _now(old, stamp_ns)
        P, C_e_G = old.filter.published_P, np.asarray(ecef_to_grid(r_e))
        self._stamp_ns = self._since_ns = stamp_ns
        self._off_G, self._turn = _beside(start, r_e, psi)
        self._P_G: Array = C_e_G @ P[X.dr_e, X.dr_e] @ C_e_G.T
        self._heading_variance = float(P[2, 2])

    def stated_again(
        self, now: Driver | None, stated: InitialState | None, start: InitialState, stamp_ns: int
    ) -> None:
        """Go on beside another start, from the navigation now, or that stated without one."""
        if isinstance(now, Fusion):
            here = _now(now, stamp_ns)
            self._P_G = self._P_G + self._way(now)
            self._since_ns = stamp_ns
        elif stated is not None:
            here = _position(stated), 0.5 * math.pi - stated.grid_heading
        else:
            return
        off_G, turn = _beside(start, *here)
        self._off_G, self._turn = self._off_G + off_G, self._turn + turn

    def _way(self, now: Fusion) -> Array:
        """Covariance (3, 3) of what dead reckoning since the newest start may be off by [m^2]."""
        since_s = (now.stamp_ns - self._since_ns) * 1e-9
        return np.eye(3) * (_WAY * float(np.linalg.norm(now.filter.state.v_G)) * since_s) ** 2

    def contradicted(self, start: InitialState) -> Replaced | None:
        """What the start contradicts it by; None where they agree."""
        horizontal, vertical = start.sigma_position_horizontal, start.sigma_position_vertical
        stated = np.diag([horizontal, horizontal, vertical]) ** 2
        far = _sigmas(self._off_G, self._P_G + stated)
        turned = abs(self._turn) / math.sqrt(self._heading_variance + start.sigma_heading**2)
        if max(far, turned) <= _BEYOND:
            return None
        metres = float(np.linalg.norm(self._off_G))
        return Replaced(self._stamp_ns, metres, self._turn, max(far, turned))

    def led_away(self, now: Fusion, moved_e: Array) -> Replaced | None:
        """What a fix that was used contradicts it by; None where they agree.

        ``moved_e`` (3,) is by how much the fix has moved the position, ECEF [m].
        """
        f = now.filter
        C_e_G = f.frames.C_e_G
        self._off_G = self._off_G + C_e_G @ moved_e
        P_G = C_e_G @ f.published_P[X.dr_e, X.dr_e] @ C_e_G.T
        far = _sigmas(self._off_G, self._P_G + P_G + self._way(now))
        if far <= _BEYOND:
            return None
        metres = float(np.linalg.norm(self._off_G))
        return Replaced(self._stamp_ns, metres, 0.0, far, by_fixes=True)


def is_stated(start: InitialState | None) -> bool:
    """Whether somebody stated a start: a saved state is no statement."""
    return start is not None and not isinstance(start, SavedState)


def before_start(
    old: Driver | None, start: InitialState | None, stamp_ns: int, longest_s: float
) -> Before | None:
    """The navigation that a stated start replaces; None where it says nothing of the start.

    Parameters
    ----------
    old : Driver or None
        Strapdown navigation until now; of others nothing is said.
    start : InitialState or None
        Stated, of the point that is navigated.
    stamp_ns : int
        When [ns].
    longest_s : float
        A navigation that is older does not know any more where the vehicle is [s].
    """
    if not isinstance(old, Fusion) or start is None or not is_stated(start):
        return None
    return Before(old, start, stamp_ns) if stamp_ns - old.stamp_ns <= longest_s * 1e9 else None


def _now(old: Fusion, stamp_ns: int) -> tuple[Array, float]:
    """Position (3,), ECEF [m], of a navigation moved on to a stamp; its heading from grid east."""
    f = old.filter
    moved_e = f.frames.velocity_e * ((stamp_ns - old.stamp_ns) * 1e-9)
    return f.state.r_e + moved_e, float(euler_from_matrix(f.state.C_b_G)[0])


def _position(start: InitialState) -> Array:
    return np.asarray(ecef_from_geodetic(start.latitude, start.longitude, start.height))


def _beside(start: InitialState, r_e: Array, psi: float) -> tuple[Array, float]:
    """Offset (3,), grid axes [m], and turn [rad] of a start from a position and heading."""
    turn = math.remainder(0.5 * math.pi - start.grid_heading - psi, 2.0 * math.pi)
    return np.asarray(ecef_to_grid(r_e)) @ (_position(start) - r_e), turn


def _sigmas(off: Array, S: Array) -> float:
    """Length of an offset in sigmas of its covariance."""
    return math.sqrt(max(0.0, float(off @ np.linalg.solve(S, off))))
