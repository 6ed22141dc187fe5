"""Honesty of a run: NEES of position, velocity and heading, in words, and the worst of them.

An estimate is as honest as its worst part: a position that fits beside a heading that is wrong and
sure is not honest. Optimistic (errors larger than stated) is worse than pessimistic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .consistency import CONSISTENT, OPTIMISTIC, PESSIMISTIC, UNKNOWN, Consistency
from .drift_tables import CONFIGURATION
from .json_values import record
from .score import Score
from .tables import MISSING, Column, Table
from .windows import SECOND_HALF, WHOLE

HONEST = 'honest'
_WORDS = {CONSISTENT: HONEST}
_PARTS = {WHOLE: 'whole run', SECOND_HALF: 'second half'}
_RANK = (UNKNOWN, CONSISTENT, PESSIMISTIC, OPTIMISTIC)


@dataclass(frozen=True)
class Honesty:
    """Consistency of one quantity over one window, in words.

    Attributes
    ----------
    quantity, window : str
        As shown: position, velocity or heading; the whole run or its second half.
    found : Consistency
        NEES per degree of freedom with its band.
    """

    quantity: str
    window: str
    found: Consistency

    @property
    def word(self) -> str:
        """Judgement in a word: honest, optimistic, pessimistic or unknown."""
        return _WORDS.get(self.found.judgement, self.found.judgement)

    @property
    def severity(self) -> tuple[int, float]:
        """Sort key: the kind of judgement first, then how far it is beyond its band."""
        c, kind = self.found, self.found.judgement
        beyond = 0.0
        if kind == PESSIMISTIC:
            beyond = c.band_low / c.mean_per_dof if c.mean_per_dof > 0.0 else float('inf')
        elif kind != UNKNOWN:
            beyond = c.mean_per_dof / c.band_high
        return _RANK.index(kind), beyond

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        values = record(
            {
                'mean_per_dof': self.found.mean_per_dof,
                'band_low': self.found.band_low,
                'band_high': self.found.band_high,
            }
        )
        return {'quantity': self.quantity, 'window': self.window, 'judgement': self.word, **values}


def honesty_of(score: Score) -> tuple[Honesty, ...]:
    """Honesty of position, velocity and heading over the whole run and its second half."""
    return tuple(
        Honesty(quantity, part, found)
        for window, part in _PARTS.items()
        for quantity, found in (
            ('position', score.windows[window].nees_position),
            ('velocity', score.windows[window].nees_velocity),
            ('heading', score.windows[window].nees_heading),
        )
    )


def worst_of(score: Score) -> Honesty:
    """The worst judgement of a run: its headline."""
    return max(honesty_of(score), key=lambda h: h.severity)


HEADLINE_COLUMNS = (
    Column('honesty', 'covariance', doc='worst of position, velocity and heading, see below'),
    Column('worst_quantity', 'worst', doc='of which quantity, over which part of the run'),
    Column('worst_per_dof', 'NEES/dof', doc='mean squared error over its covariance; 1 is honest'),
    Column('worst_band', 'band', doc='95 % band of an honest covariance for so long a run'),
)
"""Columns of the table of the demo."""


def headline(score: Score) -> dict[str, object]:
    """Values for `HEADLINE_COLUMNS`."""
    worst = worst_of(score)
    known = worst.word != UNKNOWN
    return {
        'honesty': worst.word,
        'worst_quantity': f'{worst.quantity}, {worst.window}' if known else MISSING,
        'worst_per_dof': worst.found.mean_per_dof,
        'worst_band': _band(worst.found) if known else MISSING,
    }


def honesty_table(scores: Mapping[str, Score]) -> Table:
    """Table of all judgements of each run."""
    columns = (
        CONFIGURATION,
        Column('quantity', 'what'),
        Column('window', 'over'),
        Column('mean_per_dof', 'NEES/dof', doc='1 for an honest covariance'),
        Column('band_low', 'band from', doc='95 % band of NEES/dof'),
        Column('band_high', 'to', doc='95 % band of NEES/dof'),
        Column('judgement', 'judgement'),
    )
    rows = tuple(
        {'configuration': name, **one.to_dict()}
        for name, score in scores.items()
        for one in honesty_of(score)
    )
    return Table('How honest are position, velocity and heading?', columns, rows)


def _band(found: Consistency) -> str:
    return f'{found.band_low:.3g} to {found.band_high:.3g}'
