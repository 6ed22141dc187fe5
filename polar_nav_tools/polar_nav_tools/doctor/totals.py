"""Findings about totals: received = sum of verdicts, sent = received + lost + in flight.

Beside them commands and saved states, which are few: each is read, as a replay does first of all.
In: a bag. Out: findings; none about topics that the bag does not have.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from polar_nav_ros.readers import command_from_msg, restore_from_msg
from polar_nav_ros.topics import RECEIPT, RESTORE, RX

from ..analysis.counts import topic_counts
from ..analysis.packets import delivery_of
from ..bags import Bag, BagError
from ..bags.arrays import load_receipts, load_truth
from ..bags.finding import Finding, Severity
from ..bags.run_folder import read_outcome
from ..replay.recorded import followers_of
from ..scoring import VerdictSeries, balances, count_verdicts

_READ: dict[str, Callable[[Any, int], object]] = {
    'polar_nav_msgs/msg/Command': command_from_msg,
    'polar_nav_msgs/msg/Restore': restore_from_msg,
}
"""Types of which a vehicle obeys every message, with what makes sense of one."""


def totals(bag: Bag) -> list[Finding]:
    """Findings about every total that follows from two numbers in the bag."""
    found: list[Finding] = []
    for vehicle in _followers(bag):
        for add_up in (_verdicts, _packets):
            try:
                found += add_up(bag, vehicle)
            except BagError as error:
                found.append(
                    Finding(Severity.SEVERE, 'unreadable', f'/{vehicle}', None, None, str(error))
                )
    for topic in bag.topics.values():
        if topic.count and topic.type == 'polar_nav_msgs/msg/VehicleTruth':
            found += _truth(bag, topic.name)
        if topic.count and topic.type in _READ:
            found += _obeyed(bag, topic.name, _READ[topic.type])
    return found + _counted(bag)


def _followers(bag: Bag) -> list[str]:
    """Vehicles with receipts, or with a description of a follower_node."""
    heard = {
        name.removesuffix(f'/{RECEIPT}').strip('/')
        for name, topic in bag.topics.items()
        if name.endswith(f'/{RECEIPT}') and topic.count and name.count('/') == 3
    }
    return sorted(heard | set(followers_of(bag)))


def _verdicts(bag: Bag, vehicle: str) -> list[Finding]:
    topic = f'/{vehicle}/{RX}'
    if topic not in bag.topics:
        return []
    counts = count_verdicts(VerdictSeries.of(load_receipts(bag, vehicle)))
    (balance,) = balances(counts, {RX: bag.topics[topic].count})
    verdicts = counts.by_topic.get(RX, {})
    parts = ', '.join(f'{name} {count}' for name, count in verdicts.items()) or 'none'
    text = f'{balance.received} packets received, {balance.verdicts} verdicts: {parts}'
    severity = Severity.OK if balance.balanced else Severity.SEVERE
    restored = bag.topics.get(f'/{vehicle}/{RESTORE}')
    if restored is not None and restored.count and not balance.balanced:
        severity = Severity.OK
        text += '; the follower was started again, and heard nothing meanwhile'
    what = 'verdicts'
    missing = balance.received - balance.verdicts
    return [Finding(severity, what, topic, None, missing if missing else balance.received, text)]


def _packets(bag: Bag, vehicle: str) -> list[Finding]:
    d = delivery_of(bag, vehicle)
    if d is None:
        return []
    text = (
        f'{d.sent} packets sent = {d.received} received + {d.lost} lost on the way + '
        f'{d.in_flight} in flight'
    )
    if not d.stated:
        text += ' (as long as the slowest took; the link states none)'
    found = [Finding(Severity.OK, 'packets', f'/{vehicle}/{RX}', None, d.sent, text)]
    if d.unsent:
        text = f'{d.unsent} received packets are not recorded as sent: the record has gaps'
        found.append(Finding(Severity.SEVERE, 'unsent', f'/{vehicle}/{RX}', None, d.unsent, text))
    return found


def _truth(bag: Bag, topic: str) -> list[Finding]:
    try:
        truth = load_truth(bag, topic.strip('/').split('/')[0])
    except BagError as error:
        return [Finding(Severity.SEVERE, 'unreadable', topic, None, None, str(error))]
    steps = np.diff(truth.sequence)
    gaps = np.flatnonzero(steps != 1)
    if not gaps.size:
        return []
    first = int(gaps[0])
    missing = int(np.sum(np.maximum(steps[gaps] - 1, 0)))
    text = f'{missing} numbers are missing in {gaps.size} places'
    return [
        Finding(
            Severity.WARNING, 'sequence', topic, int(truth.stamp_ns[first]), max(missing, 1), text
        )
    ]


def _obeyed(bag: Bag, topic: str, read: Callable[[Any, int], object]) -> list[Finding]:
    """Finding of messages that tell a vehicle what to do, and make no sense."""
    bad: list[tuple[int, str]] = []
    try:
        for log_ns, message in bag.read(topic):
            try:
                read(message, 0)
            except ValueError as error:
                bad.append((log_ns, str(error)))
    except BagError as error:
        return [Finding(Severity.SEVERE, 'unreadable', topic, None, None, str(error))]
    if not bad:
        return []
    when_ns, why = bad[0]
    text = f'{len(bad)} of {bag.topics[topic].count} messages make no sense: {why}'
    return [Finding(Severity.SEVERE, 'no sense', topic, when_ns, len(bad), text)]


def _counted(bag: Bag) -> list[Finding]:
    """Findings about the nodes' own counts of messages, for runs of `./polar demo`."""
    counts = topic_counts(bag, read_outcome(bag.path).get('counts', {}))
    found = [
        Finding(
            Severity.SEVERE,
            'lost',
            c.topic,
            None,
            (c.published or 0) - (c.recorded or 0),
            f'{c.published} published, {c.recorded or 0} recorded'
            + ('' if c.received is None else f', {c.received} received'),
        )
        for c in counts
        if not c.equal
    ]
    if counts and not found:
        text = f'published = recorded = received on all {len(counts)} topics that nodes counted'
        found.append(Finding(Severity.OK, 'counts', '', None, len(counts), text))
    return found
