"""Sentences on what should be in a file and is not, from its scan."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from .contents import FileScan
from .writer import SEQUENCE_KEY


def stamp_text(stamp_ns: int) -> str:
    """Return a stamp as people and as programs read it."""
    try:
        utc = datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec='milliseconds')
    except (OverflowError, ValueError, OSError):
        return f'{stamp_ns} ns'
    return f'{stamp_ns / 1e9:.3f} s ({utc.replace("+00:00", "Z")})'


def unfinished(file: FileScan) -> str:
    """Say how far a recording came that was not finished."""
    if file.data_ended:
        return 'the index behind all messages is damaged or cut off'
    if file.last_ns is None:
        return 'the recording was not finished'
    return (
        f'the recording was not finished; the last message is of {stamp_text(file.last_ns)}, '
        'what came in the last moment before the recorder ended is missing'
    )


def sequence_gaps(file: FileScan) -> Iterator[str]:
    """Messages that were recorded but are not in the file any more, by their numbers."""
    for number, tally in file.tallies.items():
        channel = file.channels[number]
        if channel.metadata.get(SEQUENCE_KEY) == 'count' and tally.last_sequence > tally.count:
            missing = tally.last_sequence - tally.count
            yield f'{file.path.name}: {missing} messages of {channel.topic} are missing'
