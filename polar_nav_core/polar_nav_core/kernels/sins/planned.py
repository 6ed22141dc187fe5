"""Fixes in the streams of a filter that is recorded for a smoother, or run once more for it."""

from __future__ import annotations

from ..cache import kernel
from . import state as fs
from .rings import Log, Streams
from .settings import Settings
from .state import State


@kernel
def take_decision(s: State, log: Log, streams: Streams) -> None:
    """Take over what is decided of the next fix, and its number: its notes say so until then."""
    if log.hindsight.keeps[0] == 1:
        k = s.counters[fs.FIX] % streams.fix_stamps.shape[0]
        log.hindsight.fix[0] = streams.fix_notes[k, 0]
        log.hindsight.fix[1] = streams.fix_notes[k, 1]


@kernel
def refusal_stops(c: Settings, log: Log) -> bool:
    """Whether a fix that is refused ends processing: the engine has to answer it."""
    return bool(c.back_propagates or log.hindsight.keeps[0] == 1)
