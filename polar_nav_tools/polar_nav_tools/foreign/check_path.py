"""Findings on how far the reference went, against how far by the DVL."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.sensors import DvlRows

from ..bags.finding import Finding, Severity
from .findings import finding

_FACTOR = 3.0
"""Between both lengths; noise of positions that come often makes their path longer."""
_LEAST_M = 20.0
"""Shorter paths say nothing, for the same reason [m]."""
_FEWEST = 10
_STEP_S = 10.0
"""Legs of the reference are at least so long that its noise is small against them."""
_LONGEST_GAP_S = 10.0
"""Nothing is known of the way between pings further apart."""
_DEGREES = 180.0 / np.pi


def check_path(truth: PositionRows, dvl: DvlRows) -> Iterator[Finding]:
    """Compare the path of a reference with that of a DVL while both were there.

    Both by stamp. Radians taken for degrees make a path 57 times too short, millimetres taken for
    metres a speed a thousand times too large.
    """
    valid = dvl.valid
    if valid.sum() < _FEWEST or len(truth.stamps_ns) < _FEWEST:
        return
    pings_ns, speed = dvl.stamps_ns[valid], np.linalg.norm(dvl.velocity[valid], axis=1)
    steps_s = np.diff(pings_ns) * 1e-9
    steps_s[steps_s > _LONGEST_GAP_S] = 0.0
    way = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * steps_s)]
    known = (truth.stamps_ns >= pings_ns[0]) & (truth.stamps_ns <= pings_ns[-1])
    stamps_ns, r_e = truth.stamps_ns[known], truth.r_e[known]
    if len(stamps_ns) < _FEWEST:
        return
    leg = ((stamps_ns - stamps_ns[0]) * (1e-9 / _STEP_S)).astype(np.int64)
    ends = np.flatnonzero(np.r_[True, np.diff(leg) > 0])
    if len(ends) < 2:
        return
    by_truth = float(np.linalg.norm(np.diff(r_e[ends], axis=0), axis=1).sum())
    t = (pings_ns - pings_ns[0]) * 1e-9
    at = (stamps_ns[ends] - pings_ns[0]) * 1e-9
    by_dvl = float(np.diff(np.interp(at, t, way)).sum())
    if max(by_truth, by_dvl) < _LEAST_M:
        return
    ratio = by_dvl / max(by_truth, 1e-9)
    if 1.0 / _FACTOR < ratio < _FACTOR:
        return
    radians = 0.8 * _DEGREES < ratio < 1.25 * _DEGREES
    why = '; radians taken for degrees make it 57 times shorter: `angle_unit: rad`?'
    yield finding(
        'path_length',
        Severity.SEVERE,
        truth.topic,
        int(stamps_ns[0]),
        len(stamps_ns),
        ratio,
        f'its path is {by_truth:.4g} m long where that by the DVL is {by_dvl:.4g} m, '
        f'{ratio:.3g} times as long (limits 1/{_FACTOR:g} and {_FACTOR:g})'
        f'{why if radians else ": see the units and the frame of both"}',
    )
