"""Runs one node's ``main`` in a process that cannot outlive the supervisor that started it.

``python -m polar_nav_tools.live.child SUPERVISOR_PID MODULE [--ros-args ...]``

Linux sends SIGTERM to this process when its parent dies, however it dies; so nothing is left
behind even after a ``kill -9`` of the supervisor. Asked for here, not in a preexec hook, because
those are unsafe in threaded programs.
"""

from __future__ import annotations

import ctypes
import faulthandler
import importlib
import os
import signal
import sys
from types import FrameType

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int) -> None:
    """Ask the kernel for SIGTERM at the parent's death; end at once if that has happened already.

    Raises
    ------
    SystemExit
        When ``parent_pid`` is not the parent any more.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f'prctl(PR_SET_PDEATHSIG): {os.strerror(number)}')
    if os.getppid() != parent_pid:
        raise SystemExit(128 + signal.SIGTERM)


def _leave(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)


def main() -> int:
    """Exit status of the node."""
    parent_pid, module = int(sys.argv[1]), sys.argv[2]
    # A signal before the node has its own handlers ends it at once, without a traceback.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    # Where it hangs, of all threads, also while it holds the interpreter's lock.
    faulthandler.register(signal.SIGQUIT, all_threads=True)
    die_with_parent(parent_pid)
    sys.argv = [module, *sys.argv[3:]]
    return int(importlib.import_module(module).main() or 0)


if __name__ == '__main__':
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # The node has ended in order; taking the interpreter apart only costs time, a dozen times.
    os._exit(status)
