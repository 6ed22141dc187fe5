"""Rows drawn at random, and the words for what was drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

import numpy as np

from ..draws import OneOf, Size
from .culprits import DEPTH, DVL, FIXES, HEADING, IMU, MODEL
from .faults import Fault
from .row import Row
from .scenes import Scene

ANYBODY = (FIXES, DVL, DEPTH, IMU, HEADING, MODEL)
"""Nobody is named as the culprit: any report is right."""
TWO = 0.25
"""Share of rows with two faults."""


F = TypeVar('F', bound=Fault)
Kind = tuple[type[F], Mapping[str, Size | OneOf]]
"""A kind of fault, and what of it is drawn."""


@dataclass(frozen=True)
class Draw(Generic[F]):
    """What the random rows of a mode are drawn from.

    Attributes
    ----------
    prefix : str
        Of the names of its rows.
    scenes : mapping of str to Scene
    kinds : sequence
        Kinds of faults, each as likely as the other.
    starts_s : OneOf
        When a fault begins, where its kind does not say.
    both : callable
        Two faults as one.
    """

    prefix: str
    scenes: Mapping[str, Scene]
    kinds: Sequence[Kind[F]]
    starts_s: OneOf
    both: Callable[[F, F], F]

    def row(self, number: int) -> Row:
        """Return the row of a number, the same wherever it is drawn."""
        rng = np.random.default_rng(number)
        name = OneOf(tuple(self.scenes)).draw(rng)
        fault = self._fault(rng)
        size = words(fault)
        if rng.random() < TWO:
            other = self._fault(rng)
            size = f'{size}; {words(other)}'
            fault = self.both(fault, other)
        about, scene = 'drawn at random', self.scenes[name]
        return Row(
            f'{self.prefix}_{number}', about, f'{size} ({name})', fault, ANYBODY, scene=scene
        )

    def _fault(self, rng: np.random.Generator) -> F:
        kind, drawn = self.kinds[int(rng.integers(len(self.kinds)))]
        values = {'start_s': self.starts_s.draw(rng)}
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
