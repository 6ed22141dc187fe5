"""Stamps and log times of a topic's messages, and findings about them.

Only the header is read: its stamp is in the first bytes of a message whose definition begins with
one, for any other content.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_ros.adapters.arrays import unfilled

from ..bags.finding import Finding, Severity
from ..foreign.sources import Source

Ints = NDArray[np.int64]

GAP_FACTOR = 3.0
"""An interval this many times the usual one is a gap."""
JUMP_S = 1.0
"""Stamps that move this much further than log time, or less far, have jumped."""
DRIFT, DRIFT_S = 1e-4, 0.1
"""Seconds per second by which stamps and log time may part, as clocks of computers do, and the
whole by which they must have parted before it is more than the noise of a transport."""
WRONG_CLOCK, WRONG_CLOCK_S = 1e-2, 1.0
"""From these on, as in a replay, no speed and no turn comes out right."""
FUTURE_S = 0.1
"""Least time [s] of logging before validity that is impossible for a transport."""
OTHER_CLOCK_S = 3600.0
"""Stamps and log times further apart are of two clocks, simulated and real for example."""
_REGULAR_SHARE = 0.8
_REGULAR_MOST = 20
_SEVERAL_SENDERS = (
    'diagnostic_msgs/msg/DiagnosticArray',
    'tf2_msgs/msg/TFMessage',
    'rcl_interfaces/msg/Log',
)
"""Types that many nodes publish on one topic: their stamps have no common order."""
_OVERTAKING = frozenset(
    f'polar_nav_msgs/msg/{name}'
    for name in ('AcousticPacket', 'LeaderBroadcast', 'StationFix', 'FixReceipt')
)
"""Types of what comes over an acoustic link: a packet may overtake another one."""
LATEST_NS = 1 << 62
"""The year 2116: log times behind it are damage, and differences with them leave 64 bits."""
_STUCK_SHARE = 0.5
"""Of equal stamps one behind the other, above which the sender's clock stood still."""
_LITTLE, _BIG = struct.Struct('<iII'), struct.Struct('>iII')
"""A header after the encapsulation: seconds, nanoseconds, length of the frame's name."""
_FRONT, _STAMP_END = 4 + _LITTLE.size, 12


@dataclass(frozen=True, eq=False)
class TopicTimes:
    """Times of one topic, in the order of the file.

    Attributes
    ----------
    topic, type : str
        As in the bag.
    log_ns : ndarray of int64, shape (n,)
        Log time of each readable message [ns].
    stamp_ns : ndarray of int64, shape (n,), or None
        Header stamps; None for messages without a header.
    unreadable : int
        Messages that end before the header they should have does.
    beyond : int
        Messages with a log time after 2116.
    """

    topic: str
    type: str
    log_ns: Ints
    stamp_ns: Ints | None
    unreadable: int = 0
    beyond: int = 0

    @property
    def count(self) -> int:
        """Number of messages with known times."""
        return len(self.log_ns)

    @property
    def first_log_ns(self) -> int:
        """Oldest log time [ns]; there must be one."""
        return int(self.log_ns.min())

    @property
    def times_ns(self) -> Ints:
        """Stamps [ns], or log times without stamps."""
        return self.log_ns if self.stamp_ns is None else self.stamp_ns

    @property
    def period_ns(self) -> float:
        """Median interval; NaN for fewer than three messages."""
        return float(np.median(np.diff(self.times_ns))) if self.count > 2 else float('nan')

    @property
    def regular(self) -> bool:
        """Whether messages come at a rate: most intervals are within half of the usual one."""
        if self.count < _REGULAR_MOST:
            return False
        period, steps = self.period_ns, np.diff(self.times_ns)
        near = np.abs(steps - period) <= 0.5 * period
        return bool(period > 0.0 and near.mean() >= _REGULAR_SHARE)

    def to_dict(self) -> dict[str, object]:
        """Numbers of the table as values for JSON."""
        steps = np.diff(self.times_ns)
        period = self.period_ns
        delay = np.zeros(0) if self.stamp_ns is None else self.log_ns - self.stamp_ns
        return {
            'topic': self.topic,
            'type': self.type,
            'count': self.count,
            'rate_hz': 1e9 / period if self.regular else float('nan'),
            'regular': self.regular,
            'interval_max_s': float(steps.max()) * 1e-9 if steps.size else float('nan'),
            'delay_median_s': float(np.median(delay)) * 1e-9 if delay.size else float('nan'),
        }


def read_times(bag: Source, progress: Callable[[float], None]) -> list[TopicTimes]:
    """Read the times of all topics in one pass, in order of topic."""
    headed = {name: topic.count > 0 and bag.headed(name) for name, topic in bag.topics.items()}
    count = sum(topic.count for topic in bag.topics.values())
    logs: dict[str, list[int]] = {name: [] for name in bag.topics}
    stamps: dict[str, list[int]] = {name: [] for name in bag.topics}
    bad, beyond = dict.fromkeys(bag.topics, 0), dict.fromkeys(bag.topics, 0)
    every = max(1, count // 100)
    for i, (topic, log_ns, data) in enumerate(bag.fronts()):
        if i % every == 0:
            progress(i / count)
        if log_ns > LATEST_NS:
            beyond[topic] += 1
            continue
        if not headed[topic]:
            logs[topic].append(log_ns)
            continue
        front = _front(data)
        if front is None:
            bad[topic] += 1
            continue
        sec, nanosec = front
        logs[topic].append(log_ns)
        stamps[topic].append(sec * 1_000_000_000 + nanosec)
    progress(1.0)
    return [
        TopicTimes(
            topic=name,
            type=bag.topics[name].type,
            log_ns=np.array(logs[name], dtype=np.int64),
            stamp_ns=np.array(stamps[name], dtype=np.int64) if headed[name] else None,
            unreadable=bad[name],
            beyond=beyond[name],
        )
        for name in bag.topics
        if logs[name] or bad[name] or beyond[name]
    ]


def _front(data: bytes) -> tuple[int, int] | None:
    """Seconds and nanoseconds of a message's stamp; None where its header does not end in it.

    A name as long as memory is what the wrong byte order makes of a short one. Some sources give
    nothing behind the stamp.
    """
    if len(data) < _STAMP_END:
        return None
    form = _LITTLE if data[1] & 1 else _BIG
    sec, nanosec, length = form.unpack_from(data[4:_FRONT].ljust(form.size, b'\0'))
    return None if length > max(0, len(data) - _FRONT) else (sec, nanosec)


def findings_of(t: TopicTimes, *, log_from_stamps: bool = False) -> list[Finding]:
    """Findings about the times of one topic.

    Parameters
    ----------
    t : TopicTimes
    log_from_stamps : bool
        The recorder made log times out of stamps, so that comparing them is meaningless.
    """
    found: list[Finding] = []
    if t.unreadable:
        text = (
            f'{t.unreadable} messages end before their header does: '
            'cut off, or not in the byte order that they state'
        )
        found.append(Finding(Severity.SEVERE, 'unreadable', t.topic, None, t.unreadable, text))
    if t.beyond:
        text = f'{t.beyond} messages have a log time after the year 2116'
        found.append(Finding(Severity.SEVERE, 'log time', t.topic, None, t.beyond, text))
    if not t.count:
        return found
    found += _rate_and_gaps(t)
    if t.stamp_ns is not None:
        found += _zero(t)
        if t.type not in _SEVERAL_SENDERS:
            found += _order(t, t.stamp_ns)
        if not log_from_stamps:
            found += _against_log(t, t.stamp_ns)
        elif t.type not in _SEVERAL_SENDERS:
            found += _far_from_log(t, t.stamp_ns)
    return found


def _rate_and_gaps(t: TopicTimes) -> list[Finding]:
    if not t.regular:
        text = f'{t.count} messages at no regular rate'
        return [Finding(Severity.OK, 'rate', t.topic, None, t.count, text)]
    period, times = t.period_ns, t.times_ns
    steps = np.diff(times)
    text = f'{t.count} messages at {1e9 / period:.4g} Hz'
    found = [Finding(Severity.OK, 'rate', t.topic, None, 1e9 / period, text)]
    # Stamps that leap while the recording goes on leave no gap: they are said to jump.
    leaps = (steps - np.diff(t.log_ns)) * 1e-9 > JUMP_S
    gaps = np.flatnonzero((steps > GAP_FACTOR * period) & ~leaps)
    if gaps.size:
        worst = int(gaps[np.argmax(steps[gaps])])
        missing = int(np.sum(np.rint(steps[gaps] / period) - 1))
        lasted_s = float(steps[~leaps].sum()) * 1e-9
        about = f'about {missing} messages'
        if missing > t.count:  # pauses or bursts are the rule: nothing says how many there were
            about = f'{(t.count - 1) / lasted_s:.4g} Hz by count and duration'
        text = (
            f'{gaps.size} gaps over {GAP_FACTOR:g} intervals, {about}; '
            f'the longest has {steps[worst] * 1e-9:.3f} s'
        )
        found.append(Finding(Severity.WARNING, 'gap', t.topic, int(times[worst]), gaps.size, text))
    return found


def _zero(t: TopicTimes) -> list[Finding]:
    zero = np.flatnonzero(unfilled(t.times_ns))
    if not zero.size:
        return []
    text = f'{zero.size} of {t.count} stamps are zero'
    when = int(t.log_ns[zero[0]])
    severity = Severity.SEVERE if zero.size > 1 else Severity.WARNING
    return [Finding(severity, 'zero stamp', t.topic, when, zero.size, text)]


def _order(t: TopicTimes, stamp_ns: Ints) -> list[Finding]:
    """Findings about stamps that run backwards or repeat; of events, only the former."""
    steps = np.diff(stamp_ns)
    found = []
    back = np.flatnonzero(steps < 0)
    if back.size and t.type in _OVERTAKING:
        text = (
            f'{back.size} messages were overtaken on the acoustic link, by up to '
            f'{-steps[back].min() * 1e-9:.3f} s'
        )
        found.append(Finding(Severity.OK, 'overtaken', t.topic, None, back.size, text))
    elif back.size:
        first = int(back[0])
        text = (
            f'stamps run backwards {back.size} times; first by {-steps[first] * 1e-9:.6f} s, '
            f'at most by {-steps[back].min() * 1e-9:.6f} s'
        )
        severity = Severity.SEVERE if t.regular else Severity.WARNING
        found.append(
            Finding(severity, 'backwards', t.topic, int(stamp_ns[first]), back.size, text)
        )
    same = np.flatnonzero((steps == 0) & (stamp_ns[1:] != 0))  # zeros are another finding
    if t.count >= _REGULAR_MOST and same.size > _STUCK_SHARE * steps.size:
        text = f'{same.size} of {t.count} messages have the stamp of the one before'
        when = int(stamp_ns[same[0]])
        found.append(Finding(Severity.SEVERE, 'repeated stamp', t.topic, when, same.size, text))
    elif same.size and t.regular:
        text = f'{same.size} messages have the stamp of the one before'
        when = int(stamp_ns[same[0]])
        found.append(Finding(Severity.WARNING, 'repeated stamp', t.topic, when, same.size, text))
    return found


def _against_log(t: TopicTimes, stamp_ns: Ints) -> list[Finding]:
    """Findings about jumps, drift and an impossible order between stamps and log times."""
    known = stamp_ns != 0
    stamp, log = stamp_ns[known], t.log_ns[known]
    if stamp.size < 2:
        return []
    delay = (log - stamp) * 1e-9
    middle = float(np.median(delay))
    if abs(middle) > OTHER_CLOCK_S:
        text = f'stamps and log times are {middle:.0f} s apart: two clocks'
        return [Finding(Severity.WARNING, 'other clock', t.topic, None, middle, text)]
    # A varying delay is normal for a topic of events, for example acoustic packets.
    found = _jumps(t, stamp, log, delay) if t.regular else []
    early = np.flatnonzero(delay < -FUTURE_S)
    if early.size:
        first = int(early[0])
        text = (
            f'{early.size} messages were logged before they were valid, up to {-delay.min():.3f} s'
        )
        found.append(
            Finding(Severity.WARNING, 'future', t.topic, int(stamp[first]), early.size, text)
        )
    if t.regular and not found:
        rise, drift = _drift(log, delay)
        if abs(rise) > DRIFT_S and abs(drift) > DRIFT:
            text = f'stamps drift against log time by {-drift:.2e} s per second'
            severity = Severity.WARNING
            if abs(drift) >= WRONG_CLOCK and abs(rise) >= WRONG_CLOCK_S:
                severity = Severity.SEVERE
                text += f' (limit {WRONG_CLOCK:g}): at {100.0 * (1.0 - drift):.3g} % of real time'
            found.append(Finding(severity, 'drift', t.topic, int(stamp[0]), -drift, text))
    if not found:
        text = f'stamps agree with log time; {middle:.3f} s from validity to log'
        found.append(Finding(Severity.OK, 'stamps', t.topic, None, middle, text))
    return found


def _far_from_log(t: TopicTimes, stamp_ns: Ints) -> list[Finding]:
    """Stamps of another clock where the recorder made log times out of stamps."""
    apart = np.abs(t.log_ns - stamp_ns) > int(OTHER_CLOCK_S * 1e9)
    count = int(np.count_nonzero(apart & (stamp_ns != 0)))
    if not count:
        return []
    first = int(np.flatnonzero(apart & (stamp_ns != 0))[0])
    text = f'{count} of {t.count} stamps are over an hour from the simulated time'
    return [Finding(Severity.SEVERE, 'other clock', t.topic, int(stamp_ns[first]), count, text)]


def _jumps(t: TopicTimes, stamp: Ints, log: Ints, delay: NDArray[np.float64]) -> list[Finding]:
    steps = np.diff(delay)
    at = [int(j) for j in np.flatnonzero(np.abs(steps) > JUMP_S) if _stays(log, delay, int(j))]
    if not at:
        return []
    by = -float(steps[at[0]])
    text = f'stamps jump {len(at)} times against log time; first by {by:.3f} s'
    return [Finding(Severity.SEVERE, 'jump', t.topic, int(stamp[at[0]]), by, text)]


def _stays(log: Ints, delay: NDArray[np.float64], at: int, reach: int = 20) -> bool:
    """Whether the delay differs after a step from that before it.

    Messages that waited for a transport come in a burst with one log time; what is logged a second
    later has the old delay again. A jump of the stamps stays.
    """
    before = np.median(delay[max(0, at - reach + 1) : at + 1])
    later = np.flatnonzero(log[at + 1 :] > log[at + 1] + int(JUMP_S * 1e9))[:reach]
    if not later.size:
        return False
    return bool(abs(np.median(delay[at + 1 + later]) - before) > JUMP_S)


def _drift(log_ns: Ints, delay: NDArray[np.float64]) -> tuple[float, float]:
    """Rise [s] of log time minus stamp, and its slope, between medians of first and last third."""
    third = len(delay) // 3
    seconds = (log_ns - log_ns[0]) * 1e-9
    rise = float(np.median(delay[-third:]) - np.median(delay[:third]))
    run = float(np.median(seconds[-third:]) - np.median(seconds[:third]))
    return rise, rise / run if run > 0.0 else 0.0
