"""Runs tests on one mutant after another, each in a fork of this process, for ``mutants.py``.

    python tests/mutants_worker.py MODULE MARK TEST...

Each line of standard input is a file whose source takes the place of MODULE; the answer is a line
with how it ended (killed, stopped, survived). The first line must be the module as it is, whose
processor time is the measure: a mutant that needs ten times as much is stopped. Imports of others'
libraries, and compiled kernels where MODULE is none, are loaded once here and serve all forks.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import io
import os
import resource
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 10.0
LEAST_S = 5.0
"""Processor time that a mutant has in any case: a fork of a busy machine counts a little more."""
_BELOW = ('polar_nav_core', 'polar_nav_core.arrays', 'polar_nav_core.errors')
"""Modules that kernels import."""


class _InPlace(importlib.abc.MetaPathFinder):
    """Finds the mutant where the module is asked for."""

    def __init__(self, name: str, file: str) -> None:
        self._name, self._file = name, file

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002 - of the interface
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> importlib.machinery.ModuleSpec | None:
        """Specification of the mutant; None for other modules."""
        if fullname != self._name:
            return None
        return importlib.util.spec_from_file_location(fullname, self._file)


def forget(module: str) -> None:
    """Remove modules of this repository, which the next import reads again.

    Kernels stay, as they are loaded, unless ``module`` is one of them.
    """
    keep = () if '.kernels.' in module else (*_BELOW, 'polar_nav_core.kernels')
    for name, found in list(sys.modules.items()):
        file = getattr(found, '__file__', None)
        if not file or not Path(file).is_relative_to(ROOT) or name == '__main__':
            continue
        if Path(file).is_relative_to(sys.prefix):  # libraries of others, in .venv of this folder
            continue
        if name in keep or name.startswith(tuple(f'{k}.kernels.' for k in keep[:1])):
            continue
        del sys.modules[name]
        parent, _, leaf = name.rpartition('.')
        vars(sys.modules.get(parent, ModuleType(''))).pop(leaf, None)


def status_of(arguments: Sequence[str]) -> int:
    """Exit status of pytest; its output goes nowhere."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(out):
        status = int(pytest.main(list(arguments)))
    if status not in (0, 1, 2):  # passed, failed, could not be imported
        sys.stderr.write(out.getvalue())
    return status


def in_fork(module: str, file: str, arguments: Sequence[str], most_s: float) -> str:
    """How the tests end with a file in the place of the module, in a fork of this process."""
    child = os.fork()
    if not child:
        used_s = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(used_s + most_s) + 1,) * 2)
        forget(module)
        sys.meta_path.insert(0, _InPlace(module, file))
        os._exit(status_of(arguments))
    _, ended = os.waitpid(child, 0)
    if os.WIFSIGNALED(ended):
        return 'stopped' if os.WTERMSIG(ended) in (signal.SIGXCPU, signal.SIGKILL) else 'killed'
    return {0: 'survived', 1: 'killed', 2: 'killed'}.get(os.WEXITSTATUS(ended), 'no result')


def main(module: str, mark: str, *tests: str) -> None:
    """Answer each file on standard input by how the tests end with it."""
    # Processor time is what counts: a busy machine stops nothing.
    patient = ('--timeout', '900')
    arguments = ('-q', '-x', *patient, '-p', 'no:cacheprovider', '-m', mark, *tests)
    warm = status_of(arguments)  # loads what the forks share
    assert warm == 0, f'{module}: its tests fail without a mutant'
    most_s = float('inf')
    for line in sys.stdin:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        patience = most_s if most_s < float('inf') else 3600.0
        sys.stdout.write(in_fork(module, line.strip(), arguments, patience) + '\n')
        sys.stdout.flush()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if most_s == float('inf'):
            used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            most_s = max(LEAST_S, PATIENCE * used_s)


if __name__ == '__main__':
    main(*sys.argv[1:])
