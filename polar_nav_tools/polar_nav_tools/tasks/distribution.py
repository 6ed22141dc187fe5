"""Tasks done by the workers of a Dask scheduler.

Each worker has one task to do and one to go on with, so that it never waits and little is lost
when it ends; a million tasks are no burden to the scheduler, which knows a few at a time.

Tasks of a worker that is gone are given out again, each alone with its worker, so that one that
ends its worker is told from those that waited beside it; after `_MOST_DEATHS` it has failed. Dask
does the like by itself, but leaves tasks with a preferred worker waiting for ever when all workers
are gone at once and others come.
"""

from __future__ import annotations

import queue
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import PolarNavError

from .attempt import Attempt, DifferentWorker, Result, Task, attempt, failed
from .feed import Feed

if TYPE_CHECKING:
    from distributed import Client, Future

_AHEAD = 2
"""Tasks that a worker has at a time."""
_MOST_DEATHS = 3
"""Workers that a task may end before it has failed."""
_LOOK_S = 1.0
"""Time between looks at which workers there are [s]."""


_GONE = 'the scheduler is gone; finished runs are kept, --resume goes on with them'


class Unreachable(PolarNavError):
    """A scheduler or its workers cannot be used."""


class EndedWorkers(PolarNavError):
    """A task was given to several workers, of which none came back."""

    def __init__(self, task: Task) -> None:
        of = ', '.join(f'{name} {value}' for name, value in task.names.items() if value != '')
        super().__init__(
            f'{of}: ended {_MOST_DEATHS} workers, which were killed or did not answer any more; '
            'finished runs are kept, --resume goes on with them, with --jobs 1 in this process'
        )


class Distribution:
    """Attempts at tasks, in the order in which they end.

    Parameters
    ----------
    client : Client
    tasks : sequence of Task
    call : callable
        Does one; a function of a module.
    waiting : callable
        Called now and then while there is no worker.
    """

    def __init__(
        self,
        client: Client,
        tasks: Sequence[Task],
        call: Callable[[Any], Result],
        waiting: Callable[[], None] = lambda: None,
    ) -> None:
        self._client, self._call, self._waiting = client, call, waiting
        self._feed, self._left = Feed(tasks), len(tasks)
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._tasks: dict[Future, tuple[Task, str]] = {}
        self._workers: list[str] = []
        self._looked_s = -float('inf')
        self._suspects: deque[Task] = deque()
        self._deaths: Counter[str] = Counter()
        self._suspected: set[str] = set()

    def attempts(self) -> Iterator[list[Attempt]]:
        """Attempts that have come since the last ones."""
        try:
            while self._left:
                found = self._look()
                self._give()
                found += [a for f in self._wait() if (a := self._taken(f)) is not None]
                self._left -= len(found)
                if found:
                    self._give()
                    yield found
        finally:
            if self._tasks and self._client.status == 'running':
                self._client.cancel(list(self._tasks), force=True)

    def _look(self) -> list[Attempt]:
        """Look, now and then, at which workers there are; tasks that failed with one gone."""
        if time.monotonic() - self._looked_s < _LOOK_S:
            return []
        if self._client.status != 'running':
            raise Unreachable(_GONE)
        try:
            # What `scheduler_info` returns may be the client's own last look, without workers.
            found = self._client.sync(self._client.scheduler.identity, n_workers=-1)['workers']
        except OSError as error:
            raise Unreachable(_GONE) from error
        self._looked_s = time.monotonic()
        self._workers = list(found)
        self._feed.keep(self._workers)
        if not found:
            self._waiting()
        held = Counter(worker for _, worker in self._tasks.values())
        lost = [(f, t, w) for f, (t, w) in self._tasks.items() if w not in found]
        for future, _, _ in lost:
            del self._tasks[future]
        if lost:
            self._client.cancel([future for future, _, _ in lost], force=True)
        failures = []
        for _, task, worker in lost:
            self._suspected.add(task.key)
            self._deaths[task.key] += held[worker] == 1
            if self._deaths[task.key] < _MOST_DEATHS:
                self._suspects.append(task)
            else:
                failures.append(failed(task, EndedWorkers(task)))
        return failures

    def _give(self) -> None:
        """Give every worker what it is short of; suspects one at a time."""
        held: dict[str, list[Task]] = {worker: [] for worker in self._workers}
        for task, worker in self._tasks.values():
            held.setdefault(worker, []).append(task)
        for worker in self._workers:
            if self._suspects:
                if not held[worker]:
                    self._submit(self._suspects.popleft(), worker)
                continue
            if any(task.key in self._suspected for task in held[worker]):
                continue
            for _ in range(_AHEAD - len(held[worker])):
                following = self._feed.next_for(worker)
                if following is None:
                    break
                self._submit(following, worker)

    def _submit(self, task: Task, worker: str) -> None:
        future = self._client.submit(
            attempt, self._call, task, ENGINE_VERSION, pure=False, workers=[worker]
        )
        self._tasks[future] = task, worker
        future.add_done_callback(self._ended.put)

    def _wait(self) -> list[Future]:
        """Tasks that have ended; none if none has for a while."""
        found = []
        try:
            found.append(self._ended.get(timeout=_LOOK_S))
            while True:
                found.append(self._ended.get_nowait())
        except queue.Empty:
            return found

    def _taken(self, future: Future) -> Attempt | None:
        """Attempt that ended; None if it went with its worker."""
        from distributed import TimeoutError as NotInTime

        if future not in self._tasks:
            return None
        if future.cancelled():
            raise Unreachable(_GONE)
        try:
            found: Attempt = future.result(timeout=_LOOK_S)
        except (NotInTime, UnboundLocalError):
            # The worker may be gone, its result with it: the next look tells. The second is what
            # Dask's `sync` raises where the wait itself was cancelled as its time was over.
            self._ended.put(future)
            return None
        except DifferentWorker:
            raise
        except (OSError, CancelledError) as error:
            # Of the connection: those of the task are in its attempt. Dask cancels what it waits
            # for once the scheduler is gone, this one since it was asked above perhaps.
            raise Unreachable(_GONE) from error
        except Exception as error:
            raise Unreachable(
                f'a worker cannot run this ({type(error).__name__}: {error}): it needs the same'
                ' environment as this command'
            ) from error
        del self._tasks[future]
        return found
