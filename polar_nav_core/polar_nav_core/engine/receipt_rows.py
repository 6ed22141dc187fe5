"""Receipts of a run of any length in bounded memory: what is older lies in columns (`spilled`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from .. import spilled
from .outputs import Receipt
from .verdicts import Verdict

_KEPT = 4096
"""Receipts that are kept as objects: of a run of an hour mostly all."""
_MADE = 1024
"""Receipts that are made again at a time."""
_BLOCKS = 4
"""Of so many of them at most, those of the newest questions."""
_WORDS = ('topic', 'source', 'delay_handling')
"""Texts that are the same in many receipts."""
_ROW = np.dtype(
    [
        *((name, np.int64) for name in ('stamp_ns', 'verdict', 'reason')),
        *((name, np.int64) for name in _WORDS),
        *((f'{name}_ns', np.int64) for name in ('validity', 'transmit', 'receive', 'fused')),
        *((name, np.int64) for name in ('sequence', 'steps_rolled_back', 'dof', 'revision')),
        *((name, np.float64, 3) for name in ('innovation_G', 'innovation_variance_G')),
        *((name, np.float64) for name in ('nis', 'gate')),
    ]
)
"""Fields of `Receipt`: of a reason where it ends among all, of other texts a number."""
_NAMES = tuple(Receipt.__dataclass_fields__)


class Receipts(Sequence[Receipt]):
    """Sequence of receipts that grows; each is equal to the one that was added, to the bit.

    Parameters
    ----------
    receipts : iterable of Receipt, optional
        The first ones.
    """

    def __init__(self, receipts: Iterable[Receipt] = ()) -> None:
        self._rows, self._reasons = spilled.Rows(_ROW), spilled.Rows(np.uint8)
        self._words: dict[str, int] = {}
        self._new: list[Receipt] = []
        self._blocks: dict[int, list[Receipt]] = {}
        self.extend(receipts)

    def append(self, receipt: Receipt) -> None:
        """Add one receipt."""
        self.extend((receipt,))

    def extend(self, receipts: Iterable[Receipt]) -> None:
        """Add receipts in their order."""
        rest = iter(receipts)
        while some := list(islice(rest, _MADE)):
            self._new += some
            if len(self._new) > _KEPT:
                self._settle()

    def __len__(self) -> int:
        return len(self._rows) + len(self._new)

    def __iter__(self) -> Iterator[Receipt]:
        for number in range(-(-len(self._rows) // _MADE)):
            yield from self._made(number)
        yield from self._new

    @overload
    def __getitem__(self, index: int) -> Receipt: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Receipt, ...]: ...

    def __getitem__(self, index: int | slice) -> Receipt | tuple[Receipt, ...]:
        if isinstance(index, slice):
            return tuple(self[k] for k in range(*index.indices(len(self))))
        place = range(len(self))[index]
        rows = len(self._rows)
        return self._new[place - rows] if place >= rows else self._at(place)

    def __repr__(self) -> str:
        return repr(tuple(self))

    def columns(self, *names: str) -> dict[str, NDArray[Any]]:
        """Return fields of all receipts as columns, by their names, without making objects.

        Parameters
        ----------
        *names : str
            Fields of `Receipt`, but for its reason. Texts come as objects, verdicts as numbers.
        """
        self._settle()
        rows, words = self._rows.array(), np.array(list(self._words), dtype=np.object_)
        return {n: words[rows[n]] if n in _WORDS else rows[n].copy() for n in names}

    def _settle(self) -> None:
        """Put all objects into rows."""
        if not self._new:
            return
        texts = [r.reason.encode('utf-8', 'surrogatepass') for r in self._new]
        rows = np.zeros(len(self._new), _ROW)
        for name in _NAMES:
            if name in _WORDS:
                rows[name] = [self._number(getattr(r, name)) for r in self._new]
            elif name != 'reason':
                rows[name] = [getattr(r, name) for r in self._new]
        rows['reason'] = len(self._reasons) + np.cumsum([len(text) for text in texts])
        self._reasons.extend(np.frombuffer(b''.join(texts), np.uint8))
        self._rows.extend(rows)
        self._new = []
        self._blocks.clear()  # the last one was not full

    def _number(self, word: str) -> int:
        return self._words.setdefault(word, len(self._words))

    def _at(self, place: int) -> Receipt:
        """Receipt of a row; its neighbours are made, too, as they will be asked for."""
        number, rest = divmod(place, _MADE)
        if number not in self._blocks:
            if len(self._blocks) >= _BLOCKS:
                del self._blocks[next(iter(self._blocks))]
            self._blocks[number] = self._made(number)
        return self._blocks[number][rest]

    def _made(self, number: int) -> list[Receipt]:
        """Receipts of a block of rows."""
        every, start = self._rows.array(), number * _MADE
        rows = every[start : start + _MADE]
        begin = int(every['reason'][start - 1]) if start else 0
        ends = (rows['reason'] - begin).tolist()
        text = self._reasons.array()[begin : begin + ends[-1]].tobytes()
        words = list(self._words)
        columns: dict[str, Any] = {
            name: [words[k] for k in rows[name].tolist()] for name in _WORDS
        } | {
            'verdict': map(Verdict, rows['verdict'].tolist()),
            'reason': (
                text[i:j].decode('utf-8', 'surrogatepass')
                for i, j in zip([0, *ends], ends, strict=False)
            ),
            'innovation_G': rows['innovation_G'].copy(),
            'innovation_variance_G': rows['innovation_variance_G'].copy(),
        }
        listed = (columns[n] if n in columns else rows[n].tolist() for n in _NAMES)
        return [Receipt(*values) for values in zip(*listed, strict=True)]
