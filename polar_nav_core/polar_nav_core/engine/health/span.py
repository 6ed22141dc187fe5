"""Whether a whole run was well, from its levels over time: the rule behind the exit status."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from .conditions import Health, Level

MOST_ERROR = 0.1
"""Share of the looks of a run that may be an ERROR; of WARNs, that need no word."""


class Look(NamedTuple):
    """Level of a navigation at one look, and the sentence of its worst condition."""

    level: Level
    sentence: str


@dataclass(frozen=True)
class Span:
    """Levels of a run, looked at again and again at about equal intervals.

    Attributes
    ----------
    looks : int
        How often it was looked at.
    warnings, errors : int
        How often it was WARN, ERROR.
    last : Level
        At the end.
    sentence : str
        Of the end if that is an ERROR, else the most frequent of all ERRORs; empty without any.
    warning : str
        The same of WARNs.
    """

    looks: int = 0
    warnings: int = 0
    errors: int = 0
    last: Level = Level.OK
    sentence: str = ''
    warning: str = ''

    @property
    def error_share(self) -> float:
        """Share of the looks with an ERROR; 0 for a run without looks."""
        return self.errors / self.looks if self.looks else 0.0

    @property
    def complaint(self) -> str:
        """Sentence on why the run was not well; empty for a run that was. A WARN is well."""
        if self.last is Level.ERROR:
            return f'ERROR at the end: {self.sentence}'
        if self.error_share > MOST_ERROR:
            return f'ERROR for {100.0 * self.error_share:.0f} % of the time: {self.sentence}'
        return ''

    @property
    def remark(self) -> str:
        """Sentence on a WARN at the end, or for long; empty with a complaint, too."""
        if self.complaint or not self.looks:
            return ''
        if self.last is Level.WARN:
            return f'WARN at the end: {self.warning}'
        share = self.warnings / self.looks
        if share > MOST_ERROR:
            return f'WARN for {100.0 * share:.0f} % of the time: {self.warning}'
        return ''

    @property
    def any_word(self) -> str:
        """Sentence on any WARN or ERROR of the run, however short; empty for a run without.

        For who takes the recording as a whole: what passed in a minute is still in its constants.
        """
        if self.complaint or self.remark:
            return self.complaint or self.remark
        if self.errors:
            return f'ERROR for {_percent(self.errors, self.looks)} of the time: {self.sentence}'
        if self.warnings:
            return f'WARN for {_percent(self.warnings, self.looks)} of the time: {self.warning}'
        return ''

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            'looks': self.looks,
            'warnings': self.warnings,
            'errors': self.errors,
            'level_at_end': self.last.name,
            'complaint': self.complaint or None,
            'remark': self.remark or None,
        }


def span_of(looks: Iterable[Look]) -> Span:
    """Levels of a run summed up, from its looks in the order of time."""
    found = list(looks)
    if not found:
        return Span()
    return Span(
        looks=len(found),
        warnings=sum(look.level is Level.WARN for look in found),
        errors=sum(look.level is Level.ERROR for look in found),
        last=found[-1].level,
        sentence=_sentence(found, Level.ERROR),
        warning=_sentence(found, Level.WARN),
    )


def _percent(count: int, looks: int) -> str:
    """Share in per cent with two digits, however small it is."""
    share = 100.0 * count / looks
    return f'{share:.0f} %' if share >= 10.0 else f'{share:.2g} %'


def _sentence(looks: list[Look], level: Level) -> str:
    """Sentence of the last look if that has the level, else the one that most such looks have."""
    if looks[-1].level is level:
        return looks[-1].sentence
    such = [look.sentence for look in looks if look.level is level]
    if not such:
        return ''
    most = Counter(map(_kind, such)).most_common(1)[0][0]
    return next(sentence for sentence in reversed(such) if _kind(sentence) == most)


def span_of_health(health: Iterable[Health]) -> Span:
    """Levels of a run summed up, from the watchdog's judgements in the order of time."""
    return span_of(Look(h.level, h.sentence) for h in health)


def words_of_health(health: Iterable[Health]) -> list[str]:
    """Return a sentence for each condition that was present, ERRORs first, then the longest.

    A look of `Span` has the worst condition alone: the others of that time stand here.
    """
    looks, counts, said = 0, Counter[str](), dict[str, tuple[Level, str]]()
    for look in health:
        looks += 1
        for one in (p.condition for p in look.present):
            counts[one.key] += 1
            if one.key not in said or one.level >= said[one.key][0]:
                said[one.key] = one.level, one.sentence
    keys = sorted(said, key=lambda key: (-said[key][0], -counts[key]))
    return [
        f'{said[key][0].name} for {_percent(counts[key], looks)} of the time: {said[key][1]}'
        for key in keys
    ]


def _kind(sentence: str) -> str:
    """The sentence without its numbers, which change while the condition lasts."""
    return ''.join(c for c in sentence if not (c.isdigit() or c in '.+-'))
