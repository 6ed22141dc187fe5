"""Tasks done here or elsewhere, those only whose rows are missing."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Any

from . import cluster
from .attempt import Attempt, Result, Task, attempt
from .distribution import Distribution
from .rows import FAILED, Row
from .store import Store

Update = Callable[[int, int, int], None]
"""Called with the number of finished tasks, of all, and of failed ones."""


def nobody() -> None:
    """Say nothing."""


@dataclass(frozen=True)
class Workers:
    """Who does tasks.

    Attributes
    ----------
    count : int
        Processes of this machine; with 1 everything is done in this one.
    scheduler : str or None
        Address of a Dask scheduler that does it instead.
    """

    count: int = 1
    scheduler: str | None = None


def missing(tasks: Sequence[Task], store: Store, *, failed: bool = False) -> list[Task]:
    """Tasks without a row; with ``failed`` those with the row of a failure instead."""
    if failed:
        return [t for t in tasks if t.key in store.rows and store.rows[t.key].status == FAILED]
    return [t for t in tasks if t.key not in store.rows]


def execute(
    tasks: Sequence[Task],
    call: Callable[[Any], Result],
    store: Store,
    workers: Workers,
    update: Update,
    *,
    failures: bool = False,
    waiting: Callable[[], None] = nobody,
) -> list[Row]:
    """Rows of all tasks, in their order; those that the store has are not done again.

    Parameters
    ----------
    tasks : sequence of Task
        Those of equal content are done once.
    call : callable
        Does one; a function of a module.
    store : Store
    workers : Workers
    update : callable
    failures : bool
        Whether a failed task leaves a row; otherwise its error ends everything, and only what was
        finished stays.
    waiting : callable
        Called now and then while a scheduler has no worker.
    """
    once = list({t.key: t for t in tasks}.values())
    to_do = missing(once, store)
    held = [store.rows[t.key] for t in once if t.key in store.rows]
    done, bad = len(held), sum(row.status == FAILED for row in held)
    update(done, len(once), bad)
    with closing(_attempts(to_do, call, workers, waiting)) as attempts:
        for found in attempts:
            store.add([a.row for a in found if failures or a.error is None])
            for one in found:
                if one.error is not None and not failures:
                    raise one.error
            done += len(found)
            bad += sum(a.error is not None for a in found)
            update(done, len(once), bad)
    return [store.rows[t.key] for t in tasks]


def _attempts(
    tasks: Sequence[Task],
    call: Callable[[Any], Result],
    workers: Workers,
    waiting: Callable[[], None],
) -> Generator[list[Attempt]]:
    if not tasks:
        return
    with ExitStack() as stack:
        if workers.scheduler is not None:
            client = stack.enter_context(cluster.connected(workers.scheduler))
        elif workers.count > 1 and len(tasks) > 1:
            client = stack.enter_context(cluster.local(min(workers.count, len(tasks))))
        else:
            yield from ([attempt(call, task)] for task in tasks)
            return
        yield from Distribution(client, tasks, call, waiting).attempts()
