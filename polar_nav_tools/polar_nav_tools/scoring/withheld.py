"""Score of predictions of withheld measurements: error, NIS, coverage; no truth is needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from .consistency import CONSISTENT, Consistency, consistency_along, whitened
from .drift_tables import CONFIGURATION
from .honesty import HONEST
from .json_values import record
from .statistics import Statistics, statistics
from .tables import Column, Table

if TYPE_CHECKING:
    from ..series.vehicle import Floats

LEVELS = (0.68, 0.95)


@dataclass(frozen=True)
class WithheldScore:
    """Score of the predictions of one kind of measurement.

    Attributes
    ----------
    what : str
        What was withheld, and which components: ``fixes:50%, horizontal``.
    unit : str
    count, offered : int
        Compared; usable ones in the bag.
    error : Statistics
        Length of the difference.
    nis : Consistency
        Of the whitened differences; effective numbers, as they are correlated along a run.
    coverage : mapping of float to float
        Share of the differences inside the ellipsoid that should hold 68 % and 95 %.
    """

    what: str
    unit: str
    count: int
    offered: int
    error: Statistics
    nis: Consistency
    coverage: Mapping[float, float]

    @property
    def judgement(self) -> str:
        """Judgement in a word: honest, optimistic, pessimistic or unknown."""
        found = self.nis.judgement
        return HONEST if found == CONSISTENT else found

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            'what': self.what,
            'unit': self.unit,
            'count': self.count,
            'offered': self.offered,
            'judgement': self.judgement,
            'error': self.error.to_dict(),
            'nis': self.nis.to_dict(),
            'coverage': record({f'{100.0 * p:.0f} %': v for p, v in self.coverage.items()}),
        }


def withheld_score(
    what: str, unit: str, offered: int, error: Floats, covariance: Floats
) -> WithheldScore:
    """Score of differences between predictions and measurements.

    Parameters
    ----------
    what, unit, offered
        As in `WithheldScore`.
    error, covariance : (n, m), (n, m, m) arrays
        Prediction minus measurement, and its covariance.
    """
    dof = error.shape[1]
    normal = whitened(error, covariance)
    squared = np.square(normal).sum(1)
    known = squared[np.isfinite(squared)]
    inside = {
        p: float(np.mean(known <= chi2.ppf(p, dof))) if known.size else float('nan')
        for p in LEVELS
    }
    return WithheldScore(
        what=what,
        unit=unit,
        count=len(error),
        offered=offered,
        error=statistics(np.linalg.norm(error, axis=1)),
        nis=consistency_along(normal),
        coverage=inside,
    )


def withheld_table(scores: Mapping[str, Sequence[WithheldScore]]) -> Table:
    """Table of the predictions of all runs."""
    columns = (
        CONFIGURATION,
        Column('what', 'withheld'),
        Column('count', 'compared'),
        Column('offered', 'of', doc='usable measurements of this kind'),
        Column('unit', 'unit'),
        Column('rms', 'RMS'),
        Column('median', 'median'),
        Column('max', 'largest'),
        Column('mean_per_dof', 'NIS/dof', doc='1 for an honest covariance'),
        Column('band_low', 'band from', doc='95 % band, effective samples'),
        Column('band_high', 'to', doc='95 % band, effective samples'),
        Column('inside_68', 'in 68 %', '%', doc='68 for an honest covariance'),
        Column('inside_95', 'in 95 %', '%', doc='95 for an honest covariance'),
        Column('judgement', 'judgement'),
    )
    rows = tuple(
        {
            'configuration': name,
            'what': one.what,
            'count': one.count,
            'offered': one.offered,
            'unit': one.unit,
            'rms': one.error.rms,
            'median': one.error.median,
            'max': one.error.max,
            'mean_per_dof': one.nis.mean_per_dof,
            'band_low': one.nis.band_low,
            'band_high': one.nis.band_high,
            'inside_68': 100.0 * one.coverage[0.68],
            'inside_95': 100.0 * one.coverage[0.95],
            'judgement': one.judgement,
        }
        for name, found in scores.items()
        for one in found
    )
    note = (
        'Prediction minus measurement, with the published covariance and that of the measurement. '
        'Differences along one run are correlated: the band counts effective samples.'
    )
    return Table('Withheld measurements, predicted', columns, rows, note)
