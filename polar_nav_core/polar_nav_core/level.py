"""Fixes without a height: two numbers, though all three rows of a position are kept."""

from __future__ import annotations

LEVEL_SIGMA = 1e4
"""1-sigma of the height of a 2-D fix [m]: it weighs nothing against any depth sensor."""
NO_HEIGHT = (0.05 * LEVEL_SIGMA) ** 2
"""Vertical variance above which a fix says nothing of the height [m^2]: two numbers are known
then, and NIS has two degrees of freedom. Below 1e6, which some state for "unknown". Who has the
fix asks `engine.level`, who has an outcome or a receipt reads its degrees of freedom."""
