"""What the watchdog asks of a state: where it is, and how well that is known."""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, routine
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G
from .consider import add_common, add_conflict
from .update import DR, N


@entry
@routine
def look(
    r_e: Array,
    P: Array,
    sensitivity: Array,
    considers: int,
    common: Array,
    conflict: Array,
    total: Array,
    columns: Array,
    C_e_G: Array,
    P_horizontal: Array,
) -> float:
    """Height above the ellipsoid [m]; fills the grid axes and the published covariance in them.

    Parameters
    ----------
    r_e, P, sensitivity, conflict : arrays
        Of the State.
    considers : int
        State.counters[CONSIDERS].
    common : (COLUMNS,) array
        Of the Settings.
    total, columns : (24, 24), (COLUMNS, 24) or more, scratch
    C_e_G : (3, 3) array, out
        ECEF to grid.
    P_horizontal : (2, 2) array, out
        Of the position, with common errors and the conflict with refused fixes [m^2].
    """
    u_x, u_y, u_z, height = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(u_x, u_y, u_z, C_e_G)
    for i in range(N):
        for j in range(P.shape[1]):
            total[i, j] = P[i, j]
    if considers == 1:
        add_common(total, sensitivity, common, columns)
    add_conflict(total, conflict)
    for a in range(2):
        for b in range(2):
            P_horizontal[a, b] = 0.0
            for i in range(3):
                for j in range(3):
                    P_horizontal[a, b] += C_e_G[a, i] * total[DR + i, DR + j] * C_e_G[b, j]
    return height
