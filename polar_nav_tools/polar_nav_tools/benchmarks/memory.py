"""`polar bench memory`: peak memory of commands on a long recording beside a short one."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from polar_nav_core.errors import PolarNavError

from ..scoring.tables import Column, Table
from .long_bag import long_bag

SHORT_HOURS = 1.0 / 60.0
COMMANDS: dict[str, tuple[str, ...]] = {
    'replay': ('replay',),
    'replay --out': ('replay', '--out'),
    'score': ('score', '--configs', 'default'),
    'smooth --out': ('smooth', '--configuration', 'default', '--out'),
}
"""What is measured, without the bag; ``--out`` gets a new folder."""
MOST_MB = {'replay': 150.0, 'replay --out': 150.0, 'score': 150.0, 'smooth --out': 400.0}
"""Goals: above the same command on the short recording."""


_STARTER = """
import resource, subprocess, sys
status = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
print(status, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
"""Starts a command and says its status and peak: what is started by a process of gigabytes counts
those as its own, so a small one is put in between."""


@dataclass(frozen=True)
class Peaks:
    """Peak memory of one command [MB].

    Attributes
    ----------
    command : str
    short, long : float
        On either recording.
    """

    command: str
    short: float
    long: float

    @property
    def above(self) -> float:
        """What the long recording needs more [MB]."""
        return self.long - self.short

    @property
    def met(self) -> bool:
        """Whether the goal is met."""
        return self.above <= MOST_MB[self.command]

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            'command': self.command,
            'short_mb': self.short,
            'long_mb': self.long,
            'above_mb': self.above,
            'ratio': self.long / self.short,
            'goal_mb': MOST_MB[self.command],
            'met': self.met,
        }


def peak_mb(words: tuple[str, ...], bag: Path) -> float:
    """Peak memory of a command on a bag [MB], in a process of its own.

    Raises
    ------
    PolarNavError
        When the command could not be carried out.
    """
    with tempfile.TemporaryDirectory(prefix='polar-memory-') as folder:
        out = [str(Path(folder) / 'out')] if words[-1] == '--out' else []
        command = [sys.executable, '-m', 'polar_nav_tools.cli', *words, *out, str(bag)]
        done = subprocess.run(
            [sys.executable, '-c', _STARTER, *command],
            capture_output=True,
            text=True,
            errors='replace',
            check=True,
        )
    status, kib = (int(word) for word in done.stdout.split())
    if status not in (0, 1):  # 1: the filter was not well, and all was done
        said = done.stderr.strip()[-1000:]
        raise PolarNavError(f'{" ".join(words)} {bag} failed: {said}')
    return kib * 1024 / 1e6


def run(
    *, hours: float, beside: Path | None, folder: Path | None, report: Callable[[str], None]
) -> tuple[Peaks, ...]:
    """Peaks of each command on a bag of some hours, and on another one (by default a minute)."""
    short = beside or long_bag(SHORT_HOURS, folder=folder)
    report(f'making the bag of {hours:g} h')
    long = long_bag(hours, folder=folder)
    found = []
    for name, words in COMMANDS.items():
        report(f'measuring {name}')
        found.append(Peaks(name, peak_mb(words, short), peak_mb(words, long)))
    return tuple(found)


def table(hours: float, found: tuple[Peaks, ...]) -> Table:
    """Table of the peaks."""
    columns = (
        Column('command', ''),
        Column('short_mb', 'short', 'MB'),
        Column('long_mb', f'{hours:g} h', 'MB'),
        Column('above_mb', 'above', 'MB'),
        Column('ratio', 'ratio'),
        Column('goal_mb', 'goal', 'MB'),
        Column('met', 'met'),
    )
    return Table('Peak memory', columns, tuple(one.to_dict() for one in found))
