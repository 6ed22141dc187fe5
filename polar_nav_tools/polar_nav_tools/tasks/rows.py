"""Rows of finished tasks, as Parquet columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pyarrow as pa

DONE, STOPPED, FAILED = 'done', 'stopped', 'failed'
"""A run to its end; one whose filter stopped, which is a result; one that ended by an error."""

_TEXT = ('status', 'reason', 'where', 'made_by', 'cpu')
"""Columns of text of every row, beside `key`, `processor_s` and `content`."""
VARYING = ('processor_s', 'made_by', 'cpu')
"""Columns that say how a row was made: equal tasks may differ in them."""


@dataclass(frozen=True)
class Row:
    """Row of one task.

    Attributes
    ----------
    key : str
        Of the task (`keys.key_of`).
    status : str
        `DONE`, `STOPPED` or `FAILED`.
    names : mapping
        What the task is called: group, filter, seed, parameters that vary.
    metrics : mapping
        Numbers of its result.
    reason, where : str
        Why a filter stopped; the error of a failed task, and the last line of its traceback.
    processor_s : float
        Processor time of the result's filter [s].
    made_by, cpu : str
        Commit or version of the sources, and processor of the machine, that made it.
    content : bytes
        The whole result (`packing`); empty for a failed task.
    """

    key: str
    status: str
    names: Mapping[str, str | int | float] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)
    reason: str = ''
    where: str = ''
    processor_s: float = float('nan')
    made_by: str = ''
    cpu: str = ''
    content: bytes = b''


def table_of(rows: Sequence[Row]) -> pa.Table:
    """Table of rows: what every row has, then names, then metrics, the content at the end."""
    columns: dict[str, pa.Array] = {'key': pa.array([r.key for r in rows], pa.string())}
    for name in dict.fromkeys(n for r in rows for n in r.names):
        columns[_free(name, columns)] = pa.array([r.names.get(name) for r in rows])
    for name in _TEXT:
        columns[name] = pa.array([getattr(r, name) for r in rows], pa.string())
    columns['processor_s'] = pa.array([r.processor_s for r in rows], pa.float64())
    for name in dict.fromkeys(n for r in rows for n in r.metrics):
        values = [r.metrics.get(name) for r in rows]
        columns[_free(name, columns)] = pa.array(
            [None if v is None else float(v) for v in values], pa.float64()
        )
    columns['content'] = pa.array([r.content for r in rows], pa.binary())
    return pa.table(columns)


def _free(name: str, taken: Mapping[str, object]) -> str:
    """Name of a column; one that is taken gets an underscore."""
    fixed = ('key', *_TEXT, 'processor_s', 'content')
    while name in taken or name in fixed:
        name += '_'
    return name


def rows_of(table: pa.Table) -> list[Row]:
    """Rows of a table, without names and metrics, which only other readers need."""
    wanted = ('key', *_TEXT, 'processor_s', 'content')
    held = table.select(wanted).to_pylist()
    return [Row(**values) for values in held]


def joined(tables: Sequence[pa.Table]) -> pa.Table:
    """Rows of several tables; columns that one lacks are null there."""
    return pa.concat_tables(tables, promote_options='permissive')
