"""Messages that a replay published, in a temporary file: those of a day do not fit in memory."""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from polar_nav_core import spilled

_ROW = np.dtype([('topic', 'i4'), ('life', 'i4'), ('stamp_ns', 'i8'), ('size', 'i8')])
_READ = 1024
"""Messages that are read at a time."""


@dataclass(frozen=True)
class Output:
    """One message published in a replay."""

    topic: str
    stamp_ns: int
    data: bytes
    life: int = 0


class Outputs(Sequence[Output]):
    """Messages on full topic names in the order of publication, to be gone through in order."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix='polar-outputs-')  # noqa: SIM115 - lives as this
        weakref.finalize(self, self._file.close)
        self._rows = spilled.Rows(_ROW)
        self._names: list[str] = []
        self._numbers: dict[str, int] = {}

    def add(self, output: Output) -> None:
        """Append a message.

        Raises
        ------
        PolarNavError
            When the temporary folder has no room for it.
        """
        number = self._numbers.setdefault(output.topic, len(self._names))
        if number == len(self._names):
            self._names.append(output.topic)
        try:
            self._file.write(output.data)
        except OSError as error:
            raise spilled.no_room(len(output.data), error) from error
        self._rows.add((number, output.life, output.stamp_ns, len(output.data)))

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[Output]:
        self._file.flush()
        rows, at = self._rows.array(), 0
        for start in range(0, len(rows), _READ):
            some = rows[start : start + _READ].tolist()
            content = os.pread(self._file.fileno(), sum(size for *_, size in some), at)
            at += len(content)
            offset = 0
            for number, life, stamp_ns, size in some:
                data = content[offset : offset + size]
                yield Output(self._names[number], stamp_ns, data, life)
                offset += size

    @overload
    def __getitem__(self, index: int) -> Output: ...

    @overload
    def __getitem__(self, index: slice) -> list[Output]: ...

    def __getitem__(self, index: int | slice) -> Output | list[Output]:
        return list(self)[index]
