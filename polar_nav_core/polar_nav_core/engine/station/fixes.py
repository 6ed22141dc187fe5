"""A station's fix before it meets the filter: its date and its noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...identification.polar_fix import PolarFix
from ..events import Array, Fix
from ..station_params import StationParams


def dated(p: StationParams, fix: Fix) -> Fix:
    """Date a fix as `station_validity` says: as its packet does, or by the travel time.

    One whose range is not finite has no travel time; it stays as it is, to be refused.
    """
    if p.station_validity == 'packet' or fix.polar is None or not math.isfinite(fix.polar.range):
        return fix
    c = fix.polar.sound_speed if fix.polar.sound_speed > 0.0 else p.station_sound_speed
    ago_ns = round(p.travel_time(fix.polar.range, c) * 1e9)
    return replace(fix, validity_ns=fix.receive_ns - ago_ns)


def fix_row(p: StationParams, polar: PolarFix) -> Array:
    """Columns of Streams.fixes."""
    row = [*polar.station, polar.station_heading, polar.range, polar.bearing]
    return np.array([*row, *p.noise_of(polar)])
