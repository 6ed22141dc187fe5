"""`polar test`: style, types, import contracts, tests; all run even if an early one fails.

Packages are tested on one core, builds and tools on another, beside the checks; then, alone
because they start graphs of processes, the live tests in `tests`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from polar_nav_core.errors import ConfigError

from ..live.domain import busy_udp_ports, free_domain_id

FAST = 'not slow and not live and not long'
USUAL = 'not long'
_LIVE, _OFFLINE = 'live', 'not live'
_LOWER = (
    'polar_nav_core/test', 'polar_nav_ros/test', 'polar_nav_sim/test', 'polar_nav_leader/test',
    'polar_nav_follower/test',
)  # fmt: skip
_TOOLS, _WHOLE = 'polar_nav_tools/test', 'tests'


@dataclass(frozen=True)
class Step:
    """One command of the suite, with its environment variables."""

    name: str
    command: tuple[str, ...]
    env: Mapping[str, str] = field(default_factory=dict)


def source_root(start: Path) -> Path:
    """Folder of the clone around ``start``, or of this module.

    Raises
    ------
    ConfigError
        Without sources: tests are not installed.
    """
    for folder in (start, *start.parents, *Path(__file__).resolve().parents):
        if (folder / 'pyproject.toml').is_file() and (folder / 'polar_nav_core').is_dir():
            return folder
    raise ConfigError(f'{start}: not in a clone of the sources, where the tests are')


def checks(python: str) -> list[Step]:
    """Steps of style, types and import contracts."""
    lint_imports = str(Path(python).parent / 'lint-imports')
    return [
        Step('ruff check', (python, '-m', 'ruff', 'check', '.')),
        Step('ruff format', (python, '-m', 'ruff', 'format', '--check', '.')),
        Step('mypy', (python, '-m', 'mypy')),
        Step('import-linter', (lint_imports,)),
    ]


def without_compiler(python: str) -> Step:
    """Step that tests the core as plain Python."""
    pytest = (python, '-m', 'pytest', '-q', '-m', FAST, 'polar_nav_core/test')
    return Step('core without compiled kernels', pytest, {'NUMBA_DISABLE_JIT': '1'})


def tests(python: str, *, long: bool, fast: bool, arguments: Sequence[str]) -> Step:
    """Step of pytest: the fast ring, the usual rings, or all with the stated lengths."""
    marks = [] if long else ['-m', FAST if fast else USUAL]
    return Step('tests', (python, '-m', 'pytest', *marks, *arguments))


def fast_ring(python: str) -> tuple[list[Step], list[Step]]:
    """Steps of the fast ring for two cores: vehicles and simulation; the checks and the tools."""
    lower, tools = _halves(python, ['-m', FAST], (_TOOLS, _WHOLE))
    return [lower], [*checks(python), tools]


def all_rings(python: str, *, long: bool) -> tuple[list[Step], list[Step], Step]:
    """Steps for two cores as those of the fast ring, and the step of whole graphs after them."""
    marks = [] if long else ['-m', USUAL]
    lower, tools = _halves(python, marks, (_TOOLS,))
    offline, live = (
        (python, '-m', 'pytest', '-m', ring if long else f'{ring} and {USUAL}', _WHOLE)
        for ring in (_OFFLINE, _LIVE)
    )
    # About the same time for each core.
    first = [lower, without_compiler(python)]
    others = [*checks(python), Step('tests of builds and files', offline), tools]
    return first, others, Step('tests of whole graphs', live)


def _halves(python: str, marks: Sequence[str], upper: Sequence[str]) -> tuple[Step, Step]:
    """Step of the packages below the tools, and that of the tools in another ROS domain."""
    pytest = (python, '-m', 'pytest', *marks)
    # Nodes of the two halves must not find each other.
    domain = {'ROS_DOMAIN_ID': str(free_domain_id(os.getpid(), busy_udp_ports()))}
    lower = Step('tests of core, nodes and simulation', (*pytest, *_LOWER))
    return lower, Step('tests of tools', (*pytest, *upper), domain)


@dataclass(frozen=True)
class Outcome:
    """End of a step, and its output unless that went to the terminal."""

    step: Step
    status: int
    seconds: float
    output: str = ''


def run_suite(root: Path, *, long: bool, fast: bool, arguments: Sequence[str]) -> int:
    """Exit status of the suite: 0 only if everything passed.

    Parameters
    ----------
    root : Path
        The clone.
    long, fast : bool
        Full lengths, or only the fast ring.
    arguments : sequence of str
        For pytest; with any, only pytest runs.
    """
    out = Console(highlight=False)
    python = sys.executable
    if arguments:
        outcomes = [_shown(tests(python, long=long, fast=fast, arguments=arguments), root, out)]
    elif fast:
        outcomes = _side_by_side(*fast_ring(python), root, out)
    else:
        first, others, whole = all_rings(python, long=long)
        outcomes = [*_side_by_side(first, others, root, out), _shown(whole, root, out)]
    failed = [o.step.name for o in outcomes if o.status != 0]
    if failed:
        Console(stderr=True, highlight=False).print(f'[red]failed: {", ".join(failed)}[/red]')
    return 1 if failed else 0


def _shown(step: Step, root: Path, out: Console) -> Outcome:
    """Outcome of a step that is shown as it runs."""
    _head(step, out)
    return _run(step, root)


def _side_by_side(
    shown: Sequence[Step], others: Sequence[Step], root: Path, out: Console
) -> list[Outcome]:
    """Outcomes of steps shown as they run, and of others on another core, shown at the end."""
    other_core = ThreadPoolExecutor(max_workers=1)
    try:
        waiting = [other_core.submit(_run, step, root, captured=True) for step in others]
        outcomes = [_shown(step, root, out) for step in shown]
        for step, future in zip(others, waiting, strict=True):
            _head(step, out)
            outcomes.append(future.result())
            output = outcomes[-1].output.rstrip()
            if output:
                last_line = output.rpartition('\n')[2]
                shown_text = output if outcomes[-1].status else last_line
                out.print(shown_text, markup=False, soft_wrap=True)
            _tell(outcomes[-1], out)
    finally:
        other_core.shutdown(cancel_futures=True)
    return outcomes


def _run(step: Step, root: Path, *, captured: bool = False) -> Outcome:
    started = time.monotonic()
    done = subprocess.run(
        step.command,
        cwd=root,
        env={**os.environ, **step.env},
        stdout=subprocess.PIPE if captured else None,
        stderr=subprocess.STDOUT if captured else None,
        text=True,
        errors='replace',
    )
    return Outcome(step, done.returncode, time.monotonic() - started, done.stdout or '')


def _head(step: Step, out: Console) -> None:
    out.print(f'[bold]== {step.name}[/bold]')
    sys.stdout.flush()


def _tell(outcome: Outcome, out: Console) -> None:
    failed = f'[red]failed with status {outcome.status}[/red]'
    verdict = failed if outcome.status else 'ok'
    out.print(f'== {outcome.step.name}: {verdict}, {outcome.seconds:.1f} s')
