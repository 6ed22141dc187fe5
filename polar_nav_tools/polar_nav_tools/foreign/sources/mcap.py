"""An MCAP bag as a source, in compiled passes where a topic is frequent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ...bags.errors import BagError
from ...bags.reader import Bag, Topic
from ...bags.schemas import starts_with_header
from ..definitions import Definitions
from ..mcap_records import log_times, topic_columns, topic_records
from .base import Rows, Timed

_FREQUENT = 0.1
"""Share of a bag's messages from which two compiled passes over all cost less than one that makes
an object of each message of the topic."""


class McapSource:
    """An MCAP bag, whole or damaged, through `polar_nav_tools.bags`."""

    kind = 'rosbag2, MCAP'

    def __init__(self, bag: Bag, definitions: Definitions | None = None) -> None:
        self._definitions = definitions or Definitions()
        self.path = bag.path
        self.bag = bag
        self.problems = bag.problems

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""
        return self.bag.topics

    def text(self, topic: str) -> str:
        """Return the ros2msg definition of a topic's type."""
        channel = self.bag.channel(topic)
        if channel.encoding != 'cdr':
            raise BagError(f'{self.path}: {topic} is encoded as {channel.encoding!r}, not as cdr')
        return channel.schema_text or self._definitions.text_of(channel.type)

    def records(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Yield (log time [ns], CDR bytes) in the order of the bag."""
        yield from topic_records(self.bag, topic)

    @property
    def run_info(self) -> dict[str, Any]:
        """What a recorder of this project wrote about the run; empty for others."""
        return self.bag.run_info

    def headed(self, topic: str) -> bool:
        """Return whether messages of a topic begin with a header; False where nobody knows."""
        try:
            return starts_with_header(self.text(topic))
        except BagError:
            return False

    def fronts(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, log time [ns], CDR bytes) of all messages, in the order of the bag."""
        yield from self.bag.messages()

    def columns(self, topic: str, fields: Sequence[str], rows: Rows) -> Timed | None:
        """Return log times and columns of a frequent topic; None when there is no quicker way."""
        if self.bag.topics[topic].count <= _FREQUENT * self.bag.message_count:
            return None
        columns = topic_columns(self.bag, topic, fields, rows)
        return None if columns is None else (log_times(self.bag, topic), columns)
