"""Validity and noise of a station's fix."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...arrays import Array
from ...identification.polar_fix import PolarFix
from ..events import Fix
from ..station_params import StationParams


def dated(p: StationParams, fix: Fix) -> Fix:
    """Fix with its validity by parameter `station_validity`: from the packet or the travel time.

    One whose range is not finite has no travel time; it stays as it is, to be refused.
    """
    if p.station_validity == 'packet' or fix.polar is None or not math.isfinite(fix.polar.range):
        return fix
    c = fix.polar.sound_speed if fix.polar.sound_speed > 0.0 else p.station_sound_speed
    ago_ns = round(p.travel_time(fix.polar.range, c) * 1e9)
    return replace(fix, validity_ns=fix.receive_ns - ago_ns)


def polar_of(fix: Fix) -> PolarFix:
    """Range and bearing of a fix; ValueError where it has none."""
    if fix.polar is None:
        raise ValueError(f'fix {fix.sequence} of {fix.source} has no range and bearing')
    return fix.polar


def fix_row(p: StationParams, polar: PolarFix) -> Array:
    """Row of `Streams.fixes` for a fix."""
    row = [*polar.station, polar.station_heading, polar.range, polar.bearing]
    return np.array([*row, *p.noise_of(polar)])
