"""Topics of an MCAP file by its schema and channel records."""

from __future__ import annotations

from collections.abc import Callable

from . import chunks
from .chunks import Reader
from .contents import Channel


class Declarations:
    """Channels by number; the first declaration of a number counts.

    Parameters
    ----------
    problem : callable
        Called with a sentence if a number is declared as two things.
    """

    def __init__(self, problem: Callable[[str], None]) -> None:
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._problem = problem

    def take(self, opcode: int, body: bytes) -> None:
        """Store the declaration in a record's body; other kinds of records are ignored.

        Raises
        ------
        Damage
            If the record is damaged.
        """
        fields = Reader(body)
        if opcode == chunks.OP_SCHEMA:
            number, schema = fields.u16(), (fields.text(), fields.text(), fields.text())
            if self._schemas.setdefault(number, schema) != schema:
                self._problem(f'schema {number} is {self._schemas[number][0]} and something else')
        elif opcode == chunks.OP_CHANNEL:
            number, schema_number = fields.u16(), fields.u16()
            name, schema_encoding, text = self._schemas.get(schema_number, ('', '', ''))
            topic, encoding = fields.text(), fields.text()
            channel = Channel(topic, name, encoding, schema_encoding, text, fields.text_map())
            if self.channels.setdefault(number, channel) != channel:
                self._problem(f'channel {number} is {topic} and something else')
