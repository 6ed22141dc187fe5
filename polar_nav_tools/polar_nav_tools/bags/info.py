"""Facts about a bag, for `./polar info`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .indexed import IndexedScan, read_times
from .opening import open_bag
from .reader import Bag


@dataclass(frozen=True)
class TopicInfo:
    """One topic.

    Attributes
    ----------
    name, type : str
        Fully qualified name and message type.
    count : int
        Messages that can be read.
    rate_hz : float or None
        Mean rate by log time; None with fewer than two messages or no time between them.
    first_ns, last_ns : int or None
        Oldest and newest log time; None without messages.
    """

    name: str
    type: str
    count: int
    rate_hz: float | None
    first_ns: int | None
    last_ns: int | None


@dataclass(frozen=True)
class BagInfo:
    """A bag at a glance.

    Attributes
    ----------
    path : str
        As given.
    files : tuple of str
        Names of the MCAP files.
    size_bytes, uncompressed_bytes : int
        On disk; message records after decompression.
    ignored_bytes : int
        Bytes that could not be read.
    compression : str
        ``zstd``, ``lz4``, ``none`` or several.
    library : str
        Library that wrote it.
    message_count : int
        Messages that can be read.
    start_ns, stop_ns : int
        Oldest and newest log time.
    duration_s : float
        Between them.
    topics : tuple of TopicInfo
        In order of name.
    nodes : dict of str to dict
        Package and version of each node, by /run_info.
    run_info : dict
        Description of the run by the recorder; empty for other recorders' bags.
    is_complete : bool
        Nothing is known to be missing.
    problems : tuple of str
        Missing or damaged parts, one sentence each.
    is_verified : bool
        Every byte was read and compared; False for a bag at an address, which is known by its
        index.
    """

    path: str
    files: tuple[str, ...]
    size_bytes: int
    uncompressed_bytes: int
    ignored_bytes: int
    compression: str
    library: str
    message_count: int
    start_ns: int
    stop_ns: int
    duration_s: float
    topics: tuple[TopicInfo, ...]
    nodes: dict[str, dict[str, str]]
    run_info: dict[str, Any]
    is_complete: bool
    problems: tuple[str, ...]
    is_verified: bool = True

    def to_dict(self) -> dict[str, Any]:
        """Facts as values for JSON."""
        return asdict(self)


def bag_info(source: str | Path | Bag) -> BagInfo:
    """Facts about a bag.

    Raises
    ------
    BagError
        If there is nothing to read (see `open_bag`).
    """
    bag = source if isinstance(source, Bag) else open_bag(source)
    for file in bag.files:
        if isinstance(file, IndexedScan):
            read_times(file)
    topics = tuple(_topic(bag, name) for name in bag.topics)
    start_ns = min(t.first_ns for t in topics if t.first_ns is not None)
    stop_ns = max(t.last_ns for t in topics if t.last_ns is not None)
    used = sorted({c or 'none' for f in bag.files for c in f.compressions})
    return BagInfo(
        path=str(bag.path),
        files=tuple(f.path.name for f in bag.files),
        size_bytes=sum(f.size for f in bag.files),
        uncompressed_bytes=sum(f.uncompressed_bytes for f in bag.files),
        ignored_bytes=bag.ignored_bytes,
        compression=', '.join(used),
        library=', '.join(dict.fromkeys(f.library for f in bag.files)),
        message_count=bag.message_count,
        start_ns=start_ns,
        stop_ns=stop_ns,
        duration_s=(stop_ns - start_ns) / 1e9,
        topics=topics,
        nodes={
            name: {k: str(described.get(k, '')) for k in ('package', 'version')}
            for name, described in sorted(bag.node_infos.items())
        },
        run_info=bag.run_info,
        is_complete=bag.is_complete,
        problems=tuple(bag.problems),
        is_verified=bag.is_verified,
    )


def _topic(bag: Bag, name: str) -> TopicInfo:
    topic = bag.topics[name]
    tallies = [t for t in bag.tallies(name) if t.count]
    first = min((t.first_ns for t in tallies), default=None)
    last = max((t.last_ns for t in tallies), default=None)
    rate = None
    if first is not None and last is not None and last > first:
        rate = (topic.count - 1) * 1e9 / (last - first)
    return TopicInfo(name, topic.type, topic.count, rate, first, last)
