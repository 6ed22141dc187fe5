"""Common errors that come out larger than stated: zeros, mountings, scales, clocks."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from .conditions import Condition, Culprit, Level

_NAMES = (
    ('scale of ranges', Culprit.FIXES),
    ('turn of the array', Culprit.FIXES),
    ('clock of the leader', Culprit.FIXES),
    ('offset of fixes to grid east', Culprit.FIXES),
    ('offset of fixes to grid north', Culprit.FIXES),
    ('offset of fixes upwards', Culprit.FIXES),
    ('yaw of the DVL', Culprit.DVL | Culprit.HEADING),
    ('pitch of the DVL', Culprit.DVL),
    ('lever arm of the DVL along x', Culprit.DVL),
    ('lever arm of the DVL along y', Culprit.DVL),
    ('latency of the DVL', Culprit.DVL),
    ('zero of depth', Culprit.DEPTH),
    ('turn of the way of the leader', Culprit.FIXES),
    ('scale of the way of the leader', Culprit.FIXES),
    ('start of the leader to grid east', Culprit.FIXES),
    ('start of the leader to grid north', Culprit.FIXES),
)
"""By column of the sensitivity (kernels.sins.consider)."""
KNOWN = 0.2
"""Share of a common error's variance that innovations show before it is judged."""
_BEYOND = 20.0
"""Chi-square (1) of what comes out of it that is a WARN; four times that is an ERROR.

b / sqrt(E) of a world as stated is a stationary Gaussian process of ln E with the correlation
exp(-|d ln E| / 2), so that it exceeds t = sqrt(20) on the way from E = 0.2 to 1 with a probability
of ln(5) t phi(t) + 2 Q(t) = 1.4e-4; sixteen in 40 runs of half an hour: 0.09 in 20 h.
"""
_SEVERE = 4.0
_ALIKE = 0.8
"""Share of the largest chi-square from which on another error explains the same."""


def beyond_stated(shared: Array | None) -> list[Condition]:
    """The condition that innovations show a common error beyond its stated sigma, if they do.

    Parameters
    ----------
    shared : (COLUMNS + 1, COLUMNS) array or None
        State.shared: estimates per stated sigma in row 0, their covariance below.
    """
    if shared is None:
        return []
    known = np.diagonal(shared[1:])
    chi_square = (known > KNOWN) * shared[0] ** 2 / np.maximum(known, KNOWN)
    worst = max(chi_square.tolist())
    if not worst > _BEYOND:
        return []
    names, culprit = [], Culprit.NONE
    for column in np.argsort(-chi_square):
        if chi_square[column] >= _ALIKE * worst:
            name, whose = _NAMES[column]
            names.append(name)
            culprit |= whose
    level = Level.ERROR if worst > _SEVERE * _BEYOND else Level.WARN
    sentence = (
        f'{" or ".join(names)}: {np.sqrt(worst):.1f} times as large as its stated sigma allows'
    )
    return [Condition('common error', level, culprit, sentence)]
