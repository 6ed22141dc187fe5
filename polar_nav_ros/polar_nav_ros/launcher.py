"""Ends a node in order when the process that launched it is gone, however that ended.

`ros2 launch` does not pass on a SIGTERM, and cannot pass on a SIGKILL: its nodes would live on. A
launch file names its own process in the environment; each node watches it. A node that was started
by hand has no such variable, and outlives the shell as any program under nohup does.
"""

from __future__ import annotations

import os
import select
import signal
import threading

LAUNCHER = 'POLAR_NAV_LAUNCHER'
"""Process id of the launcher."""


def watch_launcher() -> None:
    """Send SIGTERM to this process when the launcher that LAUNCHER names has ended.

    The kernel tells by a file descriptor of the process, so no other process with the same number
    can be taken for it, whatever shell or prefix stands between launcher and node.
    """
    named = os.environ.get(LAUNCHER, '')
    if not named.isdigit():
        return
    try:
        descriptor = os.pidfd_open(int(named))
    except ProcessLookupError:
        os.kill(os.getpid(), signal.SIGTERM)
        return
    except OSError:  # a kernel or a sandbox without it: the node has to be ended by hand
        return
    threading.Thread(target=_wait, args=(descriptor,), name='launcher', daemon=True).start()


def _wait(descriptor: int) -> None:
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    while not poll.poll():
        pass
    os.kill(os.getpid(), signal.SIGTERM)
