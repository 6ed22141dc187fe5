"""Examination of a bag: missing parts, rates and gaps, consistency of times and counts.

In: any bag, of any origin. Out: an :class:`Examination`, one :class:`Finding` for
each check, with topic, time and number. Nothing is replayed or scored; the content of
messages is not judged, only their presence and times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..analysis.counts import topic_counts
from ..bags.finding import Finding, Severity
from ..bags.reader import Bag
from ..bags.run_folder import read_outcome
from ..foreign.definitions import undecodable
from ..foreign.sources import Source, not_described
from ..foreign.sources.mcap import McapSource
from ..scoring import Column, Table
from ..scoring.json_values import record
from .topic_times import TopicTimes, findings_of, read_times
from .totals import totals
from .wording import to_dict

Progress = Callable[[float], None]
"""Called with the finished share of the work."""


@dataclass(frozen=True)
class Examination:
    """Result of an examination: times of topics, findings.

    Attributes
    ----------
    path : str
        The bag.
    start_ns : int
        Its first log time.
    topics : tuple of TopicTimes
        In order of name, those with messages.
    findings : tuple of Finding
        Errors first, then warnings, then passed checks.
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
        """One line with messages, topics and numbers of findings."""
        messages = sum(t.count for t in self.topics)
        return (
            f'{self.path}: {messages} messages on {len(self.topics)} topics, '
            f'{self.count(Severity.SEVERE)} errors, {self.count(Severity.WARNING)} warnings, '
            f'{self.count(Severity.OK)} ok'
        )

    def table(self) -> Table:
        """Table of counts, rates, gaps and delays of the topics."""
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
        """Examination as values for JSON."""
        return {
            'ok': self.ok,
            'path': self.path,
            'errors': self.count(Severity.SEVERE),
            'warnings': self.count(Severity.WARNING),
            'topics': {t.topic: record(t.to_dict()) for t in self.topics},
            'findings': [record(to_dict(f)) for f in self.findings],
        }


def examine(bag: Bag | Source, *, progress: Progress = lambda _: None) -> Examination:
    """Examination of a bag: one pass over all messages, and one over those that are counted.

    Messages are counted in MCAP bags alone: this project writes no others.

    Raises
    ------
    BagError
        If the bag changes while it is read.
    """
    source = McapSource(bag) if isinstance(bag, Bag) else bag
    times = read_times(source, progress)
    start_ns = min((t.first_log_ns for t in times if t.count), default=0)
    found = [
        Finding(Severity.SEVERE, 'incomplete', '', None, None, problem)
        for problem in source.problems
    ]
    if not source.problems:
        count = sum(topic.count for topic in source.topics.values())
        found.append(Finding(Severity.OK, 'complete', '', None, count, 'the bag is whole'))
    found += _not_described(source)
    mcap = source.bag if isinstance(source, McapSource) else None
    found += _silent(source, mcap)
    recorder = source.run_info.get('recorder')
    simulated = isinstance(recorder, dict) and recorder.get('log_time') == 'simulation'
    for one in times:
        found += findings_of(one, log_from_stamps=simulated)
    found = _one_clock(found)
    if mcap is not None:
        found += totals(mcap)
    found.sort(key=lambda f: -f.severity)
    found = [f.relative_to(start_ns) for f in found]
    return Examination(str(source.path), start_ns, tuple(times), tuple(found))


def _not_described(source: Source) -> list[Finding]:
    """Finding of types without a definition: their stamps are not examined."""
    sentence = undecodable(not_described(source))
    if sentence is None:
        return []
    return [Finding(Severity.WARNING, 'no definition', '', None, None, sentence)]


def _silent(source: Source, bag: Bag | None) -> list[Finding]:
    """Findings of topics without a message, unless none was published."""
    recorder = source.run_info.get('recorder')
    lossless = isinstance(recorder, dict) and recorder.get('lockstep') is True
    quiet = set()
    if bag is not None:
        counts = topic_counts(bag, read_outcome(bag.path).get('counts', {}))
        quiet = {c.topic for c in counts if c.published == 0}
    return [
        Finding(
            Severity.OK if known else Severity.WARNING, 'silent', topic.name, None, 0, 'no message'
        )
        for topic in source.topics.values()
        if not topic.count
        for known in [lossless or topic.name in quiet]
    ]


def _one_clock(found: list[Finding]) -> list[Finding]:
    """Findings, with a single one for all topics whose stamps and log times differ in clock."""
    apart = [f for f in found if f.name == 'other clock']
    if len(apart) < 2:
        return found
    text = f'{apart[0].text}, on {apart[0].topic} and {len(apart) - 1} other topics'
    return [replace(apart[0], topic='', text=text), *(f for f in found if f not in apart)]
