"""Nodes as a process: run until a signal, publish their last words, end with a status.

A middleware that does not shut down is left behind: seen once in some hundred runs of thirteen
nodes on a busy machine, where a node that had flushed its messages hung on its way out, was
killed, and a complete run counted as failed.
"""

from __future__ import annotations

import faulthandler
import gc
import inspect
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from polar_nav_core.errors import ConfigError, PolarNavError

from .arguments import require_reached, unread
from .launcher import watch_launcher
from .node import SUPERVISED, PolarNode

Kind = Callable[[], PolarNode[Any]]
"""Class of a node, which takes its name and parameters from the command line."""
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


def run(node_cls: Kind, args: Sequence[str] | None = None) -> int:
    """Exit status of one node, run until a signal or until it has ended by itself."""
    given = list(sys.argv[1:] if args is None else args)
    before_ros = given[: given.index('--ros-args')] if '--ros-args' in given else given
    if {'-h', '--help'} & set(before_ros):
        print(_help(node_cls))  # noqa: T201 - asked for
        return 0
    return run_together([node_cls], args)


def run_together(kinds: Sequence[Kind], args: Sequence[str] | None = None) -> int:
    """Exit status of nodes that share a process and an executor.

    They run until a signal, or until one of them has ended or failed. They are made and closed in
    the order given.

    rclpy's own signal handlers end the context at once, before a node can flush what it holds; so
    signals only set a flag here.
    """
    stop = Stop()
    watch_launcher()
    given = list(sys.argv[1:] if args is None else args)
    try:
        require_reached(given)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except (ConfigError, RuntimeError) as error:  # of rcl, on what stands after --ros-args
        print(f'after --ros-args: {_said(error)}', file=sys.stderr)  # noqa: T201 - no logger yet
        return 2
    nodes: list[PolarNode[Any]] = []
    status = 1  # of an error that nobody expected
    try:
        status = _live(kinds, nodes, stop, given)
    except PolarNavError as error:
        who = _who(kinds, nodes)
        text = str(error) if who is None else f'{who.__name__}: {error}'
        print(text, file=sys.stderr)  # noqa: T201 - there may be no logger yet
        status = 2 if isinstance(error, ConfigError) else 1
    finally:
        if status and len(kinds) > 1:
            _tell_who_failed(_who(kinds, nodes))
        _part(nodes, status)
    return status


def _said(error: Exception) -> str:
    """What an error of rcl says, without the places in its sources that it ends with."""
    text = re.sub(r', at /\S+?:\d+', '', str(error)).removeprefix('failed to initialize rcl: ')
    return f'unknown: {text}' if text.startswith('[') else text


def _live(
    kinds: Sequence[Kind], nodes: list[PolarNode[Any]], stop: Stop, given: Sequence[str] = ()
) -> int:
    """Exit status of the work of nodes, which are added to a list as they are made."""
    for kind in kinds:
        nodes.append(kind())
    for text in unread(given, [node.get_fully_qualified_name() for node in nodes]):
        nodes[0].get_logger().warning(text)
    executor = _executor()
    stop.listen()  # an executor of events has handlers of its own
    for node in nodes:
        executor.add_node(node)
    gc.collect()
    gc.freeze()  # what a node is made of stays: to look through it takes longer than a sample
    for node in nodes:
        node.tell_supervisor('ready', node.get_fully_qualified_name())
    with ExitStack() as ends:  # also of those beside a node that failed
        for node in reversed(nodes):
            ends.callback(_close, node)
        while stop.signal is None and all(n.ended is None for n in nodes) and rclpy.ok():
            executor.spin_until_future_complete(Future(), timeout_sec=0.2)
    return max(n.ended or 0 for n in nodes)


def _close(node: PolarNode[Any]) -> None:
    """Have a node publish its last words, unless it has failed."""
    if not node.failed:
        node.blamed(node.close)()
        node.flush()


def _who(kinds: Sequence[Kind], nodes: Sequence[PolarNode[Any]]) -> Kind | None:
    """Class of the node that failed, at work or while it was made; None if that is not known."""
    for kind, node in zip(kinds, nodes, strict=False):
        if node.failed or node.ended:
            return kind
    if len(kinds) == 1:
        return kinds[0]
    return kinds[len(nodes)] if len(nodes) < len(kinds) else None


def _tell_who_failed(kind: Kind | None) -> None:
    """Print for a supervisor which of several nodes failed, by the name of its program."""
    if SUPERVISED in os.environ and kind is not None:
        print(f'failed {program(kind)}', flush=True)  # noqa: T201


def _part(nodes: Sequence[PolarNode[Any]], status: int) -> None:
    """Tell what was counted, and leave the middleware."""
    for node in nodes:
        node.tell_counts()
    leaving = _leave_within(PATIENCE_S, status)
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()
    leaving.cancel()


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


def program(node_cls: Kind) -> str:
    """Name of a node's program, which is that of its module."""
    return node_cls.__module__.rpartition('.')[2]


def _help(node_cls: Kind) -> str:
    """What a node is, by the text of its module, and where its parameters stand."""
    usage = f'{program(node_cls)} --ros-args -r __ns:=/VEHICLE -p NAME:=VALUE --params-file FILE'
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
