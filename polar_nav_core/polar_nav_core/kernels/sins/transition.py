"""Transition of the error state over a filter step, and its inverse.

Derivations: docs/derivations/error_model.md, late_fixes.md (2).
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import entry, kernel
from .error_model import fill_system_matrix
from .update import COUPLED, MARKOV, NAV, USBL, N

INVERSE = (NAV + 1, COUPLED + 1)
"""Shape of what is kept of an inverted transition: see `fill_transition`."""


@entry
@kernel
def fill_transition(
    Phi: Array,
    inverse: Array,
    F15: Array,
    r_e: Array,
    v_G: Array,
    C_b_G: Array,
    f_b: Array,
    dt: float,
    tau_markov: float,
    tau_usbl: float,
) -> None:
    """Phi = I + F dt + (F dt)^2/2 for one filter step; exact exponentials for the Markov blocks.

    Its inverse in the first nine rows is I - F dt + (F dt)^2/2 but for (F dt)^4/4, which is less
    than what Phi leaves out (docs/derivations/late_fixes.md, 2).

    Parameters
    ----------
    Phi : (24, 24) array, out
    inverse : (10, 16) array, out
        Rows 0..8: columns 0..14 of the inverse; row 9: the inverses of the diagonal from MARKOV
        on. The last column is zero.
    F15 : (15, 15) scratch
    r_e, v_G : (3,) arrays
        Position, ECEF [m]; velocity, grid axes [m/s].
    C_b_G, f_b : (3, 3), (3,) arrays
        Means of attitude and specific force [m/s^2] over the step.
    dt : step [s]
    tau_markov, tau_usbl : correlation times [s]; 0 for a constant
    """
    fill_system_matrix(F15, r_e, v_G, C_b_G, f_b)
    coupled = F15.shape[1]
    for i in range(NAV):  # F dt stands in the rows below for a while: as wide as the result
        for j in range(coupled):
            Phi[NAV + i, j] = F15[i, j] * dt
        for j in range(COUPLED, N):
            Phi[NAV + i, j] = 0.0
    for i in range(NAV):
        for j in range(N):  # rows of F below nine are zero: NAV products
            square = (
                Phi[9 + i, 0] * Phi[9, j] + Phi[9 + i, 1] * Phi[10, j] + Phi[9 + i, 2] * Phi[11, j]
                + Phi[9 + i, 3] * Phi[12, j] + Phi[9 + i, 4] * Phi[13, j]
                + Phi[9 + i, 5] * Phi[14, j] + Phi[9 + i, 6] * Phi[15, j]
                + Phi[9 + i, 7] * Phi[16, j] + Phi[9 + i, 8] * Phi[17, j]
            )  # fmt: skip
            Phi[i, j] = Phi[9 + i, j] + 0.5 * square
        for j in range(coupled):
            inverse[i, j] = Phi[i, j] - 2.0 * Phi[9 + i, j]
        Phi[i, i] += 1.0
        inverse[i, i] += 1.0
    for i in range(NAV, N):
        for j in range(N):
            Phi[i, j] = 0.0
        Phi[i, i] = 1.0
    for k in range(N - MARKOV):
        inverse[NAV, k] = 1.0
    if tau_markov > 0.0:
        decay = math.exp(-dt / tau_markov)
        for k in range(3):
            Phi[MARKOV + k, MARKOV + k] = decay
            inverse[NAV, k] = 1.0 / decay
    if tau_usbl > 0.0:
        decay = math.exp(-dt / tau_usbl)
        for k in range(3):
            Phi[USBL + k, USBL + k] = decay
            inverse[NAV, USBL - MARKOV + k] = 1.0 / decay
