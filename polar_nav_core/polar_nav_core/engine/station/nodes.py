"""Nodes of a recorded filter of station mode: a state each, what led to it, and the fix at it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from typing import Any, Self

import numpy as np

from ...kernels.station import state as ss

_CHUNK = 512
"""Nodes that are kept before they go to the file."""


def node_type(members: int) -> np.dtype[Any]:
    """Type of a node's record: fields by name, for a bank of so many members (B).

    Of the state: ``stamp``, ``begins`` (nothing before it bears on it), ``shown`` (its estimate is
    put out), ``x`` (B, 12), ``P``, ``S``, ``log_weight``, and ``flat``, ``loose``, ``counters`` of
    the bank. Of the way from the node before: ``Psi``, ``vector``, ``information``
    (kernels.station.tape). Of a fix, after the state: ``fix`` (its number, -1 for none),
    ``fused``, its row of outcomes ``outcome``, ``inflation`` (B,), ``H`` (B, 2, 12), ``K``
    (B, 12, 2), ``z`` (B, 2), ``S_z`` (B, 2, 2) with the inflation, ``J`` (B, 2, COMMON).
    """
    n, common = ss.N, ss.COMMON
    return np.dtype(
        [
            ('stamp', np.int64),
            ('begins', np.bool_),
            ('shown', np.bool_),
            ('x', np.float64, (members, n)),
            ('P', np.float64, (members, n, n)),
            ('S', np.float64, (members, n, common)),
            ('log_weight', np.float64, (members,)),
            ('flat', np.float64, (ss.FLAT,)),
            ('loose', np.float64, (ss.LOOSE,)),
            ('counters', np.int64, (ss.COUNTERS,)),
            ('Psi', np.float64, (members, n, n)),
            ('vector', np.float64, (members, n, 1 + common)),
            ('information', np.float64, (members, n, n)),
            ('fix', np.int64),
            ('fused', np.bool_),
            ('outcome', np.float64, (ss.OUTCOME,)),
            ('inflation', np.float64, (members,)),
            ('H', np.float64, (members, 2, n)),
            ('K', np.float64, (members, n, 2)),
            ('z', np.float64, (members, 2)),
            ('S_z', np.float64, (members, 2, 2)),
            ('J', np.float64, (members, 2, common)),
        ]
    )


class Nodes:
    """Nodes of one run in a temporary file: a day of them needs no more memory than a minute.

    Parameters
    ----------
    members : int
        Of the bank.
    """

    def __init__(self, members: int) -> None:
        self._type = node_type(members)
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the nodes
        self._waiting: list[Any] = []
        self._written = 0

    def new(self) -> np.ndarray:
        """Empty record of a node, shape ()."""
        record = np.zeros((), dtype=self._type)
        record['fix'] = -1
        return record

    def append(self, record: np.ndarray) -> None:
        """Append a node."""
        self._waiting.append(record)
        if len(self._waiting) >= _CHUNK:
            self._write()

    def _write(self) -> None:
        if self._waiting:
            self._file.seek(0, 2)
            np.array(self._waiting, dtype=self._type).tofile(self._file)
            self._written += len(self._waiting)
            self._waiting.clear()

    def __len__(self) -> int:
        return self._written + len(self._waiting)

    def backwards(self) -> Iterator[np.ndarray]:
        """The nodes from the last to the first."""
        self._write()
        end = self._written
        while end > 0:
            start = max(0, end - _CHUNK)
            self._file.seek(start * self._type.itemsize)
            chunk = np.fromfile(self._file, self._type, end - start)
            yield from chunk[::-1]
            end = start

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
