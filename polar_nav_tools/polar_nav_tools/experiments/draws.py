"""Rows of experiments that are drawn at random: sizes, and the numbers of the rows wanted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from polar_nav_core.errors import ConfigError


@dataclass(frozen=True)
class Size:
    """A size between two, each power of ten as likely, and ``most`` where it would be larger.

    ``signed``: of either sign.
    """

    low: float
    high: float
    signed: bool = False
    most: float = math.inf

    def draw(self, rng: np.random.Generator) -> float:
        """Return one."""
        size = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        size = min(size, self.most)
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


def numbers_after(prefix: str, word: str) -> range:
    """Numbers of the rows that a word of ``--rows`` asks for: one, or from one to another.

    Raises
    ------
    ConfigError
        For a word that states none.
    """
    first, dash, last = word.removeprefix(prefix).partition('-')
    ends = (first, last) if dash else (first, first)
    if not all(end.isdecimal() for end in ends):
        raise ConfigError(f'--rows: {word!r} has no number; for example {prefix}7 or {prefix}1-50')
    numbers = range(int(ends[0]), int(ends[1]) + 1)
    if not numbers:
        raise ConfigError(f'--rows: {word!r} ends before it begins')
    return numbers
