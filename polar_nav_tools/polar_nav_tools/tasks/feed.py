"""Which task is next for which worker.

Neighbours that share a world make a stretch, and a stretch goes to one worker, which keeps the
world that it made last. A worker that finds no stretch left takes the later half of the longest
one that another still has. What is computed does not depend on it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import groupby

from .attempt import Task


class Feed:
    """Order of tasks for workers that come and go."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._stretches = deque(
            deque(stretch) for _, stretch in groupby(tasks, key=lambda t: t.stretch)
        )
        self._own: dict[str, deque[Task]] = {}

    def next_for(self, worker: str) -> Task | None:
        """Next task for a worker; None when all are given out."""
        own = self._own.setdefault(worker, deque())
        if not own:
            if self._stretches:
                own = self._own[worker] = self._stretches.popleft()
            else:
                own.extend(self._half_of_the_longest())
        return own.popleft() if own else None

    def keep(self, workers: Iterable[str]) -> None:
        """Take back the tasks that were meant for workers that are gone."""
        for gone in set(self._own) - set(workers):
            left = self._own.pop(gone)
            if left:
                self._stretches.appendleft(left)

    def _half_of_the_longest(self) -> deque[Task]:
        longest = max(self._own.values(), key=len)
        taken = [longest.pop() for _ in range((len(longest) + 1) // 2)]
        return deque(reversed(taken))
