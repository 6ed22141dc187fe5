"""Position error by the age of the last fix."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from polar_nav_core.spilled import by_rows

from ..series.vehicle import Floats
from .errors import ErrorSeries
from .json_values import record
from .statistics import Statistics, statistics

EDGES_S = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0, float('inf'))
"""Classes of age [s]: from one edge up to, not including, the next."""


@dataclass(frozen=True)
class AgeClass:
    """Horizontal errors [m] of estimates in one class of the age of their newest fix [s]."""

    from_s: float
    to_s: float
    horizontal: Statistics  # [m]
    sigma_rms: float  # of the filter's own horizontal sigma, RMS over the class [m]

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {
            **record({'from_s': self.from_s, 'to_s': self.to_s, 'sigma_rms': self.sigma_rms}),
            'horizontal': self.horizontal.to_dict(),
        }


def by_age(error: ErrorSeries, age: Floats) -> tuple[AgeClass, ...]:
    """Errors of a run by class of age of information [s], without empty classes."""
    horizontal = error.horizontal
    variance = by_rows(lambda P: np.trace(P[:, :2, :2], axis1=1, axis2=2), error.P_position_G)
    found = []
    for low, high in pairwise(EDGES_S):
        inside = (age >= low) & (age < high) & np.isfinite(horizontal)
        if inside.any():
            found.append(
                AgeClass(low, high, statistics(horizontal[inside]), _root(variance[inside]))
            )
    return tuple(found)


def _root(variance: Floats) -> float:
    known = variance[np.isfinite(variance) & (variance >= 0.0)]
    return float(np.sqrt(known.mean())) if known.size else float('nan')
