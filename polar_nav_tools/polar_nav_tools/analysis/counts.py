"""Numbers of messages per topic: published, recorded, received."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..bags import Bag
from ..report.input import TopicCount
from ..scoring import Column, Table

RECORDER = '/recorder_node'


def topic_counts(bag: Bag, counted: Mapping[str, Any]) -> tuple[TopicCount, ...]:
    """Numbers of published, recorded and received messages of each topic.

    Parameters
    ----------
    bag : Bag
        Has the recorded ones.
    counted : mapping
        Node -> 'published' and 'taken' -> topic -> count, as the nodes said at their end. Topics
        that no node counted (diagnostics and the like, which are not part of the experiment) are
        left out.
    """
    published: dict[str, int] = {}
    taken: dict[str, list[int]] = {}
    for node, counts in counted.items():
        for topic, count in counts.get('published', {}).items():
            published[topic] = published.get(topic, 0) + int(count)
        if node != RECORDER:  # what it took stands in the bag
            for topic, count in counts.get('taken', {}).items():
                taken.setdefault(topic, []).append(int(count))
    rows = []
    for topic in sorted(published):
        recorded = bag.topics[topic].count if topic in bag.topics else None
        rows.append(
            TopicCount(
                topic, published[topic], recorded, _worst(taken.get(topic), published[topic])
            )
        )
    return tuple(rows)


def _worst(counts: Sequence[int] | None, expected: int) -> int | None:
    """Count of the subscriber that differs most from the published number."""
    return max(counts, key=lambda n: abs(n - expected)) if counts else None


def topic_table(counts: Sequence[TopicCount]) -> Table:
    """Table of published, recorded and received messages."""
    columns = (
        Column('topic', 'topic'),
        Column('published', 'published'),
        Column('recorded', 'recorded'),
        Column('received', 'received', doc='by the subscriber that is furthest off'),
        Column('equal', 'equal'),
    )
    rows = tuple(
        {
            'topic': c.topic,
            'published': c.published,
            'recorded': c.recorded,
            'received': c.received,
            'equal': c.equal,
        }
        for c in counts
    )
    return Table('Messages', columns, rows)
