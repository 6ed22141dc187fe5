"""A rosbag2 folder in sqlite3 as a source: its messages are CDR as they stand."""

from __future__ import annotations

from pathlib import Path

from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag2 import Reader
from rosbags.typesys.store import Typestore

from ...bags.errors import BagError
from ..definitions import Definitions
from .rosbags import RosbagsSource


class SqliteSource(RosbagsSource):
    """A rosbag2 folder with .db3 files.

    Raises
    ------
    BagError
        When it has no metadata, or is damaged.
    """

    kind = 'rosbag2, sqlite3'
    advice = '`sqlite3 FILE.db3 .recover | sqlite3 NEW.db3` saves what SQLite still finds'

    def __init__(self, path: Path, definitions: Definitions | None = None) -> None:
        if not (path / 'metadata.yaml').is_file():
            raise BagError(
                f'{path}: a sqlite3 bag without metadata.yaml; `ros2 bag reindex` makes it anew'
            )
        super().__init__(path, definitions)

    def reader(self) -> Reader:
        """Return the library's reader, not opened."""
        return Reader(self.path)

    def understood(self, types: Typesdict) -> Typesdict:
        """Return the types as they are."""
        return types

    def cdr(self, data: bytes | memoryview, kind: str, store: Typestore) -> bytes:
        """Return the bytes as they are."""
        del kind, store
        return bytes(data)

    def front(self, data: bytes | memoryview) -> bytes:
        """Return the bytes as they are."""
        return bytes(data)
