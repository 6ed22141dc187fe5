"""A stated start beside the navigation that it replaces: what the two contradict one another by.

Whoever states where the vehicle is has a reason, and is obeyed. But a navigation that was sure of
another place is evidence, and dropped with it: so that is said until fixes show which was right.
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


@dataclass(frozen=True)
class Replaced:
    """A contradiction of a stated start [m], [rad], its sigmas, and when it was stated [ns]."""

    stamp_ns: int
    metres: float
    turn: float
    sigmas: float

    def heading_doubt(self, stamp_ns: int) -> float:
        """By how much the heading may be off at a stamp, for all that was stated [rad]."""
        return self.turn if (stamp_ns - self.stamp_ns) * 1e-9 < _SHOWN_S else 0.0

    def conditions(self, stamp_ns: int, fused: int) -> list[Condition]:
        """The condition at a stamp, until fixes have settled it; ``fused`` since the start."""
        if fused >= SETTLED:
            return []
        early = (stamp_ns - self.stamp_ns) * 1e-9 < _AFTER_S
        degrees = abs(math.degrees(self.turn))
        sentence = (
            f'the stated start lies {self.metres:.0f} m and {degrees:.0f} deg '
            f'({self.sigmas:.0f} sigma) from the navigation that it replaced: one of the two is '
            f'wrong ({fused} of {SETTLED} fixes used that settle it)'
        )
        level = Level.ERROR if early else Level.WARN
        return [Condition('start contradicted', level, Culprit.UNEXPLAINED, sentence)]


def replaced(
    old: Driver | None, start: InitialState | None, stamp_ns: int, longest_s: float
) -> Replaced | None:
    """What a start contradicts the navigation by that it replaces; None where they agree.

    Parameters
    ----------
    old : Driver or None
        Strapdown navigation until now; of others nothing is said.
    start : InitialState or None
        Stated, of the point that is navigated. A saved state is no statement.
    stamp_ns : int
        When [ns].
    longest_s : float
        A navigation that is older does not know any more where the vehicle is [s].
    """
    if not isinstance(old, Fusion) or start is None or isinstance(start, SavedState):
        return None
    since_s = (stamp_ns - old.stamp_ns) * 1e-9
    if since_s > longest_s:
        return None
    state, P = old.filter.state, old.filter.published_P
    C_e_G = np.asarray(ecef_to_grid(state.r_e))
    r_e = np.asarray(ecef_from_geodetic(start.latitude, start.longitude, start.height))
    off_G = C_e_G @ (r_e - state.r_e) - since_s * state.v_G
    horizontal, vertical = start.sigma_position_horizontal, start.sigma_position_vertical
    stated = np.diag([horizontal, horizontal, vertical]) ** 2
    far = _sigmas(off_G, C_e_G @ P[X.dr_e, X.dr_e] @ C_e_G.T + stated)
    psi = float(euler_from_matrix(state.C_b_G)[0])
    turn = math.remainder(0.5 * math.pi - start.grid_heading - psi, 2.0 * math.pi)
    turned = abs(turn) / math.sqrt(float(P[2, 2]) + start.sigma_heading**2)
    if max(far, turned) <= _BEYOND:
        return None
    return Replaced(stamp_ns, float(np.linalg.norm(off_G)), turn, max(far, turned))


def _sigmas(off: Array, S: Array) -> float:
    """Length of an offset in sigmas of its covariance."""
    return math.sqrt(max(0.0, float(off @ np.linalg.solve(S, off))))
