"""Contents of one MCAP file by a scan: topics, counts, blocks of messages, problems."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from . import chunks

SEQUENCE_KEY = 'polar_nav_sequence'
"""Channel metadata: message sequence numbers count the recorded messages from 1 without gaps."""


@dataclass(frozen=True)
class Channel:
    """A topic by its channel record in one file."""

    topic: str
    type: str
    encoding: str
    schema_encoding: str
    schema_text: str
    metadata: dict[str, str]


@dataclass
class Tally:
    """Count, sequence numbers and log times of one channel's messages."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    first_sequence: int = 0
    last_sequence: int = 0


class Block(NamedTuple):
    """A chunk or other stretch of the file with message records."""

    offset: int
    stored: int
    size: int
    usable: int
    compression: str
    channels: frozenset[int]
    crc: int

    def load(self, file: BinaryIO, *, checked: bool = True) -> bytes:
        """Return the uncompressed records; unchecked if the file is unchanged since the scan."""
        file.seek(self.offset)
        crc = self.crc if checked else 0
        return chunks.inflate(self.compression, file.read(self.stored), self.size, crc)


@dataclass
class FileScan:
    """Result of a scan: all data about one file except the messages themselves."""

    path: Path
    size: int
    modified_ns: int = 0  # time of the last change by the file system
    profile: str = ''
    library: str = ''
    channels: dict[int, Channel] = field(default_factory=dict)
    tallies: dict[int, Tally] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    compressions: set[str] = field(default_factory=set)
    unknown_compressions: set[str] = field(default_factory=set)
    uncompressed_bytes: int = 0
    ignored_bytes: int = 0
    data_ended: bool = False  # the record behind all messages was seen
    finished: bool = False
    problems: list[str] = field(default_factory=list)
    held: object = field(default=None, compare=False, repr=False)
    """What must live as long as the file is read."""

    @property
    def is_verified(self) -> bool:
        """Whether every byte was read and its checksum compared."""
        return True

    def announce(self, blocks: Sequence[Block]) -> None:
        """Be told which blocks are going to be read; nothing follows from it on a disk."""

    def load(self, block: Block, stream: BinaryIO, *, checked: bool) -> bytes:
        """Return the records of a block; unchecked if the file is unchanged since the scan."""
        return block.load(stream, checked=checked)

    def check_read(self, channels: Set[int]) -> None:
        """Be told that all blocks of some channels were read."""

    @property
    def message_count(self) -> int:
        """Number of readable messages."""
        return sum(t.count for t in self.tallies.values())

    @property
    def first_ns(self) -> int | None:
        """Oldest log time [ns], None without messages."""
        return min((t.first_ns for t in self.tallies.values() if t.count), default=None)

    @property
    def last_ns(self) -> int | None:
        """Newest log time [ns], None without messages."""
        return max((t.last_ns for t in self.tallies.values() if t.count), default=None)


def numbers_of(
    file: FileScan, channels: Mapping[str, Channel], topics: Collection[str] | None
) -> dict[int, str]:
    """Channel numbers of topics in a file; a topic's first type is the one that counts.

    ``channels`` has the first channel of each topic of the bag; all topics for None.
    """
    return {
        number: channel.topic
        for number, channel in file.channels.items()
        if (topics is None or channel.topic in topics)
        and channel.type == channels[channel.topic].type
    }
