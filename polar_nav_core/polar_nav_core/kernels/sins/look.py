"""What the watchdog asks of a state: where it is, and how well that is known."""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, routine
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from . import state as fs
from .consider import add_common, add_conflict
from .settings import Settings
from .state import State
from .update import DR, N


@entry
@routine
def look(s: State, c: Settings, total: Array, C_e_G: Array, P_horizontal: Array) -> float:
    """Height above the ellipsoid [m]; fills the grid axes and the published covariance in them.

    Parameters
    ----------
    s : State
    c : Settings
    total : (24, 24) scratch
    C_e_G : (3, 3) array, out
        ECEF to grid.
    P_horizontal : (2, 2) array, out
        Of the position, with common errors and the conflict with refused fixes [m^2].
    """
    u_x, u_y, u_z, height = up_and_height(s.r_e[0], s.r_e[1], s.r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    for i in range(N):
        for j in range(s.P.shape[1]):
            total[i, j] = s.P[i, j]
    if s.counters[fs.CONSIDERS] == 1:
        add_common(total, s.sensitivity, c.common)
    add_conflict(total, s.conflict)
    for a in range(2):
        for b in range(2):
            P_horizontal[a, b] = 0.0
            for i in range(3):
                for j in range(3):
                    P_horizontal[a, b] += C_e_G[a, i] * total[DR + i, DR + j] * C_e_G[b, j]
    return height
