"""`polar test`: style, types, import contracts, tests; all run even if an early one fails.

Two cores take one step after the other, the longest first. Then, without other steps because they
start graphs of processes, the live tests in `tests`: those in real time, which mostly wait, beside
those in lockstep.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from polar_nav_core.errors import ConfigError

from ..live.domain import busy_udp_ports, free_domain_id

FAST = 'not slow and not live and not long'
USUAL = 'not long'
_OFFLINE, _LOCKSTEP, _PACED = 'not live', 'live and not paced', 'live and paced'
_LOWER = (
    'polar_nav_core/test', 'polar_nav_ros/test', 'polar_nav_sim/test', 'polar_nav_leader/test',
    'polar_nav_follower/test',
)  # fmt: skip
_TOOLS, _WHOLE = 'polar_nav_tools/test', 'tests'
_BUILD, _MISSIONS = 'tests/test_build.py', 'tests/test_live_missions.py'
_EXPERIMENTS = 'test_experiments*'
"""Names of the files in the folder of the tools that a step of their own tests."""
_CHOOSES_DOMAIN = {'ROS_DOMAIN_ID': ''}
"""Each graph of such a step chooses a ROS domain that nobody uses."""


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


def fast_ring(python: str) -> list[Step]:
    """Steps of the fast ring for two cores: vehicles and simulation; the tools; the checks."""
    pytest = (python, '-m', 'pytest', '-m', FAST)
    (domain,) = _own_domains(1)
    return [
        Step('tests of core, nodes and simulation', (*pytest, *_LOWER)),
        Step('tests of tools', (*pytest, _TOOLS, _WHOLE), domain),
        *checks(python),
    ]


def all_rings(python: str, root: Path, *, long: bool) -> tuple[list[Step], list[Step]]:
    """Steps for two cores, about the longest first, and the steps of whole graphs after them."""

    def pytest(*arguments: str, ring: str = '') -> tuple[str, ...]:
        marks = ' and '.join(mark for mark in (ring, '' if long else USUAL) if mark)
        return (python, '-m', 'pytest', *(['-m', marks] if marks else []), *arguments)

    one, other = _own_domains(2)
    # By name: a step that were to choose among all files of the tools would read all of them.
    experiments = sorted(
        str(file.relative_to(root)) for file in (root / _TOOLS).glob(_EXPERIMENTS)
    )
    side_by_side = [
        Step('tests of core, nodes and simulation', pytest(*_LOWER)),
        Step('tests of tools', pytest(f'--ignore-glob=*/{_EXPERIMENTS}', _TOOLS), one),
        Step('tests of experiments', pytest(*experiments), other),
        Step('tests of files', pytest(f'--ignore={_BUILD}', _WHOLE, ring=_OFFLINE)),
        # With its nodes, all in a domain of the file: one build serves all its tests.
        Step('tests of builds', pytest(_BUILD)),
        without_compiler(python),
        *checks(python),
    ]
    apart = [f'--ignore={file}' for file in (_BUILD, _MISSIONS)]
    graphs = [
        Step('tests of whole graphs', pytest(*apart, _WHOLE, ring=_LOCKSTEP), _CHOOSES_DOMAIN),
        Step('tests in real time', pytest(*apart, _WHOLE, ring=_PACED), _CHOOSES_DOMAIN),
        Step('tests of missions', pytest(_MISSIONS), _CHOOSES_DOMAIN),
    ]
    return side_by_side, graphs


def _own_domains(count: int) -> list[dict[str, str]]:
    """Environments of ROS domains of their own: nodes of two steps must not find each other."""
    busy, start, found = busy_udp_ports(), os.getpid(), []
    for _ in range(count):
        start = free_domain_id(start, busy)  # the next search begins behind this domain
        found.append({'ROS_DOMAIN_ID': str(start)})
    return found


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
        outcomes = _on_two_cores(fast_ring(python), root, out)
    else:
        outcomes = [
            outcome
            for steps in all_rings(python, root, long=long)
            for outcome in _on_two_cores(steps, root, out)
        ]
    failed = [o.step.name for o in outcomes if o.status != 0]
    if failed:
        Console(stderr=True, highlight=False).print(f'[red]failed: {", ".join(failed)}[/red]')
    return 1 if failed else 0


def _shown(step: Step, root: Path, out: Console) -> Outcome:
    """Outcome of a step that is shown as it runs."""
    _head(step, out)
    return _run(step, root)


def _on_two_cores(steps: Sequence[Step], root: Path, out: Console) -> list[Outcome]:
    """Outcomes of steps: some shown as they run; those of the other core are shown at the end."""
    left = deque(steps)
    other_core = ThreadPoolExecutor(max_workers=1)
    try:
        first, second = left.popleft(), left.popleft()
        beside = other_core.submit(
            lambda: [_run(step, root, captured=True) for step in _taken(second, left)]
        )
        outcomes = []
        for step in _taken(first, left):
            outcomes.append(_shown(step, root, out))
            _tell(outcomes[-1], out)
        for outcome in beside.result():
            _head(outcome.step, out)
            _tell(outcome, out)
            output = outcome.output.rstrip()
            if output:  # pytest's summary stands at the end
                last_line = output.rpartition('\n')[2]
                out.print(output if outcome.status else last_line, markup=False, soft_wrap=True)
            outcomes.append(outcome)
    finally:
        left.clear()
        other_core.shutdown()
    return outcomes


def _taken(first: Step, left: deque[Step]) -> Iterator[Step]:
    """Yield a step, and then one after the other of those that no core has taken yet."""
    yield first
    while True:
        try:
            step = left.popleft()
        except IndexError:
            return
        yield step


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
