"""Rows on disk: each written as it comes, none lost when a process is killed, none twice.

``rows.parquet`` holds the rows of a finished run; until then each row, or the few that came
together, stands in a file of its own in ``rows.parts``. A file appears under its name only once it
is complete. Whoever wants it otherwise says so: ``scores`` has ``scores.parquet``.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from polar_nav_core.errors import ConfigError

from .rows import FAILED, Row, joined, rows_of, table_of

NAME = 'rows'
"""Name of the file of rows, without its ending."""
_MOST_PARTS = 500
"""Files of parts from which on they are made one: opening a million would take hours."""


@dataclass
class Store:
    """Rows in a folder, newest of each key; `opened` makes one.

    Attributes
    ----------
    folder : Path
    name : str
        Of the file of rows, without its ending.
    rows : dict
        By key.
    damaged : list of Path
        Files that cannot be read, left aside; their tasks are done again.
    """

    folder: Path
    name: str = NAME
    rows: dict[str, Row] = field(default_factory=dict)
    damaged: list[Path] = field(default_factory=list)
    _parts: list[Path] = field(default_factory=list)

    @property
    def path(self) -> Path:
        """File of the rows of a finished run."""
        return self.folder / f'{self.name}.parquet'

    @property
    def parts(self) -> Path:
        """Folder of the rows until then."""
        return self.folder / f'{self.name}.parts'

    def add(self, rows: Sequence[Row]) -> None:
        """Add rows; they are on disk when this returns."""
        if not rows:
            return
        self._write_part(table_of(rows))
        for row in rows:
            self.rows[row.key] = row
        if len(self._parts) >= _MOST_PARTS:
            self._merge_parts()

    def finish(self, order: Sequence[str]) -> Path:
        """Write ``rows.parquet``: rows of these keys in this order, then all others by key."""
        path = self.path
        files = [path, *self._parts]
        table = _newest(joined([t for _, t in self._read(files)]))
        rank = {key: i for i, key in enumerate(order)}
        keys = table['key'].to_pylist()
        rows = sorted(range(len(keys)), key=lambda i: (rank.get(keys[i], len(rank)), keys[i]))
        _write(table.take(rows), path)
        self._forget(self._parts)
        return path

    def empty(self) -> None:
        """Forget all rows."""
        self._forget([self.path, *self._parts])
        self.rows.clear()

    def load(self) -> None:
        """Read the rows that are there."""
        self._parts = sorted(self.parts.glob('*.parquet'))
        for _, table in self._read([self.path, *self._parts]):
            for row in rows_of(table):
                self.rows[row.key] = row

    @property
    def is_unfinished(self) -> bool:
        """Whether there are rows of a run that did not come to its end."""
        return bool(self._parts)

    def _write_part(self, table: pa.Table) -> None:
        self.parts.mkdir(exist_ok=True)
        number = int(self._parts[-1].stem) + 1 if self._parts else 1
        path = self.parts / f'{number:09d}.parquet'
        _write(table, path)
        self._parts.append(path)

    def _merge_parts(self) -> None:
        """Make the parts one; a kill on the way leaves rows twice, of which the newest counts."""
        held = list(self._parts)
        self._write_part(_newest(joined([t for _, t in self._read(held)])))
        self._forget([p for p in held if p not in self.damaged])

    def _read(self, files: Iterable[Path]) -> Iterator[tuple[Path, pa.Table]]:
        for path in files:
            try:
                yield path, pq.ParquetFile(path).read()
            except FileNotFoundError:
                continue
            except (pa.ArrowException, OSError):
                if path not in self.damaged:
                    self.damaged.append(path)

    def _forget(self, files: Iterable[Path]) -> None:
        gone = set(files)
        for path in gone:
            path.unlink(missing_ok=True)
        self._parts = [path for path in self._parts if path not in gone]
        if self.parts.is_dir() and not any(self.parts.iterdir()):
            self.parts.rmdir()


@contextmanager
def opened(folder: Path, name: str = NAME) -> Iterator[Store]:
    """Rows of a folder, which is made if need be; no other process may write there meanwhile.

    Raises
    ------
    ConfigError
        If one does.
    """
    folder.mkdir(parents=True, exist_ok=True)
    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(f'{folder}: another run writes its rows there') from error
        store = Store(folder, name)
        for half in store.parts.glob('*.tmp'):
            half.unlink()
        store.load()
        yield store
    finally:
        os.close(held)


def begin(store: Store, *, resume: bool) -> None:
    """Keep the rows of a folder to go on with them, or begin without any.

    Raises
    ------
    ConfigError
        If rows of an interrupted run would be lost.
    """
    if resume:
        return
    if store.is_unfinished:
        raise ConfigError(
            f'{store.folder} has {len(store.rows)} runs of one that was interrupted: go on with'
            f' --resume, or delete {store.parts}'
        )
    store.empty()


def _write(table: pa.Table, path: Path) -> None:
    """Write a file that is complete or not there; whoever is killed on the way leaves a .tmp."""
    half = path.with_suffix('.tmp')
    pq.write_table(table, half, compression='zstd')
    half.replace(path)


def _newest(table: pa.Table) -> pa.Table:
    """The last row of each key; of a done and a later failed one the done one."""
    last: dict[str, int] = {}
    status = table['status'].to_pylist()
    for i, key in enumerate(table['key'].to_pylist()):
        if key not in last or status[i] != FAILED or status[last[key]] == FAILED:
            last[key] = i
    return table.take(sorted(last.values()))
