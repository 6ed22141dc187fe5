"""Reads the quantities of one role from one topic, with their stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError

from ...bags.columns import stamps
from ...bags.errors import BagError
from ..mapping import Stream
from ..sources import Source, Stamps, field_paths, read_table, require
from .layouts import LAYOUTS, REQUIRED

_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')


@dataclass(frozen=True)
class Rows:
    """Quantities of a topic, in the order of the bag.

    Attributes
    ----------
    topic, type : str
    stamps_ns : (n,) array
        Times of validity, offset included.
    log_ns : (n,) array
        When each was recorded.
    values : dict of str to (n,) or (n, k) array
        By quantity; those the messages do not have are left out.
    constants : mapping
        Constants of the message type.
    """

    topic: str
    type: str
    stamps_ns: Stamps
    log_ns: Stamps
    values: dict[str, NDArray[Any]]
    constants: Mapping[str, Any]

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.stamps_ns)

    def floats(self, name: str) -> NDArray[np.float64] | None:
        """Return a quantity as float64, or None where the messages do not have it."""
        found = self.values.get(name)
        return None if found is None else np.asarray(found, dtype=np.float64)


def read_rows(source: Source, stream: Stream, role: str) -> Rows:
    """Read what a role needs from a topic.

    Raises
    ------
    BagError
        When the topic has no message or one cannot be decoded.
    ConfigError
        When the type has no adapter and ``fields`` does not say where the quantities stand.
    """
    kind = require(source, stream.topic).type
    layout = dict(LAYOUTS[role].get(kind, {}))
    known = set(LAYOUTS_NAMES[role])
    for name, paths in stream.fields.items():
        if name != 'stamp' and name not in known:
            raise ConfigError(
                f'{stream.topic}: fields: unknown quantity {name}; for {role} there are '
                f'{", ".join(sorted(known))} and stamp'
            )
        layout[name] = tuple(paths) if isinstance(paths, list) else (str(paths),)
    there = field_paths(source, stream.topic)
    for name in stream.fields:
        missing = [p for p in layout[name] if p not in there and (name, p) != ('stamp', p)]
        if missing:
            raise ConfigError(_no_field(stream.topic, kind, missing[0], there))
    layout = {n: p for n, p in layout.items() if n == 'stamp' or all(q in there for q in p)}
    if not any(all(q in layout for q in group) for group in REQUIRED[role]):
        raise ConfigError(
            f'{source.path}: {stream.topic}: {kind} has no adapter for {role}; give `fields` '
            f'with {" or ".join(" and ".join(g) for g in REQUIRED[role])}. '
            f'It has {_listed(there)}'
        )
    own = layout.pop('stamp', None)
    timed = _stamp_paths(stream, kind, own, there)
    wanted = list(dict.fromkeys([*timed, *(q for paths in layout.values() for q in paths)]))
    several = [paths for paths in layout.values() if len(paths) > 1]
    table = read_table(source, stream.topic, wanted or [there[0]], several)
    values = {n: _stacked(table.columns, p) for n, p in layout.items()}
    when = _times(table.columns, timed, table.log_ns) + stream.offset_ns
    return Rows(stream.topic, kind, when, table.log_ns, values, table.constants)


def _names(role: str) -> set[str]:
    named = {n for layout in LAYOUTS[role].values() for n in layout}
    return named | {q for group in REQUIRED[role] for q in group}


LAYOUTS_NAMES = {role: _names(role) for role in LAYOUTS}


def _stamp_paths(
    stream: Stream, kind: str, own: tuple[str, ...] | None, there: tuple[str, ...]
) -> tuple[str, ...]:
    if stream.stamp == 'log':
        return ()
    if own is not None:
        path = own[0]
        pair = (f'{path}.sec', f'{path}.nanosec')
        if all(p in there for p in pair):
            return pair
        if path in there:
            return (path,)
        raise ConfigError(_no_field(stream.topic, kind, path, there))
    if not all(p in there for p in _STAMP):
        raise ConfigError(
            f'{stream.topic}: {kind} has no header: give `stamp: log` for the log time, or '
            '`fields: {stamp: PATH}`'
        )
    return _STAMP


def _times(columns: Mapping[str, NDArray[Any]], paths: tuple[str, ...], log_ns: Stamps) -> Stamps:
    if not paths:
        return log_ns.copy()
    if len(paths) == 2:
        return stamps(dict(columns), paths[0].rpartition('.')[0])
    value = columns[paths[0]]
    if value.dtype.kind == 'f':  # seconds; good to 0.24 us at epoch seconds
        if not np.isfinite(value).all():
            raise BagError(f'field {paths[0]} is not a time in every message')
        return np.asarray(np.round(value * 1e9), dtype=np.int64)
    return value.astype(np.int64)  # whole nanoseconds


def _stacked(columns: Mapping[str, NDArray[Any]], paths: tuple[str, ...]) -> NDArray[Any]:
    first = columns[paths[0]]
    if len(paths) == 1 or first.ndim > 1:  # the latter are side by side in the messages
        return first
    return np.column_stack([columns[p] for p in paths])


def _no_field(topic: str, kind: str, path: str, there: tuple[str, ...]) -> str:
    return f'{topic}: fields: {kind} has no field {path}; it has {_listed(there)}'


def _listed(names: tuple[str, ...]) -> str:
    shown = ', '.join(names[:24])
    return shown if len(names) <= 24 else f'{shown} and {len(names) - 24} more'
