"""Interleaved rounds: every entry runs once in each round, and ratios are of one round.

A shared machine changes its speed by a factor of two within minutes. The entries of one round have
the same machine; the median of the rounds' ratios can be quoted.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

LONGEST_REPEAT = 1000


@dataclass(frozen=True)
class Entry:
    """Work to be timed."""

    key: str
    title: str
    items: int
    """Pieces of work (samples, filter cycles) in one call of ``run``."""
    run: Callable[[], object]
    prepare: Callable[[], object] | None = None
    """Called before each ``run`` and not timed."""

    def seconds(self, repeat: int, clock: Callable[[], float]) -> float:
        """Time [s] of some calls of ``run``."""
        if self.prepare is None:
            start = clock()
            for _ in range(repeat):
                self.run()
            return clock() - start
        total = 0.0
        for _ in range(repeat):
            self.prepare()
            start = clock()
            self.run()
            total += clock() - start
        return total


@dataclass(frozen=True)
class Timing:
    """Times of one entry, one for each round."""

    key: str
    title: str
    items: int
    repeat: int
    """Calls in each round."""
    seconds_per_item: tuple[float, ...]

    @property
    def median_us(self) -> float:
        """Median over the rounds [us per item]."""
        return 1e6 * statistics.median(self.seconds_per_item)


@dataclass(frozen=True)
class Ratio:
    """Time of one entry over that of another, within each round."""

    median: float
    lowest: float
    highest: float


def interleave(
    entries: Sequence[Entry],
    rounds: int,
    shortest_s: float = 0.03,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, Timing]:
    """Timings of the entries, each once per round; every second round in reverse order.

    Parameters
    ----------
    entries : sequence of Entry
        Called once before the first round: compiles, fills caches, and determines the number of
        calls in ``shortest_s``.
    rounds : int
        At least 1; 7 for times to be quoted.
    shortest_s : float
        An entry is repeated within a round until it takes this long [s].
    clock : callable
        Seconds; the default is the processor time of this process, which does not run while
        another process has the core.
    """
    if rounds < 1:
        raise ValueError(f'rounds must be at least 1, not {rounds}')
    repeats = {}
    for entry in entries:
        entry.seconds(1, clock)
        once = entry.seconds(1, clock)
        wanted = math.ceil(shortest_s / once) if once > 0.0 else LONGEST_REPEAT
        repeats[entry.key] = min(max(wanted, 1), LONGEST_REPEAT)
    seconds: dict[str, list[float]] = {entry.key: [] for entry in entries}
    for number in range(rounds):
        for entry in entries if number % 2 == 0 else reversed(entries):
            repeat = repeats[entry.key]
            seconds[entry.key].append(entry.seconds(repeat, clock) / (repeat * entry.items))
    return {
        e.key: Timing(e.key, e.title, e.items, repeats[e.key], tuple(seconds[e.key]))
        for e in entries
    }


def ratio(timings: Mapping[str, Timing], slow: str, fast: str) -> Ratio:
    """Ratio of the times of ``slow`` and ``fast`` for the same work."""
    values = [
        s / f
        for s, f in zip(
            timings[slow].seconds_per_item, timings[fast].seconds_per_item, strict=True
        )
    ]
    return Ratio(statistics.median(values), min(values), max(values))
