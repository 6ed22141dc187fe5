"""Sentences about what is missing or wrong in the files of a bag, before it is read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from .contents import Channel, FileScan, numbers_of
from .missing import sequence_gaps, unfinished
from .run_records import PHASE_KEY, RECOVERY_RECORD, json_or_none, run_records


def problems_of(files: Sequence[FileScan], channels: Mapping[str, Channel]) -> Iterator[str]:
    """Yield the problems of a bag's files; ``channels`` has the first one of each topic."""
    for file in files:
        for problem in file.problems:
            yield f'{file.path.name}: {problem}'
        if not file.finished:
            yield f'{file.path.name}: {unfinished(file)}'
        yield from sequence_gaps(file)
        yield from _other_types(file, channels)
    for last_ns, first_ns, name in holes(files):
        gap_s = (first_ns - last_ns) * 1e-9
        yield f'{name}: goes on {gap_s:.3f} s after the file before; nothing is between'
    yield from _recorded_losses(files, channels)
    for file in files:
        for name, record in file.metadata:
            if name == RECOVERY_RECORD:
                yield f'recovered from a broken bag: {record.get("problems", "")}'


def holes(files: Sequence[FileScan]) -> Iterator[tuple[int, int, str]]:
    """Yield log times [ns] between which nothing was recorded, and the file that goes on."""
    for before, after in pairwise(files):
        last_ns, first_ns = before.last_ns, after.first_ns
        if not before.finished and last_ns is not None and first_ns is not None:
            yield last_ns, first_ns, after.path.name


def _other_types(file: FileScan, channels: Mapping[str, Channel]) -> Iterator[str]:
    for number, channel in file.channels.items():
        first = channels[channel.topic].type
        if channel.type != first and number in file.tallies:
            count = file.tallies[number].count
            yield (
                f'{file.path.name}: {channel.topic} is a {first} and a {channel.type}; '
                f'{count} messages of the latter are ignored'
            )


def _recorded_losses(files: Sequence[FileScan], channels: Mapping[str, Channel]) -> Iterator[str]:
    """Problems by the recorder's own counts: missing messages, and losses that it reported.

    Each recorder counts what it wrote to its own file.
    """
    for file in files:
        info: dict[str, Any] = {}
        for name, record in run_records(file):
            for key, value in record.items():
                info[key] = json_or_none(value)
                if key != PHASE_KEY and value != 'null' and info[key] is None:
                    yield f'{key} in a {name} record is not JSON'
        recording = info.get('recording')
        counted = recording.get('topics') if isinstance(recording, dict) else None
        if isinstance(counted, dict):
            yield from _losses(file, channels, counted)


def _losses(
    file: FileScan, channels: Mapping[str, Channel], counted: dict[str, Any]
) -> Iterator[str]:
    there: Counter[str] = Counter()
    for number, topic in numbers_of(file, channels, None).items():
        there[topic] += file.tallies[number].count if number in file.tallies else 0
    for name, facts in counted.items():
        if not isinstance(facts, dict):
            continue
        if facts.get('count') != there[name]:
            yield (
                f'{name}: the recorder wrote {facts.get("count")} messages, '
                f'{there[name]} are there'
            )
        if facts.get('lost'):
            yield f'{name}: {facts["lost"]} messages were lost on the way to the recorder'
