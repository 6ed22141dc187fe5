"""Fields of many topics, read in one pass over a bag or during its opening."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from .reader import Bag, blocks_of
from .reading import Reading
from .request import Fields, Request, Tables

Progress = Callable[[float], None]
"""Called with the share of the bag that was read."""


def read_tables(
    bag: Bag,
    wanted: Mapping[str, Fields],
    raw: Sequence[str] = (),
    *,
    progress: Progress | None = None,
) -> Tables:
    """Tables of fields of some topics, and serialized messages of others.

    Parameters
    ----------
    bag : Bag
        Tables read during its opening are returned, if they are of the same request.
    wanted : mapping of str to fields
        Topics and their fields; topics without a message have no columns.
    raw : sequence of str
        Topics to be read as serialized messages.
    progress : callable, optional

    Raises
    ------
    BagError
        If a topic is not CDR, a message is not of its type, or a field does not exist.
    """
    request = Request(wanted, raw)
    # Once: the caller may change the arrays, and their memory is not kept.
    ahead, bag.read_ahead = bag.read_ahead, None
    if ahead is not None and ahead.request == request:
        tables = ahead.tables
    else:
        del ahead
        tables = _passed(bag, request, progress)
    if progress is not None:
        progress(1.0)
    return tables


def _passed(bag: Bag, request: Request, progress: Progress | None) -> Tables:
    """Tables read in a separate pass over the bag."""
    reading = Reading(bag, request)
    total, before = sum(f.size for f in bag.files), 0
    for file in bag.files:
        numbers = reading.begin(file)
        every = max(1, len(file.blocks) // 200)
        for i, (content, usable, at) in enumerate(blocks_of(file, numbers)):
            reading.take(content, usable)
            if progress is not None and i % every == 0:
                progress((before + at) / total)
        before += file.size
    return reading.tables()
