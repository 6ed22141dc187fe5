"""A node as a process: runs until a signal, publishes its last words, ends with a status.

A middleware that does not shut down is left behind: seen once in some hundred runs of thirteen
nodes on a busy machine, where a node that had flushed its messages hung on its way out, was
killed, and a complete run counted as failed.
"""

from __future__ import annotations

import faulthandler
import gc
import inspect
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from polar_nav_core.errors import ConfigError, PolarNavError

from .launcher import watch_launcher
from .node import PolarNode

PATIENCE_S = 5.0
"""Time for a middleware to shut down [s]."""


class Stop:
    """Set by SIGINT or SIGTERM.

    The spin loop looks at it between turns, so a node can still publish its last words.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self.listen()

    def listen(self) -> None:
        """Take the two signals, also from who took them since."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.signal = number


def run(node_cls: Callable[[], PolarNode[Any]], args: Sequence[str] | None = None) -> int:
    """Exit status of one node, run until a signal or until it has ended by itself.

    rclpy's own signal handlers end the context at once, before a node can flush what it holds; so
    signals only set a flag here.
    """
    given = list(sys.argv[1:] if args is None else args)
    before_ros = given[: given.index('--ros-args')] if '--ros-args' in given else given
    if {'-h', '--help'} & set(before_ros):
        print(_help(node_cls))  # noqa: T201 - asked for
        return 0
    stop = Stop()
    watch_launcher()
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node: PolarNode[Any] | None = None
    status = 1  # of an error that nobody expected
    try:
        node = node_cls()
        executor = _executor()
        stop.listen()  # an executor of events has handlers of its own
        executor.add_node(node)
        gc.collect()
        gc.freeze()  # what a node is made of stays: to look through it takes longer than a sample
        node.tell_supervisor('ready', node.get_fully_qualified_name())
        while stop.signal is None and node.ended is None and rclpy.ok():
            executor.spin_once(timeout_sec=0.2)
        node.close()
        node.flush()
        status = node.ended or 0
    except ConfigError as error:
        print(f'{node_cls.__name__}: {error}', file=sys.stderr)  # noqa: T201 - before there is a logger
        status = 2
    except PolarNavError as error:
        print(f'{node_cls.__name__}: {error}', file=sys.stderr)  # noqa: T201
        status = 1
    finally:
        if node is not None:
            node.tell_counts()
        leaving = _leave_within(PATIENCE_S, status)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        leaving.cancel()
    return status


def _executor() -> Executor:
    """Executor that the middleware tells of messages; in an older rclpy, one that asks for them.

    To ask takes a third of the processor time of a follower: all that a node waits for is put
    together anew in every turn.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # before 7.1.4
        return SingleThreadedExecutor()
    return EventsExecutor()


def _help(node_cls: Callable[[], PolarNode[Any]]) -> str:
    """What a node is, by the text of its module, and where its parameters stand."""
    name = sys.modules[node_cls.__module__].__name__.rpartition('.')[2]
    usage = f'{name} --ros-args -r __ns:=/VEHICLE -p NAME:=VALUE --params-file FILE'
    text = inspect.getdoc(sys.modules[node_cls.__module__]) or ''
    return f'Usage: {usage}\n\n{text}\n\nParameters, those that matter first: docs/parameters.md'


def _leave_within(patience_s: float, status: int) -> threading.Timer:
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
