"""Ends a node whose work is done although its middleware does not shut down.

Seen once in some hundred runs of thirteen nodes on a busy machine: a node that had flushed its
messages hung on its way out, was killed, and a complete run counted as failed.
"""

from __future__ import annotations

import faulthandler
import os
import sys
import threading

PATIENCE_S = 5.0
"""Time for a middleware to shut down [s]."""


def leave_within(patience_s: float, status: int) -> threading.Timer:
    """Timer, started, that ends this process with a status unless it is cancelled before.

    Parameters
    ----------
    patience_s : float
        [s].
    status : int
        Exit status of the node's work.
    """
    timer = threading.Timer(patience_s, _leave, (patience_s, status))
    timer.daemon = True
    timer.start()
    return timer


def _leave(patience_s: float, status: int) -> None:
    text = f'the middleware did not shut down within {patience_s:g} s: ended without it'
    print(text, file=sys.stderr)  # noqa: T201 - the logger is shut down
    faulthandler.dump_traceback()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
