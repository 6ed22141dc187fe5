"""Reads the inputs of a follower in a recorded run as `arrays`, for the fast replay.

The same rules as in `recorded`, for whole columns: each topic numbered in the order of the
bag, up to where the node ended, without what it refused. One reader serves both modes of the
follower; `MODES` has what differs. A run with messages of another definition than the installed
one, or with anything else that a mode does not read as arrays, is left to `recorded`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from polar_nav_core import spilled
from polar_nav_core.engine.events import CommandKind
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_ros import topics
from polar_nav_ros.readers import command_from_msg

from ..bags import arrays
from ..bags.columns import Columns
from ..bags.decode import is_installed
from ..bags.errors import BagError
from ..bags.reader import Bag
from ..bags.request import Request, Tables
from ..bags.tables import read_tables
from .arrays import (
    ORIENTATION,
    RATE,
    SPECIFIC_FORCE,
    STAMP,
    THRUST,
    TORQUE,
    VELOCITY,
    SinsArrays,
    StationArrays,
)
from .constants import mode_table, require_same
from .fix_columns import packets_of, refusals_of
from .lives import taken_counts
from .recorded import choose_follower, decoded

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Mode:
    """Rules to read runs of one mode of the follower as arrays.

    Attributes
    ----------
    kind : type
        Makes the engine's inputs of the columns.
    fields : mapping of str to fields
        Local sensors, the IMU first, and what becomes a column of them.
    commands : tuple of CommandKind
        What the arrays can have besides the end of the run.
    any_order : bool
        Whether topics may be absent, stamps run backwards, and messages have been refused because
        they came too late.
    unread : tuple of str
        Columns that the engine's arrays have no place for: they must be finite, as an event whose
        numbers are not gets a receipt.
    """

    kind: type[SinsArrays | StationArrays]
    fields: Mapping[str, tuple[str | tuple[str, ...], ...]]
    commands: tuple[CommandKind, ...] = ()
    any_order: bool = True
    unread: tuple[str, ...] = ()

    def takes(self, found: Sequence[Columns], refused: Sequence[Receipt]) -> bool:
        """Whether a run with these columns can be replayed from arrays."""
        if self.any_order:
            return True
        return not refused and all(
            spilled.ascending(c[STAMP])
            and all(bool(np.isfinite(c[n]).all()) for n in self.unread if n in c)
            for c in found
        )


MODES = {
    'sins': Mode(
        SinsArrays,
        {
            topics.IMU: (arrays.STAMP, RATE, SPECIFIC_FORCE),
            topics.DVL: (
                arrays.STAMP,
                VELOCITY,
                'velocity_covar',
                'velocity_mode',
                'num_good_beams',
                'dvl_type',
                'sound_speed',
            ),
            topics.DEPTH: (arrays.STAMP, 'depth', 'variance'),
        },
    ),
    'station': Mode(
        StationArrays,
        {
            topics.AHRS: (
                arrays.STAMP,
                RATE,
                SPECIFIC_FORCE,
                ORIENTATION,
                'orientation_covariance',
            ),
            topics.CONTROL: (arrays.STAMP, THRUST, TORQUE),
            topics.DEPTH: (arrays.STAMP, 'depth', 'variance'),
        },
        commands=(CommandKind.IDENTIFY,),
        any_order=False,
        unread=(SPECIFIC_FORCE[0], TORQUE[0]),
    ),
}
"""By the follower's parameter ``mode``."""


def arrays_request(bag: Bag, vehicle: str | None = None, *, truth: bool = False) -> Request | None:
    """Topics and fields that `load_arrays` reads; None for a run that must be replayed by message.

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, recorded = choose_follower(bag, vehicle)
    params = from_mapping(FollowerParams, recorded)
    inputs = bag.topics.get(f'/{name}/{topics.INPUTS}')
    if inputs is not None and inputs.count:
        return None  # of mapped sources, which are adapted one by one
    if bag.injected:
        return None  # nobody has sorted its messages or refused late ones
    mode = MODES[params.mode]
    taken = (*mode.fields, topics.RX, topics.COMMAND)
    if f'/{name}/{topics.RESTORE}' in bag.topics:
        return None  # the start is a message
    steps = bag.topics.get(f'/{name}/{topics.CLOCK_STEP}')
    if steps is not None and steps.count:
        return None  # of clocks that stepped, or of a node that may have been started again
    if tuple(t for t in session.inputs_of(params) if t != topics.RESTORE) != taken:
        return None  # with thrust beside a DVL
    bag.require([f'/{name}/{taken[0]}'])
    if not all(_plain(bag, f'/{name}/{topic}') for topic in taken):
        return None
    require_same(bag, (f'/{name}/{topic}' for topic in (*taken, topics.RECEIPT)))
    wanted = {f'/{name}/{topic}': names for topic, names in mode.fields.items()}
    topic = f'/{name}/{topics.TRUTH}'
    if truth and topic in bag.topics and bag.channel(topic).type == arrays.TRUTH_TYPE:
        wanted[topic] = arrays.TRUTH_FIELDS
    raw = (topics.RX, topics.COMMAND, topics.RECEIPT)
    return Request(wanted, tuple(f'/{name}/{topic}' for topic in raw))


def load_arrays(
    bag: Bag, vehicle: str | None = None, *, truth: bool = False, progress: Progress | None = None
) -> SinsArrays | StationArrays | None:
    """Inputs of a follower, read in one pass; None for a run that must be replayed by message.

    A bag that was opened with `arrays_request` ahead was read then.

    Parameters
    ----------
    bag : Bag
    vehicle : str, optional
        Which follower, when there are several.
    truth : bool
        Read its truth on the way.
    progress : callable, optional

    Raises
    ------
    BagError
        When there is no such follower, or it took no IMU data.
    """
    name, params = choose_follower(bag, vehicle)
    request = arrays_request(bag, vehicle, truth=truth)
    if request is None:
        return None
    mode = MODES[from_mapping(FollowerParams, params).mode]
    packet, command, receipt = request.raw
    try:
        tables = read_tables(bag, *request, progress=progress)
        commands = [decoded(bag, command, d, CommandMsg) for d in tables.payloads[command]]
        packets = packets_of(bag, packet, tables.payloads[packet])
        refused = refusals_of(bag, receipt, tables.payloads[receipt])
    except BagError:
        return None  # decoding by message says what is wrong, or does not need it
    asked = [c for c in commands if c.kind != CommandKind.SHUTDOWN]
    if any(c.kind not in mode.commands for c in asked):
        return None
    if not mode.any_order and any(f'/{name}/{t}' not in tables.columns for t in mode.fields):
        return None
    limits = _limits([c for c in commands if c.kind == CommandKind.SHUTDOWN])
    columns = {
        topic: _up_to(tables, f'/{name}/{topic}', fields, limits)
        for topic, fields in mode.fields.items()
    }
    if not mode.takes(list(columns.values()), refused):
        return None
    if topics.DVL in columns:
        _renumber_modes(columns[topics.DVL], bag, f'/{name}/{topics.DVL}')
    found = tables.columns.get(f'/{name}/{topics.TRUTH}')
    return mode.kind(
        bag=bag,
        vehicle=name,
        params=params,
        columns=columns,
        packets=packets[: limits.get(packet)],
        commands=[command_from_msg(c, k) for k, c in enumerate(asked)],
        refused=refused,
        truth=None if found is None else arrays.truth_of(found, name),
    )


def _limits(ends: Sequence[Any]) -> dict[str, int]:
    """Number of messages per full topic name received by the node at its end; empty without."""
    if not ends:
        return {}
    return taken_counts(ends[-1])


def _renumber_modes(dvl: Columns, bag: Bag, topic: str) -> None:
    """Convert DVL modes from the constants of the bag to the installed ones, in place."""
    modes = mode_table(bag, topic)
    if modes is not None:
        dvl['velocity_mode'] = modes[dvl['velocity_mode'].astype(np.intp)]


def _plain(bag: Bag, topic: str) -> bool:
    """Whether a topic is absent, or has messages of the installed definition."""
    return topic not in bag.topics or is_installed(bag.channel(topic))


def _up_to(
    tables: Tables, topic: str, fields: tuple[str | tuple[str, ...], ...], limits: dict[str, int]
) -> Columns:
    """Columns of a topic up to the last message that the node received; empty without messages."""
    found = tables.columns.get(topic)
    if found is not None:
        return {name: column[: limits.get(topic)] for name, column in found.items()}
    empty: Columns = {}
    for names in fields:
        name = names if isinstance(names, str) else names[0]
        width = {VELOCITY[0]: (3,), 'velocity_covar': (9,)}.get(name, ())
        dtype = np.int64 if name == STAMP else np.float64
        empty[name] = np.zeros((0, *width), dtype=dtype)
    return empty
