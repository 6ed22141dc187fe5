"""Examines a bag: what is missing, how regular it is, whether its times make sense and add up.

In: any bag, also one of somebody else's. Out: an :class:`Examination`, one :class:`Finding` for
each thing that was looked at, with topic, time and number. Nothing is replayed or scored; what a
message says is not judged, only that it is there and when it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..analysis.counts import topic_counts
from ..bags.finding import Finding, Severity
from ..bags.reader import Bag
from ..bags.run_folder import read_outcome
from ..scoring import Column, Table
from ..scoring.json_values import record
from .topic_times import TopicTimes, findings_of, read_times
from .totals import totals
from .wording import to_dict

Progress = Callable[[float], None]
"""Called with the share of the work that is done."""


@dataclass(frozen=True)
class Examination:
    """What was found in a bag.

    Attributes
    ----------
    path : str
        The bag.
    start_ns : int
        Its first log time.
    topics : tuple of TopicTimes
        In order of name, those with messages.
    findings : tuple of Finding
        Errors first, then warnings, then what is well.
    """

    path: str
    start_ns: int
    topics: tuple[TopicTimes, ...]
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return self.count(Severity.SEVERE) == 0

    def count(self, severity: Severity) -> int:
        """Number of findings of a severity."""
        return sum(1 for f in self.findings if f.severity is severity)

    def summary(self) -> str:
        """Say it in one line."""
        messages = sum(t.count for t in self.topics)
        return (
            f'{self.path}: {messages} messages on {len(self.topics)} topics, '
            f'{self.count(Severity.SEVERE)} errors, {self.count(Severity.WARNING)} warnings, '
            f'{self.count(Severity.OK)} ok'
        )

    def table(self) -> Table:
        """Counts, rates, gaps and delays of the topics."""
        columns = (
            Column('topic', 'topic'),
            Column('count', 'messages'),
            Column('rate_hz', 'rate', 'Hz', 4, 'one over the median interval'),
            Column('interval_max_s', 'longest gap', 's'),
            Column('delay_median_s', 'log - stamp', 's', doc='median'),
        )
        rows = tuple({c.key: t.to_dict()[c.key] for c in columns} for t in self.topics)
        return Table('Topics', columns, rows)

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            'ok': self.ok,
            'path': self.path,
            'errors': self.count(Severity.SEVERE),
            'warnings': self.count(Severity.WARNING),
            'topics': {t.topic: record(t.to_dict()) for t in self.topics},
            'findings': [record(to_dict(f)) for f in self.findings],
        }


def examine(bag: Bag, *, progress: Progress = lambda _: None) -> Examination:
    """Examine a bag in one pass over its messages, and a second one over those that are counted.

    Raises
    ------
    BagError
        When the bag changes while it is read.
    """
    times = read_times(bag, progress)
    start_ns = min((t.first_log_ns for t in times if t.count), default=0)
    found = [
        Finding(Severity.SEVERE, 'incomplete', '', None, None, problem) for problem in bag.problems
    ]
    if not bag.problems:
        found.append(
            Finding(Severity.OK, 'complete', '', None, bag.message_count, 'the bag is whole')
        )
    found += _silent(bag)
    recorder = bag.run_info.get('recorder')
    simulated = isinstance(recorder, dict) and recorder.get('log_time') == 'simulation'
    for one in times:
        found += findings_of(one, log_from_stamps=simulated)
    found = _one_clock(found)
    found += totals(bag)
    found.sort(key=lambda f: -f.severity)
    found = [f.relative_to(start_ns) for f in found]
    return Examination(str(bag.path), start_ns, tuple(times), tuple(found))


def _silent(bag: Bag) -> list[Finding]:
    """Topics without a message: odd, unless it is known that nobody spoke."""
    recorder = bag.run_info.get('recorder')
    lossless = isinstance(recorder, dict) and recorder.get('lockstep') is True
    counts = topic_counts(bag, read_outcome(bag.path).get('counts', {}))
    quiet = {c.topic for c in counts if c.published == 0}
    return [
        Finding(
            Severity.OK if known else Severity.WARNING, 'silent', topic.name, None, 0, 'no message'
        )
        for topic in bag.topics.values()
        if not topic.count
        for known in [lossless or topic.name in quiet]
    ]


def _one_clock(found: list[Finding]) -> list[Finding]:
    """Say once for all topics that stamps are of another clock than log times."""
    apart = [f for f in found if f.name == 'other clock']
    if len(apart) < 2:
        return found
    text = f'{apart[0].text}, on {apart[0].topic} and {len(apart) - 1} other topics'
    return [replace(apart[0], topic='', text=text), *(f for f in found if f not in apart)]
