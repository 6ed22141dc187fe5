"""Faults of an AHRS that a filter hears: its heading is off, from the start or for a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polar_nav_sim.sensors.compass import CompassErrors

from .. import compass
from ..world import World
from . import worlds
from .faults import Fault

BIAS_SIGMA_DEG = 3.0
"""Of the AHRS without a fault, drawn and stated."""


@dataclass(frozen=True, kw_only=True)
class HeadingOff(Fault):
    """A vehicle with an AHRS whose heading is off by ``error_deg``, for ``length_s``."""

    error_deg: float
    length_s: float = math.inf
    reference: str = 'true'

    def applied(self, world: World, scale: float) -> World:
        """World with the AHRS, and ``scale`` times the error."""
        world = compass.with_headings(world, self.reference, CompassErrors(), BIAS_SIGMA_DEG)
        t = worlds.seconds(world, world.inputs.heading_stamps_ns)
        on = (t >= self.start_s) & (t < self.start_s + self.length_s)
        return compass.turn_headings(
            world, scale * math.radians(self.error_deg) * on.astype(np.float64)
        )


STATED = compass.stated('true', BIAS_SIGMA_DEG)
"""What every filter of such a row knows of the AHRS."""
