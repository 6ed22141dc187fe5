"""Setting of a process's garbage collector: interval of its full collections."""

from __future__ import annotations

import gc


def collect_rarely() -> None:
    """Make full collections rare in this process.

    A replay makes tens of thousands of receipts, and all of them stay. By default the interpreter
    would examine these and every object of the libraries a few times, a tenth of a second each.
    """
    gc.set_threshold(50_000, 20, 100)
