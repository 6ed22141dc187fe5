"""Whether ``./polar`` compiles all kernels in the background, and how others wait for it.

After the first set-up it does for a minute or two, on both cores. Who needs a kernel meanwhile
waits until that one is there, in place of compiling it once more.
"""

from __future__ import annotations

import fcntl
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LOCK = '.polar_compiling'
"""File in an environment that ``./polar`` made: locked while it compiles there.

It names the process group that does, what for, and, in a third word, that the kernels are there
and only Python's own bytecode goes on.
"""
LOG = 'kernels.log'
"""Log of that beside it."""
COMPILES = 'POLAR_NAV_COMPILES'
"""Environment variable of the processes that do."""
_WORDS_WITH_KERNELS = 3
_PROGRESS = re.compile(r'\d+ of \d+ kernels are compiled')
_LOOK_EVERY_S = 0.2
_TELL_EVERY = 75
"""Looks from one line to the next: 15 s."""


def to_stderr(text: str) -> None:
    """Write a line."""
    sys.stderr.write(f'polar: {text}\n')
    sys.stderr.flush()


say: Callable[[str], None] | None = to_stderr
"""What tells that this process waits; None where something else does."""


def is_compiler() -> bool:
    """Whether this process is one of those that compile all kernels."""
    return bool(os.environ.get(COMPILES))


def compiles() -> bool:
    """Whether another process compiles all kernels into the cache of this environment."""
    if is_compiler():
        return False
    try:
        with (Path(sys.prefix) / LOCK).open('rb') as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return len(file.read().split()) < _WORDS_WITH_KERNELS
    except OSError:  # no such environment, or a file system without locks
        pass
    return False


def progress() -> str:
    """Last line of the compilers' log that says how far they are; where there is none, nothing."""
    try:
        text = (Path(sys.prefix) / LOG).read_text(encoding='utf-8', errors='replace')
    except OSError:
        return ''
    return next((line for line in reversed(text.splitlines()) if _PROGRESS.fullmatch(line)), '')


def awaited(look: Callable[[], Any], what: str = 'waiting') -> Any:  # noqa: ANN401 - what is awaited
    """Return what *look* finds: at once, or as long as kernels are compiled in the background.

    Parameters
    ----------
    look : callable
        Returns None until there is something.
    what : str
        Begin of the line that says so.
    """
    found = look()
    looks = 0
    while found is None and compiles():
        if say is not None and looks % _TELL_EVERY == 0:
            say(f'{what}: {progress() or "kernels are compiled"} in the background')
        looks += 1
        time.sleep(_LOOK_EVERY_S)
        found = look()
    # It may have ended between the last look and the question whether it goes on.
    return look() if found is None else found


def wait(what: str) -> None:
    """Wait until no kernels are compiled in the background any more."""
    awaited(lambda: None if compiles() else True, what)
