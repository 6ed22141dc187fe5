"""Which times of a topic a guessed mapping takes, after the checks of stamps have been run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..bags.finding import Severity
from .check_stamps import check_stamps, seconds_text
from .lines import Lines
from .sources import Source, Stamps, field_paths, read_table

_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
_OTHER_CLOCK_NS = 3_600_000_000_000
"""Nothing is recorded an hour after it was valid, but by another clock."""


@dataclass(frozen=True)
class TopicTimes:
    """Times of a topic: header stamps, None where there is no header, and log times [ns].

    ``stated`` is the line of a mapping that says which they are; empty for the stamps as they are.
    """

    topic: str
    stamps_ns: Stamps | None
    log_ns: Stamps
    stated: str = ''

    @property
    def stamped(self) -> bool:
        """Whether stamps were filled in."""
        return self.stamps_ns is not None and bool(self.stamps_ns.any())

    @property
    def behind_log_ns(self) -> int:
        """Median of log time less stamp; zero where nobody stamped [ns]."""
        if self.stamps_ns is None or not self.stamped:
            return 0
        return round(float(np.median(self.log_ns - self.stamps_ns)))


def times_of(source: Source, topic: str) -> TopicTimes:
    """Read the times of a topic; errors as `sources.read_table`."""
    paths = field_paths(source, topic)
    headed = all(p in paths for p in _STAMP)
    table = read_table(source, topic, _STAMP if headed else paths[:1])
    stamps_ns = None
    if headed:
        sec, nanosec = (table.columns[p].astype(np.int64) for p in _STAMP)
        stamps_ns = sec * 10**9 + nanosec
    return TopicTimes(topic, stamps_ns, table.log_ns)


def is_alone(times: TopicTimes, others: Sequence[TopicTimes]) -> bool:
    """Whether stamps are of a clock of their own, while others have that of the recorder."""
    stamped = [o for o in others if o.stamped]
    near = sum(abs(o.behind_log_ns) <= _OTHER_CLOCK_NS for o in stamped)
    return abs(times.behind_log_ns) > _OTHER_CLOCK_NS and 2 * near > len(stamped)


def put_stamp(
    out: Lines,
    times: TopicTimes,
    reference: TopicTimes | None,
    clock: str | None,
    *,
    delayed: bool = False,
    indent: int = 2,
) -> bool:
    """Write which times a topic has, and what its stamps show; True where they are the log times.

    Parameters
    ----------
    out : Lines
    times : TopicTimes
    reference : TopicTimes or None
        Those of the IMU, where these are of another topic.
    clock : str or None
        ``header`` or ``log``, where a person chose one.
    delayed : bool
        Messages come with a delay of their own: the log time is not that of validity.
    indent : int
    """
    if times.stamps_ns is None:
        out.say('the type has no header: times are those of the recording', indent)
        out.put('stamp: log', indent)
        return True
    severe = _checked(out, times.topic, times.stamps_ns, times.log_ns, delayed, indent)
    if clock == 'log' and not delayed:
        out.put('stamp: log', indent)
        return True
    if clock == 'header':
        return False
    if 'stamps_zero' in severe:
        out.say('no stamps to rely on: times are those of the recording', indent)
        out.put('stamp: log', indent)
        return True
    apart_ns = times.behind_log_ns - (0 if reference is None else reference.behind_log_ns)
    if reference is None or abs(apart_ns) <= _OTHER_CLOCK_NS:
        return False
    offset = seconds_text(apart_ns)
    if delayed:
        days = f'{apart_ns / 8.64e13:.3g} days'
        out.say(f'recorded {offset} s ({days}) after their stamps: another', indent)
        out.say('clock, not a delay. FILL IN that number less the delay:', indent)
        out.put('time_offset_s: FILL_IN', indent)
        return False
    out.say(
        f'stamps are {offset} s behind the clock of the IMU: another clock. Instead of', indent
    )
    out.say(f'the log times, `time_offset_s: {offset}` keeps the spacing of the stamps', indent)
    out.say('and `clock: sensor` fits their clock to that of the recorder (docs/live.md)', indent)
    out.put('stamp: log', indent)
    return True


def _checked(
    out: Lines, topic: str, stamps_ns: Stamps, log_ns: Stamps, delayed: bool, indent: int
) -> set[str]:
    """Write what the checks of `replay` find in the stamps; names of what would refuse a run."""
    severe = set()
    for found in check_stamps(topic, stamps_ns, log_ns, delayed=delayed):
        if found.severity >= Severity.WARNING:
            out.say(f'CHECK {found.severity.name.lower()}: {found.name}: {found.text}', indent)
        if found.severity is Severity.SEVERE:
            severe.add(found.name)
    return severe
