"""How far a long piece of work is, on stderr: a bar on a terminal, else nothing.

With POLAR_PROGRESS set it is a line every tenth, for logs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

LINES = 'POLAR_PROGRESS'
_LARGE_BYTES = 100_000_000
"""Size of a bag from which its opening takes long enough to be watched."""

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
    elif os.environ.get(LINES):
        yield from _lines(title, unit)
    else:
        yield lambda _done, _end: None


@contextmanager
def opening_display(path: Path) -> Iterator[Callable[[float], None] | None]:
    """Show how far the opening of a large bag is, on a terminal only; None: nothing to show."""
    if not sys.stderr.isatty() or _size(path) < _LARGE_BYTES:
        yield None
        return
    with progress_display(f'opening {path}', total=100.0, unit='%') as update:
        yield lambda share: update(100.0 * share, 100.0)


def _size(path: Path) -> int:
    """Bytes of a bag; 0 where there is none, which is said when it is opened."""
    try:
        files = path.iterdir() if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files)
    except OSError:
        return 0


def _bar(title: str, total: float, unit: str) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn('{task.description}', markup=False),
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
