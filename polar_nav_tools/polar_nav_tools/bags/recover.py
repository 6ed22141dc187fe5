"""Recovery of a broken bag into a readable one.

In: a bag that was cut off or damaged. Out: a new, finished bag with every readable message, its
bytes, times and numbers unchanged. A metadata record lists the missing parts, so that no score
made from it looks whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.rosbag2.metadata import parse_qos

from .contents import SEQUENCE_KEY
from .opening import Progress, open_bag
from .qos import Qos
from .reader import Bag
from .run_records import RECOVERY_RECORD
from .writer import BagWriter


@dataclass(frozen=True)
class Recovery:
    """Result of `recover`.

    Attributes
    ----------
    source, target : Path
        The broken bag and the new one.
    message_count : int
        Messages in the new bag.
    ignored_bytes : int
        Bytes of the broken one that could not be read.
    problems : tuple of str
        Problems of the broken bag; empty if there are none.
    """

    source: Path
    target: Path
    message_count: int
    ignored_bytes: int
    problems: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Result as values for JSON."""
        return {
            'path': str(self.target),
            'source': str(self.source),
            'message_count': self.message_count,
            'ignored_bytes': self.ignored_bytes,
            'problems': list(self.problems),
        }


def recover(path: str | Path, target: str | Path, progress: Progress | None = None) -> Recovery:
    """Result of copying the readable messages of a bag to a new one.

    Parameters
    ----------
    path : Path
        Bag directory or .mcap file, in any state.
    target : Path
        Directory of the new bag; must not exist.
    progress : callable, optional
        Called with the scanned share of the old one.

    Raises
    ------
    BagError
        If there is nothing to read, or the new bag cannot be written.
    """
    bag = open_bag(path, progress, whole=True)
    target = Path(target)
    with BagWriter(target, bag.run_info) as writer:
        for topic in bag.topics:
            add_topic(writer, bag, topic)
        for m in bag.records():
            writer.write(m.topic, m.data, m.log_time_ns, m.publish_time_ns, m.sequence)
        if bag.problems:
            writer.add_metadata(
                RECOVERY_RECORD,
                {
                    'source': str(path),
                    'ignored_bytes': str(bag.ignored_bytes),
                    'problems': '; '.join(bag.problems),
                },
            )
        writer.finish()
    return Recovery(bag.path, target, writer.message_count, bag.ignored_bytes, tuple(bag.problems))


def add_topic(writer: BagWriter, bag: Bag, topic: str) -> None:
    """Register a topic in a new bag as it is in another one."""
    channel = bag.channel(topic)
    writer.add_topic(
        topic,
        channel.type,
        offered=_offered(channel.metadata.get('offered_qos_profiles', '')),
        described=bag.definition(topic),
        encoding=channel.encoding,
        schema_encoding=channel.schema_encoding,
        counted=channel.metadata.get(SEQUENCE_KEY) == 'count',
    )


def _offered(text: str) -> list[Qos]:
    """Offered profiles of a channel; unreadable ones are left out, so that messages are kept."""
    try:
        profiles = parse_qos(text)
    except Exception:  # noqa: BLE001 - text from a damaged file
        return []
    return [
        Qos(
            reliability=p.reliability.name.lower(),
            durability=p.durability.name.lower(),
            history=p.history.name.lower(),
            depth=p.depth,
            liveliness=p.liveliness.name.lower(),
        )
        for p in profiles
    ]
