"""Progress of long work on stderr: a bar on a terminal.

Without one, only runs of graphs and experiments, which take minutes to hours, write a line now and
then; work on a bag writes none.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

_LARGE_BYTES = 100_000_000
"""Size of a bag from which the progress of its opening is shown [bytes]."""

_QUIET_S = 10.0
"""Without a terminal nothing is written of work shorter than this, and lines no more often."""


class Update(Protocol):
    """Called with the finished amount, the total, and perhaps a remark."""

    def __call__(self, done: float, end: float, note: str = '', /) -> None:
        """Show it."""


@contextmanager
def progress_display(title: str, *, total: float, unit: str) -> Iterator[Update]:
    """Show progress while the block runs.

    Parameters
    ----------
    title : str
        Name of the work.
    total : float
        Expected total, until the first update states a better one.
    unit : str
        Of the total; for ``s`` the speed is shown as a multiple of real time, ``%`` is for work
        on a bag.
    """
    if sys.stderr.isatty():
        yield from _bar(title, total, unit)
    elif unit != '%':
        yield from _lines(title, unit)
    else:
        yield lambda _done, _total, _note='': None


@contextmanager
def opening_display(path: Path) -> Iterator[Callable[[float], None] | None]:
    """Show the progress of opening a large bag, on a terminal only; None for a small one."""
    if not sys.stderr.isatty() or _size(path) < _LARGE_BYTES:
        yield None
        return
    with progress_display(f'opening {path}', total=100.0, unit='%') as update:
        yield lambda share: update(100.0 * share, 100.0)


def _size(path: Path) -> int:
    """Bytes of a bag; 0 without one, which its opening reports."""
    from ..bags.remote.address import is_remote

    if is_remote(path):
        return _LARGE_BYTES  # whatever it is, it takes a while
    try:
        files = path.iterdir() if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files)
    except OSError:
        return 0


def _bar(title: str, total: float, unit: str) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: list[ProgressColumn] = [
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        TextColumn('{task.completed:.0f} of {task.total:.0f} ' + unit),
        TextColumn('{task.fields[speed]}'),
        TimeElapsedColumn(),
    ]
    if unit == 'runs':
        columns += [TextColumn('left'), TimeRemainingColumn()]
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=total, speed='')

        def update(done: float, end: float, note: str = '', /) -> None:
            speed = progress.tasks[0].speed
            text = f'{speed:.0f} x real time' if speed and unit == 's' else note
            progress.update(task, completed=done, total=end, speed=text)

        yield update


def _lines(title: str, unit: str) -> Iterator[Update]:
    printed, since_s = 0, time.monotonic()
    if unit == 's':  # a simulated run: that it began is worth a line
        printed, since_s = -1, since_s - _QUIET_S

    def update(done: float, end: float, note: str = '', /) -> None:
        nonlocal printed, since_s
        tenth = int(10.0 * done / end) if end > 0.0 else 10
        now_s = time.monotonic()
        if tenth > printed and now_s - since_s >= _QUIET_S:
            printed, since_s = tenth, now_s
            said = f', {note}' if note else ''
            sys.stderr.write(f'polar: {title}: {done:.0f} of {end:.0f} {unit}{said}\n')
            sys.stderr.flush()

    yield update
