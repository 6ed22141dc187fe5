"""Tasks that a command has made: their progress, a scheduler without workers, Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from .app import say

if TYPE_CHECKING:
    from ..tasks.execution import Update

Ordered = TypeVar('Ordered')
Made = TypeVar('Made')


def shown(
    run: Callable[[Ordered, Update, Callable[[], None]], Made],
    order: Ordered,
    *,
    title: str,
    scheduler: str | None,
    kept: str,
) -> Made:
    """Result of a run of tasks, with its progress shown.

    Parameters
    ----------
    run : callable
        Gets the order, a `tasks.execution.Update`, and what to call while a scheduler has no
        workers.
    order : object
    title : str
        Before the bar.
    scheduler : str or None
        Its address.
    kept : str
        Sentence after Ctrl-C: where finished tasks are.
    """
    from ..terminal.progress import progress_display

    told: list[None] = []

    def waiting() -> None:
        if not told:
            say(f'{scheduler}: has no workers yet; waiting for some')
            told.append(None)

    try:
        with progress_display(title, total=1.0, unit='runs') as update:

            def report(done: int, total: int, bad: int) -> None:
                update(float(done), float(total), f'{bad} failed' if bad else '')

            return run(order, report, waiting)
    except KeyboardInterrupt:
        say(f'{kept}; --resume goes on with them')
        raise
