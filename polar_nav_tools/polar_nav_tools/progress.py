"""How far a long piece of work is, on stderr: a bar on a terminal, else a line every tenth."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Update = Callable[[float, float], None]
"""Called with what is done and the total."""


@contextmanager
def progress_display(title: str, *, total: float, unit: str) -> Iterator[Update]:
    """Show progress while the block runs.

    Parameters
    ----------
    title : str
        What is going on.
    total : float
        Expected total, until the first update tells a better one.
    unit : str
        Of the total; for ``s`` the speed is shown as a multiple of real time.
    """
    if sys.stderr.isatty():
        yield from _bar(title, total, unit)
    else:
        yield from _lines(title, unit)


def _bar(title: str, total: float, unit: str) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn('{task.description}'),
        BarColumn(),
        TextColumn('{task.completed:.0f} of {task.total:.0f} ' + unit),
        TextColumn('{task.fields[speed]}'),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=total, speed='')

        def update(done: float, end: float) -> None:
            speed = progress.tasks[0].speed
            text = f'{speed:.0f} x real time' if speed and unit == 's' else ''
            progress.update(task, completed=done, total=end, speed=text)

        yield update


def _lines(title: str, unit: str) -> Iterator[Update]:
    told = -1

    def update(done: float, end: float) -> None:
        nonlocal told
        tenth = int(10.0 * done / end) if end > 0.0 else 10
        if tenth > told:
            told = tenth
            sys.stderr.write(f'polar: {title}: {done:.0f} of {end:.0f} {unit}\n')
            sys.stderr.flush()

    yield update
