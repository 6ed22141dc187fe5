"""metadata.yaml of a rosbag2 bag directory (version 9, as Jazzy writes and expects it).

Field names and types follow rosbag2_storage's `BagMetadata` YAML conversion.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from .qos import Qos

FILE_NAME = 'metadata.yaml'
ROOT_KEY = 'rosbag2_bagfile_information'
VERSION = 9


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a bag with its number of messages."""

    name: str
    type: str
    count: int
    type_hash: str = ''
    qos: Sequence[Qos] = field(default_factory=tuple)
    encoding: str = 'cdr'


def bag_metadata(
    file_name: str,
    topics: Sequence[TopicSummary],
    start_ns: int,
    stop_ns: int,
    custom: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Content of metadata.yaml below its root key, for one MCAP file.

    Compression is left empty: chunks are compressed by MCAP itself, rosbag2's fields are about
    compressing whole files or single messages.
    """
    count = sum(t.count for t in topics)
    start = {'nanoseconds_since_epoch': start_ns}
    duration = {'nanoseconds': max(0, stop_ns - start_ns)}
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        'duration': duration,
        'starting_time': start,
        'message_count': count,
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': t.name,
                    'type': t.type,
                    'serialization_format': t.encoding,
                    'offered_qos_profiles': [q.to_dict() for q in t.qos],
                    'type_description_hash': t.type_hash,
                },
                'message_count': t.count,
            }
            for t in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file_name],
        'files': [
            {
                'path': file_name,
                'starting_time': dict(start),
                'duration': dict(duration),
                'message_count': count,
            }
        ],
        'custom_data': dict(custom) if custom else None,
        'ros_distro': 'jazzy',
    }


def dump(metadata: Mapping[str, Any]) -> str:
    """Return YAML text."""
    return yaml.safe_dump(dict(metadata), sort_keys=False, default_flow_style=False)


def write(directory: Path, metadata: Mapping[str, Any]) -> None:
    """Write metadata.yaml of a bag, whole or not at all."""
    final = directory / FILE_NAME
    part = final.with_suffix('.yaml.part')
    with part.open('w', encoding='utf-8') as file:
        file.write(dump({ROOT_KEY: metadata}))
        file.flush()
        os.fsync(file.fileno())
    part.replace(final)
