"""Heading under way: fixes against what DVL and gyros dead-reckoned between them.

Nothing is assumed of the direction in which the vehicle moves: without a DVL there is no heading
from fixes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array

Complex = NDArray[np.complex128]

_OUTLIER = 4.0
_FEWEST_WITH_OUTLIERS = 4


class Passed(NamedTuple):
    """A fix, and the dead-reckoned place of its antenna at the same time.

    Attributes
    ----------
    stamp_ns : int
        Time of validity.
    p_G, q_L : (2,) arrays
        Horizontal, grid axes and level axes [m].
    sigma : float
        1-sigma of the fix, per horizontal axis [m].
    """

    stamp_ns: int
    p_G: Array
    q_L: Array
    sigma: float


class Course(NamedTuple):
    """Turn from level to grid axes, counter-clockwise [rad], with what it rests on.

    Attributes
    ----------
    turn, sigma : float
        [rad]; infinite sigma where nothing can be seen.
    baseline, needed : float
        Longest way between two fixes, and that for the limit of sigma [m].
    seconds : float
        From the first fix to the last.
    refusal : str
        Sentence on fixes that contradict the dead reckoning; else empty.
    """

    turn: float
    sigma: float
    baseline: float
    needed: float
    seconds: float
    refusal: str = ''


def course(
    passed: Sequence[Passed], most: float, misalignment: float, slow: float, drift: float
) -> Course | None:
    """Least-squares turn of at least two fixes; None of fewer.

    Parameters
    ----------
    passed : sequence of Passed
    most : float
        Largest useful sigma [rad].
    misalignment : float
        1-sigma of the DVL's yaw on the vehicle [rad].
    slow : float
        1-sigma of a slow error of its velocity: as installed, or a current [m/s].
    drift : float
        1-sigma of the gyros' bias [rad/s].
    """
    rows = list(passed)
    while len(rows) > 1:
        found = _fit(rows, most, misalignment, slow, drift)
        worst = _worst(rows, found, slow)
        if worst is None:
            return found
        if len(rows) < _FEWEST_WITH_OUTLIERS:
            return found._replace(
                sigma=math.inf,
                refusal='fixes and DVL disagree on the way between them by more than their sigmas',
            )
        del rows[worst]
    return None


def _fit(
    rows: Sequence[Passed], most: float, misalignment: float, slow: float, drift: float
) -> Course:
    p, q, w = _centred(rows)
    turn = float(np.angle(np.sum(w * p * np.conj(q))))
    baseline = float(np.abs(q[:, None] - q[None, :]).max())
    seconds = (rows[-1].stamp_ns - rows[0].stamp_ns) * 1e-9
    # As of the two fixes farthest apart: errors of fixes are seldom white.
    across = math.sqrt(2.0) * max(r.sigma for r in rows)
    constant = math.hypot(misalignment, 0.5 * drift * seconds)
    way = math.hypot(across, slow * seconds)
    left = math.sqrt(max(most**2 - constant**2, 0.0))
    needed = way / left if left > 0.0 else math.inf
    sigma = math.hypot(constant, way / baseline) if baseline > 0.0 else math.inf
    return Course(turn, sigma, baseline, needed, seconds)


def _worst(rows: Sequence[Passed], found: Course, slow: float) -> int | None:
    """Index of the fix farthest off the fit, if it is off by more than sigmas explain."""
    p, q, _ = _centred(rows)
    off = np.abs(p - q * np.exp(1j * found.turn))
    sigmas = np.hypot([r.sigma for r in rows], slow * found.seconds)
    ratio = off / sigmas
    k = int(np.argmax(ratio))
    return k if ratio[k] > _OUTLIER else None


def _centred(rows: Sequence[Passed]) -> tuple[Complex, Complex, Array]:
    """Fixes and dead reckoning as complex numbers about their weighted means, and weights."""
    p = np.array([complex(*r.p_G) for r in rows])
    q = np.array([complex(*r.q_L) for r in rows])
    w = np.array([r.sigma**-2 for r in rows])
    w = w / w.sum()
    return p - np.sum(w * p), q - np.sum(w * q), w
