"""`polar test`: style, types, floors, tests; all of them run even when an early one fails.

The long part comes last, so that the output ends with pytest's own summary of every test.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from polar_nav_core.errors import ConfigError

FAST = 'not slow and not live and not long'
USUAL = 'not long'


@dataclass(frozen=True)
class Step:
    """One command of the suite, with what it adds to the environment."""

    name: str
    command: tuple[str, ...]
    env: Mapping[str, str] = field(default_factory=dict)


def source_root(start: Path) -> Path:
    """Folder of the clone that ``start`` lies in, or that this module was imported from.

    Raises
    ------
    ConfigError
        When there are no sources: tests are not installed.
    """
    for folder in (start, *start.parents, *Path(__file__).resolve().parents):
        if (folder / 'pyproject.toml').is_file() and (folder / 'polar_nav_core').is_dir():
            return folder
    raise ConfigError(f'{start}: not in a clone of the sources, where the tests are')


def checks(python: str) -> list[Step]:
    """What runs before the tests: style, types, floors, and the core without its compiler."""
    lint_imports = str(Path(python).parent / 'lint-imports')
    pytest = (python, '-m', 'pytest', '-q', '-m', FAST)
    return [
        Step('ruff check', (python, '-m', 'ruff', 'check', '.')),
        Step('ruff format', (python, '-m', 'ruff', 'format', '--check', '.')),
        Step('mypy', (python, '-m', 'mypy')),
        Step('import-linter', (lint_imports,)),
        Step(
            'core without compiled kernels',
            (*pytest, 'polar_nav_core/test'),
            {'NUMBA_DISABLE_JIT': '1'},
        ),
    ]


def tests(python: str, *, long: bool, fast: bool, arguments: Sequence[str]) -> Step:
    """Build the pytest run: the fast ring, the usual rings, or all with the stated lengths."""
    marks = [] if long else ['-m', FAST if fast else USUAL]
    name = 'tests, fast ring' if fast else 'tests, all rings at full length' if long else 'tests'
    return Step(name, (python, '-m', 'pytest', *marks, *arguments))


def run_suite(root: Path, *, long: bool, fast: bool, arguments: Sequence[str]) -> int:
    """Run everything; 0 only when everything passed.

    Parameters
    ----------
    root : Path
        The clone.
    long, fast : bool
        Full lengths, or only the fast ring.
    arguments : sequence of str
        For pytest; when there are any, only pytest runs.
    """
    out = Console(highlight=False)
    steps = [] if arguments else checks(sys.executable)
    steps.append(tests(sys.executable, long=long, fast=fast, arguments=arguments))
    failed = []
    for step in steps:
        out.print(f'[bold]== {step.name}[/bold]')
        sys.stdout.flush()
        started = time.monotonic()
        status = subprocess.run(step.command, cwd=root, env={**os.environ, **step.env}).returncode
        if status != 0:
            failed.append(step.name)
        if step is not steps[-1]:
            verdict = 'ok' if status == 0 else f'[red]failed with status {status}[/red]'
            out.print(f'== {step.name}: {verdict}, {time.monotonic() - started:.1f} s')
    if failed:
        Console(stderr=True, highlight=False).print(f'[red]failed: {", ".join(failed)}[/red]')
    return 1 if failed else 0
