"""Compilation of the nodes' kernels at their start, so that no first message waits for it."""

from __future__ import annotations

import numpy as np

from polar_nav_core import earth, grid


def warm_up() -> None:
    """Call every compiled function of the core that the simulation's nodes use."""
    r_e = np.array([0.0, 0.0, earth.SEMI_MINOR])
    grid.ecef_to_grid(r_e)
    grid.earth_rate(r_e)
    earth.gravity(r_e)
    earth.up(r_e)
