"""Receipts of a run of any length in bounded memory: what is older lies in columns (`spilled`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby, islice
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from .. import spilled
from .outputs import Receipt
from .receipts import FusedFixes, joined
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
        self._fused: list[FusedFixes] = []
        """Fixes behind all others whose receipts nobody has asked for."""
        self._waiting = 0
        self._blocks: dict[int, list[Receipt]] = {}
        self.extend(receipts)

    def append(self, receipt: Receipt) -> None:
        """Add one receipt."""
        self.extend((receipt,))

    def extend(self, receipts: Iterable[Receipt]) -> None:
        """Add receipts in their order."""
        rest = iter(receipts)
        while some := list(islice(rest, _MADE)):
            self._write_fused()
            self._new += some
            if len(self._new) > _KEPT:
                self._settle()

    def extend_fused(self, fixes: FusedFixes) -> None:
        """Add the receipts of fixes that were fused, which are written many at a time."""
        self._fused.append(fixes)
        self._waiting += len(fixes)
        if self._waiting >= _MADE:
            self._write_fused()

    def __len__(self) -> int:
        return len(self._rows) + len(self._new) + self._waiting

    def __iter__(self) -> Iterator[Receipt]:
        self._write_fused()
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
        self._write_fused()
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
        """Put all receipts into rows."""
        new, self._new = self._new, []
        if new:
            self._write({name: [getattr(r, name) for r in new] for name in _NAMES})
        self._write_fused()

    def _write_fused(self) -> None:
        """Put the receipts of fused fixes into rows, and all that came before."""
        if not self._fused:
            return
        waiting, self._fused, self._waiting = self._fused, [], 0
        self._settle()
        for _, group in groupby(waiting, key=lambda fused: fused.chosen):
            self._write(joined(list(group)).columns())

    def _write(self, columns: Mapping[str, Any]) -> None:
        """Append rows of these fields of receipts, each a column or one value for all."""
        texts = [reason.encode('utf-8', 'surrogatepass') for reason in columns['reason']]
        rows = np.zeros(len(texts), _ROW)
        for name, values in columns.items():
            if name in _WORDS:
                rows[name] = [self._number(word) for word in values]
            elif name != 'reason':
                rows[name] = values
        rows['reason'] = len(self._reasons) + np.cumsum([len(text) for text in texts])
        self._reasons.extend(np.frombuffer(b''.join(texts), np.uint8))
        self._rows.extend(rows)
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
