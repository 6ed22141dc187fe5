"""Request for fields and messages of a bag, and the tables of one pass over it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from .columns import Columns

Fields = Sequence[str | tuple[str, ...]]
"""Fields of one message; adjacent ones of one kind are read as a row, seconds and nanoseconds of a
time as nanoseconds."""


class Request(NamedTuple):
    """Request for fields of some topics, and for serialized messages of others."""

    wanted: Mapping[str, Fields]
    raw: Sequence[str] = ()


@dataclass
class Tables:
    """Result of one pass over a bag.

    Attributes
    ----------
    columns : dict of str to dict of str to ndarray
        By topic and field, N rows in the order of the bag; a tuple of k fields has the key of its
        first one, shape (N, k).
    payloads : dict of str to list of bytes
        Serialized messages, by topic.
    odd : dict of str to int
        Number of messages that the scanner left to be decoded one by one, by topic.
    """

    columns: dict[str, Columns] = field(default_factory=dict)
    payloads: dict[str, list[bytes]] = field(default_factory=dict)
    odd: dict[str, int] = field(default_factory=dict)


class ReadAhead(NamedTuple):
    """Tables read during the opening of a bag, and their request."""

    request: Request
    tables: Tables
