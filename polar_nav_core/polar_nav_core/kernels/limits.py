"""Limits of what can be, for compiled code and for the engine."""

from __future__ import annotations

from typing import Final

EARTH: Final = (6.3e6, 6.5e6)
"""Least and largest distance from the Earth's centre of a vehicle or fix [m]."""

AXIS: Final = 0.1
"""Least distance from the Earth's y axis [m]: on it (0 N, 90 E or W) there is no grid north."""
