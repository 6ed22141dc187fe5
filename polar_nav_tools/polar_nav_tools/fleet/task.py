"""One bag scored with one configuration, wherever that is done."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..analysis.analyse import analyse
from ..analysis.opening import wanted_of
from ..bags import Bag, open_bag
from ..bags.errors import BagError
from .named import NamedBag, named


@dataclass(frozen=True)
class ScoreJob:
    """What is scored with what.

    Attributes
    ----------
    bag : NamedBag
        As whoever asks knows it.
    configuration : str
    vehicle : str or None
        Which follower, when a bag has several.
    """

    bag: NamedBag
    configuration: str
    vehicle: str | None = None

    def key_content(self) -> tuple[object, ...]:
        """What it computes: the content of the bag, not how the bag is called."""
        return self.bag.contents, self.configuration, self.vehicle


@dataclass(frozen=True)
class BagScore:
    """Score of a bag with one configuration.

    Attributes
    ----------
    vehicle : str
    figures : str
        JSON of all figures, as `polar score --json` has them of this run.
    problems, complaints : tuple of str
        What is not well with the bag, and with this run.
    is_verified : bool
        Every byte of the bag was read and compared; otherwise those that were used.
    reason : str
        Why the filter stopped; empty if it did not.
    seconds : float
        Processor time of replay and scoring [s].
    """

    vehicle: str
    figures: str
    problems: tuple[str, ...]
    complaints: tuple[str, ...]
    is_verified: bool
    reason: str
    seconds: float

    @property
    def names(self) -> Mapping[str, str | int | float]:
        """Columns of its row beside those of the task."""
        return {
            'vehicle': self.vehicle,
            'ok': int(not self.problems and not self.complaints),
            'complaints': '; '.join((*self.problems, *self.complaints)),
            'verified': int(self.is_verified),
            'honesty': str(self.summary.get('honesty', '')),
        }

    @property
    def summary(self) -> dict[str, Any]:
        """Figures of the first table of `polar score`."""
        return dict(json.loads(self.figures)['summary'])

    @property
    def metrics(self) -> Mapping[str, float]:
        """All numbers by name: those of the summary, then the others with their path."""
        figures = json.loads(self.figures)
        summary = figures.pop('summary')
        return {**dict(_numbers(summary)), **dict(_numbers(figures))}


def score_job(job: ScoreJob) -> BagScore:
    """Score of one bag with one configuration.

    Raises
    ------
    PolarNavError
        When the bag cannot be read or replayed, or is not any more what it was.
    """
    bag = _bag_of(job)
    start = time.process_time()
    analysis = analyse(bag, (job.configuration,), vehicle=job.vehicle, judge_live=False)
    seconds = time.process_time() - start
    problems = replace(analysis, judged=()).complaints()
    complaints = analysis.complaints()
    return BagScore(
        analysis.vehicle,
        json.dumps(analysis.comparison.to_dict()[job.configuration], allow_nan=False),
        tuple(problems),
        tuple(text for text in complaints if text not in problems),
        bag.is_verified,
        str(analysis.divergence.get(job.configuration) or ''),
        seconds,
    )


_newest: dict[tuple[NamedBag, str | None], Bag] = {}
"""The bag opened last: the next configuration reads it again."""


def _bag_of(job: ScoreJob) -> Bag:
    key = job.bag, job.vehicle
    bag = _newest.get(key)
    if bag is None:
        _newest.clear()
        path = job.bag.path
        bag = open_bag(path, ahead=wanted_of(job.vehicle, truth=True))
        if named(path) != job.bag:  # by what the opening was told
            raise BagError(f'{path} is not any more what it was when it was named')
        _newest[key] = bag
    return bag


def _numbers(value: object, path: str = '') -> list[tuple[str, float]]:
    """Numbers of a JSON value, named by the way to them; those without a value are left out."""
    if isinstance(value, Mapping):
        inner = [(f'{path}.{k}' if path else str(k), v) for k, v in value.items()]
        return [found for name, v in inner for found in _numbers(v, name)]
    if isinstance(value, list):
        inner = [(f'{path}.{i}', v) for i, v in enumerate(value)]
        return [found for name, v in inner for found in _numbers(v, name)]
    if isinstance(value, int | float) and math.isfinite(value):
        return [(path, float(value))]
    return []
