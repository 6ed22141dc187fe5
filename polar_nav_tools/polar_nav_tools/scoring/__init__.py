"""Scores of runs against the truth: errors by stamp, consistency, verdicts of fixes.

`compare` takes ``{name: (truth, estimates, receipts)}`` and returns a `Comparison` whose tables
print to the terminal, Markdown, CSV, JSON and the report. Everything here is a pure function of
series.
"""

from .align import Alignment, AlignmentCounts, ScoringError, align
from .compare import Comparison, compare
from .consistency import Consistency, chi_square_band, consistency, normalized_squared
from .errors import ErrorSeries, errors
from .phases import mission_phases
from .relative import absolute_errors, relative_errors
from .score import ComponentScore, Drift, Score, WindowScore, score
from .statistics import Statistics, statistics
from .tables import Column, Table
from .timeliness import Availability, Lag, age_of_information, availability, delays
from .verdicts import (
    Balance,
    VerdictCounts,
    VerdictSeries,
    balances,
    count_verdicts,
    nis_by_source,
)
from .windows import Window, standard_windows

__all__ = [
    'Alignment',
    'AlignmentCounts',
    'Availability',
    'Balance',
    'Column',
    'Comparison',
    'ComponentScore',
    'Consistency',
    'Drift',
    'ErrorSeries',
    'Lag',
    'Score',
    'ScoringError',
    'Statistics',
    'Table',
    'VerdictCounts',
    'VerdictSeries',
    'Window',
    'WindowScore',
    'absolute_errors',
    'age_of_information',
    'align',
    'availability',
    'balances',
    'chi_square_band',
    'compare',
    'consistency',
    'count_verdicts',
    'delays',
    'errors',
    'mission_phases',
    'nis_by_source',
    'normalized_squared',
    'relative_errors',
    'score',
    'standard_windows',
    'statistics',
]
