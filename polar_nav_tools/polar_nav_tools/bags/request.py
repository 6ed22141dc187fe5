"""What is asked of a bag, and what one pass over it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from .columns import Columns

Fields = Sequence[str | tuple[str, ...]]
"""Fields of one message; several that stand side by side and are of one kind make a row, seconds
and nanoseconds of a time make nanoseconds."""


class Request(NamedTuple):
    """Fields of some topics, and topics whose messages are wanted as they are."""

    wanted: Mapping[str, Fields]
    raw: Sequence[str] = ()


@dataclass
class Tables:
    """What one pass over a bag gave.

    Attributes
    ----------
    columns : dict of str to dict of str to ndarray
        By topic and field, N rows in the order of the bag; a tuple of k fields stands under its
        first one, shape (N, k).
    payloads : dict of str to list of bytes
        Messages as they are, by topic.
    odd : dict of str to int
        Messages that the scanner left to be decoded otherwise.
    """

    columns: dict[str, Columns] = field(default_factory=dict)
    payloads: dict[str, list[bytes]] = field(default_factory=dict)
    odd: dict[str, int] = field(default_factory=dict)


class ReadAhead(NamedTuple):
    """What was read while a bag was opened, and what it was read for."""

    request: Request
    tables: Tables
