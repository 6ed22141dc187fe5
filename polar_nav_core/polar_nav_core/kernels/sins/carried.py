"""Corrections of the velocity that show no heading: its error goes along with them.

What no ping tells from rest is a turn about the vertical of attitude and velocity together,
dv = V x u phi. Which direction of the error states that is depends on V. A covariance that was
made with one velocity, beside rows with another, has pings tell what they cannot: each correction
of the velocity, by noise alone, seems to show the heading. So the heading's rows have the
velocity that the covariance was made with, and where a ping takes d off the velocity, or a
heading is turned and V with it, dv is less by d x u phi from the next transition on. Tilts are
shown by gravity, and have rows of their own (turn; docs/derivations/measurements.md, 1). A DVL
that is turned in its mount does to the velocity what a turned vehicle does, and goes along, too.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .consider import DVL_YAW
from .update import DV, NAV, PHI

UP = PHI + 2


@kernel
def note_turn(carried: Array, v_G: Array, x: Array) -> None:
    """Add what a correction x (24,) turns off the velocity to ``carried`` (2,), horizontal [m/s].

    What else a fix takes off it may be known by itself, and not in axes of the vehicle: that is
    none of the heading's. ``v_G`` (3,) is the velocity before [m/s].
    """
    carried[0] += v_G[1] * x[UP]
    carried[1] -= v_G[0] * x[UP]


@kernel
def note_ping(carried: Array, v_G: Array, x: Array) -> None:
    """Add what a ping takes off the velocity beyond what `note_turn` adds of its correction."""
    carried[0] += x[DV] - v_G[1] * x[UP]
    carried[1] += x[DV + 1] + v_G[0] * x[UP]


@kernel
def carried_heading_rows(H: Array, v_G: Array, carried: Array) -> None:
    """Write the velocity that the covariance was made with into the heading's rows of a ping.

    Parameters
    ----------
    H : (3, 24) array, in place
    v_G : (3,) array
        Estimated velocity, grid axes [m/s].
    carried : (2,) array
        What was taken off it since the last transition [m/s].
    """
    H[0, UP] = -(v_G[1] + carried[1])
    H[1, UP] = v_G[0] + carried[0]


@kernel
def carry_yaw(S: Array, C_b_G: Array, carried: Array) -> None:
    """Let what a turned DVL does to the velocity go along, before `carry_heading`.

    Its innovation J(V) = V x b_z (`consider.dvl_common`) is as linear in V as the rows of the
    heading: where dv has answered it with -J(V), it answers that of V less ``carried`` then.

    Parameters
    ----------
    S : (24, COLUMNS) array, in place
        Sensitivity to common errors.
    C_b_G : (3, 3) array
        Attitude; its last column is the axis b_z that the DVL turns about.
    carried : (2,) array
        What was taken off the velocity since the last transition [m/s].
    """
    x, y = carried[0], carried[1]
    S[DV, DVL_YAW] += y * C_b_G[2, 2]
    S[DV + 1, DVL_YAW] -= x * C_b_G[2, 2]
    S[DV + 2, DVL_YAW] += x * C_b_G[1, 2] - y * C_b_G[0, 2]


@kernel
def carry_heading(Phi: Array, inverse: Array, carried: Array) -> None:
    """Begin a transition with dv - carried x u phi, in place; ``carried`` is zero then.

    Phi (24, 24) and inverse (10, 16) are as `transition.fill_transition` leaves them.
    """
    x, y = carried[0], carried[1]
    if x == 0.0 and y == 0.0:
        return
    for i in range(NAV):
        Phi[i, UP] -= Phi[i, DV] * y - Phi[i, DV + 1] * x
    for j in range(inverse.shape[1]):
        inverse[DV, j] += y * inverse[UP, j]
        inverse[DV + 1, j] -= x * inverse[UP, j]
    carried[0] = carried[1] = 0.0
