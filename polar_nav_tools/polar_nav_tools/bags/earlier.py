"""metadata.yaml of a bag of several files: split, or gone on with after a recorder was killed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import rosbag2_metadata
from .contents import FileScan
from .errors import BagError
from .files import in_order
from .rosbag2_metadata import TopicSummary
from .scan import scan_file


def with_earlier_files(
    path: Path, metadata: Mapping[str, Any], known: Mapping[Path, Mapping[str, Any]]
) -> dict[str, Any]:
    """Metadata of a whole bag, from those of its newest file.

    Earlier files that are not among the known ones are read to their last whole chunk; one that
    cannot be read is left out.
    """
    all_files = in_order(path.parent.glob('*.mcap'))
    earlier = all_files[: all_files.index(path)]
    found = [known[other] if other in known else _metadata(other) for other in earlier]
    parts = [one for one in found if one is not None]
    return rosbag2_metadata.joined([*parts, metadata]) if parts else dict(metadata)


def _metadata(path: Path) -> dict[str, Any] | None:
    try:
        file = scan_file(path)
    except BagError:
        return None
    if file.first_ns is None or file.last_ns is None:
        return None
    return rosbag2_metadata.bag_metadata(path.name, _topics(file), file.first_ns, file.last_ns)


def _topics(file: FileScan) -> list[TopicSummary]:
    return [
        TopicSummary(
            channel.topic,
            channel.type,
            file.tallies[number].count if number in file.tallies else 0,
            channel.metadata.get('topic_type_hash', ''),
            encoding=channel.encoding,
        )
        for number, channel in file.channels.items()
    ]
