"""Who compiles which kernel, where processes share that work.

A claim is a lock on one byte of a file in the cache, at a place that its name gives. The system
takes it back from a process that ends.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
from functools import cache
from pathlib import Path

FILE = '.claims'

_held: dict[str, tuple[int, int]] = {}


@cache
def _opened(path: Path) -> int:
    """Descriptor of a file; to close one would give all claims back."""
    return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)


def place_of(name: str) -> int:
    """Byte that stands for a name."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], 'big')


def claim(folder: Path, name: str) -> None:
    """Claim something by its name; waits as long as another process holds that.

    Where that cannot be (no locks here, or each would wait for the other) it is not claimed.
    """
    place = place_of(name)
    try:
        file = _opened(folder / FILE)
        fcntl.lockf(file, fcntl.LOCK_EX, 1, place)
    except OSError:
        return
    _held[name] = file, place


def release(name: str) -> None:
    """Give a claim back, if there is one."""
    held = _held.pop(name, None)
    if held is not None:
        fcntl.lockf(held[0], fcntl.LOCK_UN, 1, held[1])
