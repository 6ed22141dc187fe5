"""Quantities of one role out of messages: where they stand, and rows of numbers of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import ConfigError

from .layouts import LAYOUTS, REQUIRED, Paths
from .mapping import Stream

Stamps = NDArray[np.int64]
_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
_SHOWN = 24


@dataclass(frozen=True)
class Rows:
    """Quantities of a topic, in the order of the messages.

    Attributes
    ----------
    topic, type : str
    stamps_ns : (n,) array
        Times of validity, offset included.
    log_ns : (n,) array
        When each was recorded, or arrived.
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


class Places(NamedTuple):
    """Where the quantities of a role stand in the messages of a topic.

    Attributes
    ----------
    quantities : dict of str to paths
    stamp : tuple of str
        Seconds and nanoseconds, or one field; empty for the time of arrival.
    """

    quantities: dict[str, Paths]
    stamp: Paths


def places_of(stream: Stream, role: str, kind: str, there: Collection[str], where: str) -> Places:
    """Return where the quantities of a role stand in messages of a type.

    Parameters
    ----------
    stream : Stream
        Topic with the fields that its mapping names.
    role : str
        One of `LAYOUTS`.
    kind : str
        Message type.
    there : collection of str
        Paths that its messages have.
    where : str
        Beginning of sentences: file, node.

    Raises
    ------
    ConfigError
        When the type has no adapter and ``fields`` does not say where the quantities stand.
    """
    layout = dict(LAYOUTS[role].get(kind, {}))
    known = LAYOUTS_NAMES[role]
    for name, paths in stream.fields.items():
        if name != 'stamp' and name not in known:
            raise ConfigError(
                f'{stream.topic}: fields: unknown quantity {name}; for {role} there are '
                f'{", ".join(sorted(known))} and stamp'
            )
        layout[name] = tuple(paths) if isinstance(paths, list) else (str(paths),)
    for name in stream.fields:
        missing = [p for p in layout[name] if p not in there and (name, p) != ('stamp', p)]
        if missing:
            raise ConfigError(_no_field(stream.topic, kind, missing[0], there))
    layout = {n: p for n, p in layout.items() if n == 'stamp' or all(q in there for q in p)}
    if not any(all(q in layout for q in group) for group in REQUIRED[role]):
        raise ConfigError(
            f'{where}: {stream.topic}: {kind} has no adapter for {role}; give `fields` '
            f'with {" or ".join(" and ".join(g) for g in REQUIRED[role])}. '
            f'It has {_listed(there)}'
        )
    own = layout.pop('receive_time', None)  # of a packet
    own = layout.pop('stamp', None) or own
    return Places(layout, _stamp_paths(stream, kind, own, there))


def _names(role: str) -> frozenset[str]:
    named = {n for layout in LAYOUTS[role].values() for n in layout}
    return frozenset(named | {q for group in REQUIRED[role] for q in group})


LAYOUTS_NAMES = {role: _names(role) for role in LAYOUTS}


def _stamp_paths(
    stream: Stream, kind: str, own: Paths | None, there: Collection[str]
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


def _no_field(topic: str, kind: str, path: str, there: Collection[str]) -> str:
    return f'{topic}: fields: {kind} has no field {path}; it has {_listed(there)}'


def _listed(there: Collection[str]) -> str:
    names = list(there)
    shown = ', '.join(names[:_SHOWN])
    return shown if len(names) <= _SHOWN else f'{shown} and {len(names) - _SHOWN} more'
