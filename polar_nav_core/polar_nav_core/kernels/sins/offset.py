"""Offset between two tracks that is bled off in a while, and its course."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, Ints
from ..cache import entry, kernel


class Profile(NamedTuple):
    """Offset that is bled off: its course from a stamp on (`engine.bleed`)."""

    since_ns: Ints  # (1,)
    duration_s: Array  # (1,): 0 for none
    parts: Array  # (4, 3): offset and rate then, accelerations of both halves


def make_profile() -> Profile:
    """Return the profile of no offset."""
    return Profile(np.zeros(1, dtype=np.int64), np.zeros(1), np.zeros((4, 3)))


@entry
@kernel
def offset_at(p: Profile, stamp_ns: int, out: Array) -> None:
    """Fill offset and rate (2, 3) at a stamp [ns], not before that of the profile."""
    t = (stamp_ns - p.since_ns[0]) * 1e-9
    duration_s = p.duration_s[0]
    for k in range(3):
        if t >= duration_s:
            out[0, k] = 0.0
            out[1, k] = 0.0
            continue
        half = 0.5 * duration_s
        a = min(t, half)
        out[0, k] = p.parts[0, k] + a * p.parts[1, k] + 0.5 * a * a * p.parts[2, k]
        out[1, k] = p.parts[1, k] + a * p.parts[2, k]
        if t > half:
            b = t - half
            out[0, k] += b * out[1, k] + 0.5 * b * b * p.parts[3, k]
            out[1, k] += b * p.parts[3, k]
