"""Values that are drawn at random for the faults of a row, and the words for what was drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from .faults import Fault

TWO = 0.25
"""Share of rows with two faults."""


@dataclass(frozen=True)
class Size:
    """A size between two, each power of ten as likely; ``signed``: of either sign."""

    low: float
    high: float
    signed: bool = False

    def draw(self, rng: np.random.Generator) -> float:
        """Return one."""
        size = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        return -size if self.signed and rng.random() < 0.5 else size


@dataclass(frozen=True)
class Way(Size):
    """A vector of such a length in any direction."""

    def draw(self, rng: np.random.Generator) -> Any:  # noqa: ANN401 - another type than Size
        """Return one."""
        way = rng.standard_normal(3)
        return tuple((super().draw(rng) / np.linalg.norm(way) * way).tolist())


@dataclass(frozen=True)
class OneOf:
    """One of some values."""

    values: tuple[Any, ...]

    def draw(self, rng: np.random.Generator) -> Any:  # noqa: ANN401 - of any type
        """Return one."""
        return self.values[int(rng.integers(len(self.values)))]


F = TypeVar('F', bound=Fault)
Kind = tuple[type[F], Mapping[str, Size | OneOf]]
"""A kind of fault, and what of it is drawn."""


def fault_of(kinds: Sequence[Kind[F]], starts_s: OneOf, rng: np.random.Generator) -> F:
    """Return a fault of any of these kinds, each as likely, that begins at one of these times."""
    kind, drawn = kinds[int(rng.integers(len(kinds)))]
    values = {'start_s': starts_s.draw(rng)}
    values |= {name: of.draw(rng) for name, of in drawn.items()}
    return kind(**values)


_NOT_SAID = ('start_s', 'obvious')


def words(fault: Fault) -> str:
    """Kind and what of it is not as by default, as in ``DvlGain scale=0.0123 from 400 s``."""
    own = [
        f'{one.name}={_short(value)}'
        for one in fields(fault)
        if one.name not in _NOT_SAID
        and (value := getattr(fault, one.name)) not in (one.default, {})
    ]
    return ' '.join([type(fault).__name__, *own, f'from {fault.start_s:g} s'])


def _short(value: Any) -> str:  # noqa: ANN401 - of any type
    if isinstance(value, tuple):
        return f'({", ".join(map(_short, value))})'
    return f'{value:.3g}' if isinstance(value, float) else str(value)
