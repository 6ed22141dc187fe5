"""Hears a running graph for a while, as a recording of it: `polar map --live`.

The recorder of this project takes every topic into a temporary bag, with the QoS that it is
offered with, and the code that reads recordings does the rest.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.parameter import Parameter

from polar_nav_ros.topics import DIAGNOSTICS, RUN_INFO

from ..bags.errors import BagError, some_of
from ..record.recorder_node import RecorderNode
from .sources import Source, open_source

_OWN = ('/rosout', '/parameter_events', '/lockstep/ack', DIAGNOSTICS, RUN_INFO)
_NAME = 'recorder_node'
Progress = Callable[[float, float], None]
"""Called with the seconds that have passed and all of them."""


@dataclass(frozen=True)
class Heard:
    """What was heard of a running graph.

    Attributes
    ----------
    source : Source
        The recording of it.
    notes : tuple of str
        Sentences on the topics: rates, and why something is missing.
    """

    source: Source
    notes: tuple[str, ...]


class Listening(AbstractContextManager['Listening']):
    """A place for the recording of a running graph, which is gone at the end."""

    def __enter__(self) -> Listening:
        """Make the place."""
        self._folder = TemporaryDirectory(prefix='polar_map_')
        return self

    def __exit__(self, *_error: object) -> None:
        """Remove it."""
        self._folder.cleanup()

    def hear(
        self, seconds: float, progress: Progress | None = None, msg_path: Path | None = None
    ) -> Heard:
        """Record the graph of the shell's ROS domain.

        Parameters
        ----------
        seconds : float
            How long [s].
        progress : callable, optional
        msg_path : Path, optional
            As of `open_source`.

        Raises
        ------
        BagError
            When nothing was heard.
        """
        path = Path(self._folder.name) / 'heard'
        context = Context()
        rclpy.init(args=[], context=context)
        set_logger_level(_NAME, LoggingSeverity.WARN)  # it is no recording that stays
        try:
            node = RecorderNode(
                context=context,
                parameter_overrides=[
                    Parameter('output', value=str(path)),
                    Parameter('exclude', value=list(_OWN)),
                    Parameter('log_time', value='reception'),
                ],
            )
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(node)
            begin = time.monotonic()
            while (passed := time.monotonic() - begin) < seconds:
                executor.spin_once(timeout_sec=min(0.1, seconds - passed))
                if progress is not None:
                    progress(min(passed, seconds), seconds)
            node.close()
            skipped, taken = node.skipped, node.taken_counts()
            executor.shutdown()
            node.destroy_node()
        finally:
            context.try_shutdown()
        if not any(taken.values()):
            names = sorted({*taken, *skipped})
            there = f'published are {some_of(names)}' if names else 'no topic is published'
            domain = os.environ.get('ROS_DOMAIN_ID', '0')
            raise BagError(f'nothing was heard in {seconds:g} s: {there} in ROS domain {domain}')
        source = open_source(path, msg_path=msg_path)
        return Heard(source, tuple(_notes(source, skipped, seconds)))


def _notes(source: Source, skipped: dict[str, str], seconds: float) -> list[str]:
    topics = sorted(source.topics.values(), key=lambda t: t.name)
    notes = [f'{t.name}: {t.type}, {t.count / seconds:.3g} per second' for t in topics if t.count]
    notes += [f'{t.name}: {t.type}, nothing came' for t in topics if not t.count]
    return [*notes, *(f'{name}: not heard: {why}' for name, why in sorted(skipped.items()))]
