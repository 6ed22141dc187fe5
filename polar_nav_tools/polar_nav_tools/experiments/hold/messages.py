"""A world as the messages of a follower, a fault in them, and what the follower made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.grid import ecef_to_grid
from polar_nav_ros.cdr import to_bytes

from ...inject.faults import Injection, inject
from ...inject.messages import STREAM_OF, change, reading_of
from ...inject.readings import Reading
from ..received import Received
from ..station.world import StationWorld
from ..station_choices import StationChoices
from ..world import World
from .drive import Taken
from .judge import Errors
from .rows import true_positions
from .trace import Trace

_OUTPUT_S = 0.5


def start_ns_of(world: World | StationWorld) -> int:
    """True time of the start of a world [ns]."""
    return world.truth.start_ns if isinstance(world, World) else world.run.start_ns


def taken(messages: Sequence[Received]) -> list[Taken]:
    """Messages as a follower takes them, with what they state."""
    return [
        Taken(
            one,
            to_bytes(one.message),
            reading_of(STREAM_OF[one.topic], number, one.message, one.arrival_ns),
        )
        for number, one in enumerate(messages)
    ]


def with_faults(
    messages: Sequence[Taken], injections: Sequence[Injection], seed: int
) -> list[Taken]:
    """Messages with faults, as they arrive; those that they leave alone keep their bytes."""
    before = [one.reading for one in messages]
    return [_changed(messages[r.number], r) for r in inject(before, injections, seed)]


def _changed(old: Taken, reading: Reading) -> Taken:
    if reading is old.reading:
        return old
    topic, message, _ = old.received
    changed = deserialize_message(old.data, type(message))
    change(changed, old.reading, reading)
    return Taken(Received(topic, changed, reading.arrival_ns), to_bytes(changed), reading)


def params_of(world: World | StationWorld, changes: Mapping[str, Any]) -> EngineParams:
    """Parameters of the engine in a world, with changes."""
    usual = {'output_period_s': _OUTPUT_S, **changes}
    if isinstance(world, World):
        return world.params(**usual)
    return world.params(StationChoices(), 0.0, **usual)


def errors_of(world: World | StationWorld, trace: Trace, length_s: float) -> Errors:
    """Errors of the estimates within the run, in the order of their true times."""
    inside = np.flatnonzero((trace.time_s >= 0.0) & (trace.time_s <= length_s))
    rows = inside[np.argsort(trace.time_s[inside], kind='stable')]
    true_e = true_positions(world, trace.time_s[rows])
    d_r_e = trace.r_e[rows] - true_e
    C_e_G = np.asarray(ecef_to_grid(true_e)) if len(rows) else np.zeros((0, 3, 3))
    return Errors(trace.time_s[rows], np.einsum('nij,nj->ni', C_e_G, d_r_e), trace.sigma_G[rows])
