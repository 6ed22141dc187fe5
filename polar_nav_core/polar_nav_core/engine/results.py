"""Result of an update, and the gates and ring sizes that both modes share."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.special import gammaincinv

from ..arrays import Array
from .events import Fix

IMU_PERIOD_S = 0.004
CORRECTIONS_PER_S = 40.0
"""Fastest sensors that the rings have room for; faster ones shorten the reach."""
FIXES = 4096
"""Room for the fixes of the stored past."""


@dataclass(frozen=True)
class Outcome:
    """Result of one update: innovation (estimate minus measurement), variance, NIS and gate.

    ``inflation`` is by how much its innovation covariance was enlarged after the gate (robust).
    """

    fused: bool
    z: Array
    variance: Array
    nis: float
    dof: int
    gate: float
    inflation: float = 1.0


def out_of_reach_reason(distance: float, nis: float) -> str:
    """Sentence on a fix that no gate judges, and that is refused for its distance [m]."""
    return (
        f'{distance:.0f} m from the estimate, NIS {nis:.1f}: beyond max_fix_sigma, and farther '
        'than max_speed since the fix before'
    )


@dataclass(frozen=True)
class FixResult:
    """Result of a fix: its outcome, and other fixes whose outcome it changed.

    Attributes
    ----------
    outcome : Outcome
        Of the fix itself.
    steps : int
        Stored filter steps between its validity and now.
    revised : tuple of (Fix, Outcome)
        Other fixes that this one made the gate decide anew, and differently.
    """

    outcome: Outcome
    steps: int
    revised: tuple[tuple[Fix, Outcome], ...] = ()


_GATES: dict[tuple[float, int], float] = {}


def chi2_gate(probability: float, dof: int) -> float:
    """Chi-square threshold of the NIS for a probability and degrees of freedom; infinite for 1."""
    key = (probability, dof)
    if key not in _GATES:
        # The chi-square quantile; scipy.stats would cost every start of a node half a second.
        quantile = (
            math.inf if probability >= 1.0 else 2.0 * float(gammaincinv(dof / 2, probability))
        )
        _GATES[key] = quantile
    return _GATES[key]
