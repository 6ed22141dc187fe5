"""Sentences about missing parts of a file, from its scan."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from .contents import SEQUENCE_KEY, FileScan


def stamp_text(stamp_ns: int) -> str:
    """Text of a stamp as date and time, and in nanoseconds."""
    try:
        utc = datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec='milliseconds')
    except (OverflowError, ValueError, OSError):
        return f'{stamp_ns} ns'
    return f'{stamp_ns / 1e9:.3f} s ({utc.replace("+00:00", "Z")})'


def unfinished(file: FileScan) -> str:
    """Sentence about a recording that was not finished, with its last message."""
    if file.data_ended:
        return 'the index behind all messages is damaged or cut off'
    if file.last_ns is None:
        return 'the recording was not finished'
    return (
        f'the recording was not finished; the last message is of {stamp_text(file.last_ns)}, '
        'messages of the last moment before the recorder ended are missing'
    )


def sequence_gaps(file: FileScan) -> Iterator[str]:
    """Sentences about recorded messages missing in the file, by their sequence numbers."""
    for number, tally in file.tallies.items():
        channel = file.channels[number]
        if channel.metadata.get(SEQUENCE_KEY) == 'count' and tally.last_sequence > tally.count:
            missing = tally.last_sequence - tally.count
            yield f'{file.path.name}: {missing} messages of {channel.topic} are missing'
