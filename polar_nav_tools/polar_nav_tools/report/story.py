"""Sentences and numbers of a report, made from the scores alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..scoring import Balance, Comparison, Score
from ..scoring.consistency import OPTIMISTIC, PESSIMISTIC
from ..scoring.tables import show
from ..scoring.verdicts import FUSED
from .input import Digest, TopicCount

GOOD, BAD, NEUTRAL = 'good', 'bad', 'neutral'

_NBSP = '\u00a0'  # keeps a number with its unit
_LAG_TOLERANCE = 0.2  # share of speed x mean delay within which an error counts as explained by it


@dataclass(frozen=True)
class Card:
    """One number at the top of the page."""

    label: str
    value: str
    unit: str
    detail: str
    mood: str = NEUTRAL
    run: int | None = None  # place of the configuration, for its colour


def headline(scores: Comparison, judged: Sequence[str] = ()) -> str:
    """Result in one or two sentences, led by the first run that decides whether all is well."""
    runs = scores.scores
    found = {name: one.second_half.rms('horizontal') for name, one in runs.items()}
    finite = {name: value for name, value in found.items() if np.isfinite(value)}
    if not finite:
        return 'No configuration has an estimate in the second half of the run.'
    best = min(finite, key=finite.__getitem__)
    worst = max(finite, key=finite.__getitem__)
    lead = next((name for name in judged if name in finite), best)
    other = worst if worst != lead else best
    text = f'In the second half, {lead} is {_metres(finite[lead])} from the truth (2-D RMS)'
    if other == lead:
        return text + '.'
    text += f', {other} {_metres(finite[other])}.'
    lag = runs[other].second_half.lag
    if other == worst and abs(lag.ratio - 1.0) <= _LAG_TOLERANCE and lag.along_mean < 0.0:
        text += (
            ' That is the lag of fusing late fixes as current: '
            f'{lag.mean_speed:.2f}{_NBSP}m/s ×{_NBSP}{lag.mean_delay:.2f}{_NBSP}s = '
            f'{_metres(lag.expected)}.'
        )
    return text


def _as_they_came(scores: Comparison) -> Score:
    """Score of the last run that got its fixes as they came: a smoother has each when valid."""
    late = [s for s in scores.scores.values() if s.second_half.lag.mean_delay > 0.0]
    return (late or list(scores.scores.values()))[-1]


def cards(
    scores: Comparison,
    balances: Sequence[Balance],
    digests: Sequence[Digest],
    counts: Sequence[TopicCount],
) -> list[Card]:
    """Numbers for the top of the page."""
    found = [_error_card(i, name, s) for i, (name, s) in enumerate(scores.scores.items())]
    last = _as_they_came(scores)
    lag = last.second_half.lag
    found.append(
        Card(
            'Mean delay of a fix',
            show(lag.mean_delay),
            's',
            f'× {show(lag.mean_speed)} m/s = {show(lag.expected)} m if ignored',
        )
    )
    found.append(_fix_card(last, balances))
    if digests:
        equal = all(d.equal for d in digests)
        found.append(
            Card(
                'Replay against live run',
                'equal' if equal else 'differs',
                '',
                'bit for bit, by sha256' if equal else 'sha256 below',
                GOOD if equal else BAD,
            )
        )
    elif counts:
        equal = all(c.equal for c in counts)
        found.append(
            Card(
                'Messages',
                'none lost' if equal else 'lost some',
                '',
                f'{len(counts)} topics counted',
                GOOD if equal else BAD,
            )
        )
    return found


def warnings(
    scores: Comparison,
    balances: Sequence[Balance],
    digests: Sequence[Digest],
    counts: Sequence[TopicCount],
) -> list[str]:
    """Sentences about shortcomings of the run, for the top of the page."""
    found = []
    for name, one in scores.scores.items():
        share = one.availability.share
        if share < 0.99:
            found.append(
                f'{name} gave estimates for {100 * share:.1f} % of the run only; its longest '
                f'silence was {one.availability.longest_outage:.1f} s. Its errors are those of '
                'the time it spoke.'
            )
        if one.availability.diverged:
            found.append(f'{name} published {one.availability.diverged} estimates as diverged.')
        if one.alignment.outside or one.alignment.in_gap:
            found.append(
                f'{name}: {one.alignment.outside} estimates lie outside the truth in time, '
                f'{one.alignment.in_gap} in gaps of it; they are not scored.'
            )
    found += [
        f'{b.topic}: {b.received} messages were received and {b.verdicts} have a verdict.'
        for b in balances
        if not b.balanced
    ]
    found += [f'{d.what}: the replay differs from the live run.' for d in digests if not d.equal]
    found += [
        f'{c.topic}: {_count(c.published)} published, {_count(c.recorded)} recorded, '
        f'{_count(c.received)} received.'
        for c in counts
        if not c.equal
    ]
    return found


def _error_card(index: int, name: str, one: Score) -> Card:
    late = one.second_half
    judgement = late.nees_horizontal.judgement
    honest = {
        OPTIMISTIC: 'covariance too small',
        PESSIMISTIC: 'covariance too large',
    }.get(judgement, 'covariance honest' if judgement == 'consistent' else 'covariance not judged')
    return Card(name, show(late.rms('horizontal')), 'm', f'2-D RMS, 2nd half; {honest}', run=index)


def _fix_card(one: Score, balances: Sequence[Balance]) -> Card:
    fused, total = one.verdicts.by_verdict.get(FUSED, 0), one.verdicts.total
    if balances:
        balanced = all(b.balanced for b in balances)
        detail = 'every received one has a verdict' if balanced else 'some have no verdict'
        return Card('Fixes fused', f'{fused}', f'of {total}', detail, GOOD if balanced else BAD)
    return Card('Fixes fused', f'{fused}', f'of {total}', one.name)


def _metres(value: float) -> str:
    return f'{show(value)}{_NBSP}m'


def _count(value: int | None) -> str:
    return 'not counted' if value is None else str(value)
