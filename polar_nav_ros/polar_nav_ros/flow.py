"""Whether the truth may go on, and which nodes lag behind, from what nodes acknowledge.

Every node acknowledges how many messages it has taken and published on each topic (LockstepAck). A
node acknowledges after a callback took its messages and published all they led to, so once a node
has taken everything that was published to it, its own published counts are final. The graph has no
loop that starts without the truth; so when every taken count equals the sum of the published
counts of its topic, nothing is under way. Nothing is lost as long as queues are deeper than a
window is long.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol


class Ack(Protocol):
    """The fields of polar_nav_msgs/LockstepAck that are read here."""

    node: str
    published_topics: Sequence[str]
    published_counts: Sequence[int]
    published_matched: Sequence[int]
    taken_topics: Sequence[str]
    taken_counts: Sequence[int]
    taken_matched: Sequence[int]


class Flow:
    """State of the graph according to the acknowledgements of its nodes.

    Parameters
    ----------
    expected : iterable of str
        Fully qualified names of the nodes that take part, the truth node not among them.
    """

    def __init__(self, expected: Iterable[str]) -> None:
        self._published: dict[str, dict[str, int]] = {name: {} for name in expected}
        self._taken: dict[str, dict[str, int]] = {name: {} for name in self._published}
        self._pub_matched: dict[str, dict[str, int]] = {name: {} for name in self._published}
        self._sub_matched: dict[str, dict[str, int]] = {name: {} for name in self._published}
        self._heard: set[str] = set()
        self._own: dict[str, int] = {}
        self._own_matched: dict[str, int] = {}

    @property
    def heard(self) -> frozenset[str]:
        """Expected nodes that have acknowledged at least once."""
        return frozenset(self._heard)

    def update(self, ack: Ack) -> bool:
        """Store one acknowledgement; False if its node is not an expected one."""
        if ack.node not in self._taken:
            return False
        self._heard.add(ack.node)
        self._published[ack.node] = dict(
            zip(ack.published_topics, map(int, ack.published_counts), strict=True)
        )
        self._pub_matched[ack.node] = dict(
            zip(ack.published_topics, map(int, ack.published_matched), strict=True)
        )
        self._taken[ack.node] = dict(
            zip(ack.taken_topics, map(int, ack.taken_counts), strict=True)
        )
        self._sub_matched[ack.node] = dict(
            zip(ack.taken_topics, map(int, ack.taken_matched), strict=True)
        )
        return True

    def own(self, published: Mapping[str, int], matched: Mapping[str, int] | None = None) -> None:
        """Store what the truth node has published so far, and the readers of each topic."""
        self._own = dict(published)
        if matched is not None:
            self._own_matched = dict(matched)

    def missing(self) -> list[str]:
        """Sentences about missing nodes and connections; empty if the graph is complete."""
        absent = [
            f'{name} has not been heard' for name in sorted(self._taken) if name not in self._heard
        ]
        if absent:
            return absent
        out = []
        for topic, subscribers in self._subscribers().items():
            publishers = self._publishers(topic)
            for node in subscribers:
                have = self._sub_matched[node].get(topic, 0)
                if have < len(publishers):
                    out.append(f'{node} sees {have} of {len(publishers)} publishers of {topic}')
            for node in publishers:
                have = (self._own_matched if node == '' else self._pub_matched[node]).get(topic, 0)
                if have < len(subscribers):
                    who = node or 'the truth'
                    out.append(f'{who} sees {have} of {len(subscribers)} subscribers of {topic}')
        return out

    def ready(self) -> bool:
        """Whether every expected node is there and all publishers and subscribers are matched."""
        return not self.missing()

    def laggards(self) -> dict[str, dict[str, tuple[int, int]]]:
        """Nodes with messages still to receive: node -> topic -> (taken, published)."""
        total = self.published()
        behind: dict[str, dict[str, tuple[int, int]]] = {}
        for node, taken in self._taken.items():
            for topic, count in taken.items():
                expected = total.get(topic, 0)
                if count != expected:
                    behind.setdefault(node, {})[topic] = (count, expected)
        return behind

    def lag_s(self, elapsed_s: float) -> float:
        """Time that the slowest subscriber is behind [s], from counts and mean rates of topics.

        One message counts as under way: of a rare topic it would be seconds.

        Parameters
        ----------
        elapsed_s : float
            Time in which the published messages were [s].
        """
        return max(
            (
                (sent - taken - 1) / sent * elapsed_s
                for topics in self.laggards().values()
                for taken, sent in topics.values()
                if sent > taken
            ),
            default=0.0,
        )

    def settled(self) -> bool:
        """Whether all subscribers have received all published messages."""
        total = self.published()
        get = total.get
        return all(
            count == get(topic, 0)
            for taken in self._taken.values()
            for topic, count in taken.items()
        )

    def published(self) -> dict[str, int]:
        """Number of messages published so far per topic, over all nodes."""
        total = dict(self._own)
        for counts in self._published.values():
            for topic, count in counts.items():
                total[topic] = total.get(topic, 0) + count
        return total

    def taken(self) -> dict[str, dict[str, int]]:
        """Number of messages received so far: node -> topic -> count."""
        return {node: dict(counts) for node, counts in self._taken.items()}

    def _subscribers(self) -> dict[str, list[str]]:
        out: dict[str, list[str]] = {}
        for node, counts in self._taken.items():
            for topic in counts:
                out.setdefault(topic, []).append(node)
        return out

    def _publishers(self, topic: str) -> list[str]:
        nodes = [node for node, counts in self._published.items() if topic in counts]
        return ([''] if topic in self._own else []) + nodes
