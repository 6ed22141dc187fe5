"""Settings of a process's garbage collector: when it examines all objects."""

from __future__ import annotations

import gc


def collect_rarely() -> None:
    """Make full collections rare in this process.

    A replay makes tens of thousands of receipts, and all of them stay. By default the interpreter
    would examine these and every object of the libraries a few times, a tenth of a second each.
    """
    gc.set_threshold(50_000, 20, 100)


def end_without_collecting() -> None:
    """Spare the interpreter its last look at all objects, just before the process ends.

    After a long replay it takes half a second; the system takes the memory back anyway. Exit
    functions run as ever.
    """
    gc.freeze()
