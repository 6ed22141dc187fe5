"""Sets how often the garbage collector of a process looks for cycles."""

from __future__ import annotations

import gc


def collect_rarely() -> None:
    """Go through all objects once in a long while only; for a process of its own.

    A replay makes receipts by the ten thousand, and all of them stay. By its own measure the
    interpreter would go through these and through every object of the libraries a few times on
    the way, a tenth of a second each.
    """
    gc.set_threshold(50_000, 20, 100)
