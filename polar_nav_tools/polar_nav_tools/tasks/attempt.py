"""One task done, wherever that is: its row, or why it failed."""

from __future__ import annotations

import pickle
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import PolarNavError

from ..live import run_info
from .packing import pack
from .rows import DONE, FAILED, STOPPED, Row

_SOURCES = Path(__file__).resolve().parents[3]
_ONE_AT_A_TIME = threading.Lock()
"""A worker may have several threads; runs keep their last world, and share it with no other."""


class Result(Protocol):
    """Result of a task: a dataclass with these fields, which need not be all."""

    @property
    def names(self) -> Mapping[str, str | int | float]:
        """What it is called in its row, besides the names of its task."""

    @property
    def metrics(self) -> Mapping[str, float]:
        """Numbers by name."""

    @property
    def reason(self) -> str:
        """Why a filter stopped; empty if it did not."""

    @property
    def seconds(self) -> float:
        """Processor time of the filter [s]."""


@dataclass(frozen=True)
class Task:
    """One task.

    Attributes
    ----------
    key : str
        Of its content (`keys.key_of`).
    names : mapping
        What it is called in its row.
    argument : object
        What it is done with; goes to other processes.
    stretch : object
        Equal for neighbours that share what takes long to make, so that one worker does them.
    """

    key: str
    names: Mapping[str, str | int | float]
    argument: Any
    stretch: object = None


@dataclass(frozen=True)
class Attempt:
    """Row of a task, and its error if it failed."""

    row: Row
    error: Exception | None = field(default=None)


class DifferentWorker(PolarNavError):
    """A worker has another engine than who asks it."""


def attempt(
    call: Callable[[Any], Result], task: Task, engine_version: int = ENGINE_VERSION
) -> Attempt:
    """Row of a task that is done now, in this process.

    Raises
    ------
    DifferentWorker
        If this process has another version of the engine than asked for.
    """
    if engine_version != ENGINE_VERSION:
        raise DifferentWorker(
            f'a worker has engine {ENGINE_VERSION}, this command {engine_version}: both need the'
            ' same polar_nav'
        )
    with _ONE_AT_A_TIME:
        try:
            result = call(task.argument)
        except Exception as error:  # noqa: BLE001 - a failed task is a row
            return failed(task, error)
    return Attempt(_row(task, result))


def _row(task: Task, result: Result) -> Row:
    assert is_dataclass(result)
    timeless: Any = replace(result, seconds=0.0)
    return Row(
        task.key,
        STOPPED if result.reason else DONE,
        {**task.names, **result.names},
        result.metrics,
        result.reason,
        '',
        result.seconds,
        *_made_here(),
        pack(timeless),
    )


def failed(task: Task, error: Exception) -> Attempt:
    """Row of a task that ended by an error, which is sent along if it can be."""
    lines = traceback.extract_tb(error.__traceback__)
    where = (
        f'{Path(lines[-1].filename).name}:{lines[-1].lineno} in {lines[-1].name}' if lines else ''
    )
    reason = f'{type(error).__name__}: {error}'
    by, cpu = _made_here()
    row = Row(task.key, FAILED, task.names, {}, reason, where, made_by=by, cpu=cpu)
    error.add_note(''.join(traceback.format_exception(error)))
    return Attempt(row, _sendable(error))


def _sendable(error: Exception) -> Exception:
    """Error, or one with its text if it cannot go to another process."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever a class of errors does when copied
        return RuntimeError(f'{type(error).__name__}: {error}')
    return error


@lru_cache(maxsize=1)
def _made_here() -> tuple[str, str]:
    """Commit or version of the sources, and the processor."""
    return run_info.git_commit(_SOURCES) or f'engine {ENGINE_VERSION}', run_info.cpu_model()
