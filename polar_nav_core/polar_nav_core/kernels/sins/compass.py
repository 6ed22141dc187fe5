"""Where a measured heading counts from: reference direction, magnetic field, their uncertainty.

The magnetic field is a vector at the place where the filter began and its gradient there, so that
nothing is singular at a geographic pole (docs/derivations/heading.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...arrays import Array
from ..cache import entry, kernel
from ..frames.earth import up_and_height
from ..frames.grid import fill_C_e_G

# Heading.reference: index in engine.heading_params.REFERENCES.
NONE = 0
TRUE = 1
MAGNETIC = 2
GRID = 3
ARBITRARY = 4

# Places in Heading.noise.
WHITE = 0  # variance of a heading [rad^2]
MARKOV_VARIANCE = 1  # steady one of its coloured part [rad^2]
MARKOV_TAU = 2  # [s]
TILT = 3  # variance of the AHRS' roll and pitch [rad^2]
TURN = 4  # tilt error per v x yaw rate / g
STATED = 5  # variance of the declination that stands in the prior of the bias already [rad^2]
LEAST_FIELD = 6  # horizontal field below which no heading is used [nT]
DECLINATION = 7  # that the driver has added [rad]
START = 8  # sigma of the bias at the start [rad]
NOISE = 9

# Rows of Heading.field.
PLACE = 0  # ECEF [m]
FIELD = 1  # ECEF [nT]
GRADIENT = 2  # three rows, ECEF [nT/m]
FIELD_ROWS = 5

DECLINATION_FLOOR = math.radians(0.26)
DECLINATION_SCALE = math.radians(5417.0)
"""Error of WMM2025's declination: hypot(0.26 deg, 5417 deg nT / H), its own model."""
DISTURBED = 300.0
"""Of the field, what no main field model has: daily variation and the crust, ours [nT]."""
LEAST_COS_LATITUDE = 1e-3
"""Nearer to a pole (6 km) a true heading is not used: its reference turns with the position."""
AWAY = 100.0
"""Distance of the differences that give the slope of a reference with the position [m]."""


class Heading(NamedTuple):
    """Constants of a measured heading."""

    on: bool
    reference: int
    tilts: bool  # roll and pitch of the AHRS are used, too
    period_ns: int  # at most one is used in this time
    noise: Array  # (NOISE,)
    field: Array  # (FIELD_ROWS, 3)


@kernel
def reference_at(h: Heading, r_e: Array, C_e_G: Array) -> tuple[float, float, float]:
    """Direction that headings count from, grid axes: east, north, up (of the field: nT).

    Parameters
    ----------
    h : Heading
    r_e : (3,) array
        ECEF [m].
    C_e_G : (3, 3) array, out
        Grid frame there.
    """
    x, y, z, _ = up_and_height(r_e[0], r_e[1], r_e[2])
    fill_C_e_G(x, y, z, C_e_G)
    if h.reference == TRUE:
        return C_e_G[0, 2], C_e_G[1, 2], C_e_G[2, 2]
    if h.reference != MAGNETIC:
        return 0.0, 1.0, 0.0
    east = north = up = 0.0
    for k in range(3):
        b = h.field[FIELD, k]
        for n in range(3):
            b += h.field[GRADIENT + k, n] * (r_e[n] - h.field[PLACE, n])
        east += C_e_G[0, k] * b
        north += C_e_G[1, k] * b
        up += C_e_G[2, k] * b
    return east, north, up


@kernel
def is_weak(h: Heading, east: float, north: float) -> bool:
    """Whether the reference has too small a horizontal part to count from."""
    horizontal = math.sqrt(east * east + north * north)
    if h.reference == TRUE:
        return horizontal < LEAST_COS_LATITUDE
    return bool(h.reference == MAGNETIC and horizontal < h.noise[LEAST_FIELD])


@entry
@kernel
def declination_variance(horizontal: float) -> float:
    """Variance of a declination by WMM2025 where the field has a horizontal part [nT], [rad^2]."""
    model = DECLINATION_SCALE / horizontal
    local = DISTURBED / horizontal
    return DECLINATION_FLOOR * DECLINATION_FLOOR + model * model + local * local


@kernel
def wrapped(angle: float) -> float:
    """The angle brought into [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
