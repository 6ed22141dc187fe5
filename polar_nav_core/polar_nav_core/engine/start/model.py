"""What a start works with: stated values, measured headings, candidates, and what comes out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from ..events import InitialState

MOST_HEADING = math.radians(5.0)
"""A heading that is less certain starts no filter: 1-sigma of the linear error model [rad]."""
SAME_AGAIN = 4.0
"""Factor of the sigma that a filter begins with of a heading that it measures itself from then on.

What it knows then is its own first measurement, to 3 %, and the bias of the source stays unknown.
"""


@dataclass(frozen=True)
class Stated:
    """Parts of the initial state that the user stated; None for those that must be found.

    Attributes
    ----------
    latitude, longitude : float or None
        Geodetic [rad]; both or neither.
    height : float or None
        Above the ellipsoid [m].
    heading : float or None
        Clockwise from ``heading_reference`` [rad].
    heading_reference : str
        ``grid`` or ``true`` north.
    roll, pitch : float or None
        [rad]
    v_G : tuple of float or None
        Grid axes [m/s].
    sigma_position, sigma_height, sigma_velocity, sigma_tilt, sigma_heading : float
        1-sigma per axis of what is stated [m, m/s, rad].
    """

    latitude: float | None = None
    longitude: float | None = None
    height: float | None = None
    heading: float | None = None
    heading_reference: str = 'grid'
    roll: float | None = None
    pitch: float | None = None
    v_G: tuple[float, float, float] | None = None
    sigma_position: float = 10.0
    sigma_height: float = 10.0
    sigma_velocity: float = 1.0
    sigma_tilt: float = math.radians(1.0)
    sigma_heading: float = MOST_HEADING


@dataclass(frozen=True)
class Candidate:
    """Heading that one method found.

    Attributes
    ----------
    method : str
        ``stated``, ``measured``, ``gyrocompass`` or ``course``.
    turn : float
        From the level axes of the start to the grid axes, counter-clockwise [rad].
    sigma : float
        1-sigma when it was found [rad].
    stamp_ns : int
        When that was.
    how : str
        Words for people.
    """

    method: str
    turn: float
    sigma: float
    stamp_ns: int
    how: str


@dataclass(frozen=True)
class Aligned:
    """Initial state that was found, and where each part of it is from.

    Attributes
    ----------
    state : InitialState
    stamp_ns : int
        IMU sample at which it holds.
    how : dict of str to str
        By part: place, height, level, heading, velocity.
    """

    state: InitialState
    stamp_ns: int
    how: Mapping[str, str]

    @property
    def sentence(self) -> str:
        """All of it, for people."""
        return '; '.join(f'{part} {how}' for part, how in self.how.items())


class Phase(Enum):
    """Whether an input is missing, or only time and way."""

    WAITING = 'waiting'
    ALIGNING = 'aligning'
    DONE = 'done'


@dataclass(frozen=True)
class Progress:
    """What a start still needs: inputs that are missing, and what is under way."""

    phase: Phase
    missing: tuple[str, ...] = ()
    under_way: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Both, for people."""
        parts = []
        if self.missing:
            parts.append(f'waiting for: {", ".join(self.missing)}')
        if self.under_way:
            parts.append(f'aligning: {", ".join(self.under_way)}')
        return '; '.join(parts)
