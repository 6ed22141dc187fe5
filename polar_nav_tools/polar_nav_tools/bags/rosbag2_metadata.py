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


def joined(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Content of metadata.yaml of a bag of several files, from that of each."""
    topics: dict[str, dict[str, Any]] = {}
    for part in (parts[-1], *parts[:-1]):
        for one in part['topics_with_message_count']:
            known = topics.setdefault(one['topic_metadata']['name'], {**one, 'message_count': 0})
            known['message_count'] += one['message_count']
    files = [file for part in parts for file in part['files']]
    begins = [f['starting_time']['nanoseconds_since_epoch'] for f in files]
    ends = [b + f['duration']['nanoseconds'] for b, f in zip(begins, files, strict=True)]
    return {
        **parts[-1],
        'starting_time': {'nanoseconds_since_epoch': min(begins)},
        'duration': {'nanoseconds': max(ends) - min(begins)},
        'message_count': sum(part['message_count'] for part in parts),
        'topics_with_message_count': list(topics.values()),
        'relative_file_paths': [name for part in parts for name in part['relative_file_paths']],
        'files': files,
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
