"""Inputs of a follower in a recorded run as events, in their order.

The bag is read again for each replay, so that no length of it needs memory; what the live node
published is read when it is compared.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import TimeReference
from std_msgs.msg import String

from polar_nav_core.engine.events import ClockStep, CommandKind, Event
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Command, Restore
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Taken
from polar_nav_ros.navigation_outputs import clock_step_from_msg
from polar_nav_ros.navigation_session import MODEL_OUTPUTS, SENSORS
from polar_nav_ros.stamps import stamp_ns_of_cdr

from ..bags.errors import BagError, WrongRequestError, some_of
from ..bags.opening import open_bag
from ..bags.reader import Bag
from .constants import mode_table, require_same
from .described import FOLLOWER_PACKAGE, Description, descriptions_of
from .life import Life
from .lives import lives_of, taken_counts
from .records import Input, Records, stamp_of
from .used import Used, used_of

COMPARED = (topics.STATE, topics.RECEIPT)
"""Topics that a replay reproduces bit for bit; and those of `MODEL_OUTPUTS` that the bag has."""

_HOLE = 'hole'
"""Stands for the name of a topic."""
_TYPES: dict[str, type[Any]] = {
    **SENSORS,
    topics.RX: AcousticPacket,
    topics.COMMAND: Command,
    topics.RESTORE: Restore,
}


@dataclass(frozen=True)
class RecordedInputs:
    """Recorded inputs of one follower as events.

    Attributes
    ----------
    bag : Bag
        Where it comes from.
    vehicle : str
        The follower.
    params : mapping
        Parameters that reproduce its node's run.
    lives : tuple of Life
        What its node took and published; several where it was started again.
    imu : str
        Topic of the IMU that the node took.
    engine_version : int
        Engine that recorded the run.
    retired : list of str
        One sentence for each recorded parameter that was retired since.
    used : Used or None
        What the node used of the sources of its mapping file; it is among the messages.
    """

    bag: Bag
    vehicle: str
    params: Mapping[str, Any]
    lives: tuple[Life, ...]
    imu: str = topics.IMU
    engine_version: int = ENGINE_VERSION
    retired: list[str] = field(default_factory=list)
    used: Used | None = None

    def new_session(self, params: FollowerParams) -> session.Session:
        """Session that takes these messages, with other parameters perhaps."""
        sources = None if self.used is None else self.used.sources(params)
        return session.Session(params, self.vehicle, sources)

    @property
    def live(self) -> dict[str, list[bytes]]:
        """What the live node published on the compared topics, in all its lives."""
        return {t: [d for life in self.lives for d in life.live[t]] for t in self.lives[0].live}

    def events(self, run: session.Session, life: Life) -> Iterator[Event]:
        """Events of a life in their total order, without those that the live node refused.

        They are made while they are gone through, once.

        Raises
        ------
        BagError
            For a message that can be decoded and still makes no sense.
        """
        before = self.new_session(run.params)
        return life.events(run, before, f'{self.bag.path}: a message on /{self.vehicle}')


def load_inputs(
    bag: Bag | Path | str, vehicle: str | None = None, changes: Mapping[str, Any] | None = None
) -> RecordedInputs:
    """Inputs and outputs of a follower, read from a bag.

    Parameters
    ----------
    bag : Bag or path
        Recorded run.
    vehicle : str, optional
        Which follower, when there are several.
    changes : mapping, optional
        Other parameters than the recorded ones: which topics are taken depends on them.

    Raises
    ------
    BagError
        When there is no such follower, it took no IMU data, or a message cannot be decoded.
    ConfigError
        For parameters that follower_node does not take.
    """
    bag = bag if isinstance(bag, Bag) else open_bag(bag)
    name, described = choose_description(bag, vehicle)
    described.require_known()
    params = described.params
    changed = from_mapping(FollowerParams, {**params, **(changes or {})})
    used = used_of(bag, name, described.sources, changed) if described.sources else None
    inputs = _recorded_topics(bag, name, changed, used)
    compared = (*COMPARED, *(t for t in MODEL_OUTPUTS if f'/{name}/{t}' in bag.topics))
    by_name = {f'/{name}/{t}': t for t in (*inputs, *compared, topics.CLOCK_STEP)}
    require_same(bag, by_name)
    imu = session.sensors_of(changed)[0]
    source = _Source(bag, name, by_name, compared, used)
    records = Records(by_name, compared, source.inputs, source.outputs)
    for entry in source.entries():
        source.note(entry, records)
    try:
        lives = lives_of(records, imu, injected=bool(bag.injected))
    except (RuntimeError, ValueError, MemoryError) as error:
        raise BagError(f'{bag.path}: a receipt of /{name} is damaged: {error}') from error
    unheard = {topic: bag.unheard(f'/{name}/{topic}') for topic in compared}
    lives[0] = replace(lives[0], unheard=unheard)
    return RecordedInputs(
        bag=bag,
        vehicle=name,
        params=params,
        lives=tuple(lives),
        imu=imu,
        engine_version=described.engine_version,
        retired=described.retired_texts(),
        used=used,
    )


class _Entry(NamedTuple):
    """One message of a follower in its bag; without a topic its description, or a hole."""

    topic: str | None
    name: str
    arrival_ns: int
    content: bytes | Taken


@dataclass(frozen=True)
class _Source:
    """What a bag holds of one follower, gone through as often as it is wanted.

    Attributes
    ----------
    bag, vehicle
        The follower.
    by_name : mapping of str to str
        Topics without the vehicle by their full names.
    compared : tuple of str
        Topics of its outputs.
    used : Used or None
        What it used of mapped sources.
    """

    bag: Bag
    vehicle: str
    by_name: Mapping[str, str]
    compared: tuple[str, ...]
    used: Used | None

    def entries(self) -> Iterator[_Entry]:
        """All messages of the follower in the order of the bag."""
        blocks = iter(() if self.used is None else self.used.blocks)
        used_names = set() if self.used is None else {f'/{self.vehicle}/{topics.INPUTS}'}
        kept = set[tuple[str, bytes]]()
        holes_ns = [begin_ns for _, begin_ns in self.bag.holes_ns]
        names = {*self.by_name, *used_names, topics.RUN_INFO}
        for full_name, arrival_ns, data in self.bag.messages(names):
            while holes_ns and arrival_ns >= holes_ns[0]:
                yield _Entry(None, _HOLE, holes_ns.pop(0), b'')
            topic = self.by_name.get(full_name)
            if topic in topics.KEPT:
                if (topic, data) in kept:
                    continue
                kept.add((topic, data))
            if full_name in used_names:
                for role, taken in next(blocks):
                    yield _Entry(role, full_name, taken.arrival_ns, taken)
            elif topic is not None or _describes(data, self.vehicle):
                yield _Entry(topic, full_name, arrival_ns, data)

    def note(self, entry: _Entry, records: Records) -> None:
        """Add a message to the records."""
        topic, name, arrival_ns, content = entry
        if isinstance(content, Taken):
            records.input(str(topic), content.stamp_ns, arrival_ns, mapped=True)
        elif topic is None:
            records.hole() if name == _HOLE else records.born()
        elif topic in self.compared:
            records.output(topic, content)
        elif topic == topics.CLOCK_STEP:
            records.step(_step(self.bag, name, content))
        else:
            end = self._end_of(entry)
            if end is not None:
                records.end(taken_counts(end))
                return
            try:
                stamp_ns = stamp_ns_of_cdr(content)
            except (LookupError, struct.error):
                stamp_ns = stamp_of(self._message(entry))  # says what it is
            records.input(topic, stamp_ns, arrival_ns)

    def inputs(self) -> Iterator[Input]:
        """All messages that a node may have taken, as topics and what decodes them."""
        for entry in self.entries():
            topic = entry.topic
            if topic is None or topic == topics.CLOCK_STEP or topic in self.compared:
                continue
            if self._end_of(entry) is None:
                yield topic, partial(self._message, entry)

    def outputs(self) -> Iterator[tuple[str, bytes]]:
        """All messages on compared topics that a node published."""
        for topic, _, _, content in self.entries():
            if topic in self.compared and isinstance(content, bytes):
                yield topic, content

    def _end_of(self, entry: _Entry) -> Command | None:
        """The command with which a node ended in order; None of any other message."""
        if entry.topic != topics.COMMAND:
            return None
        command: Command = self._message(entry)
        return command if command.kind == CommandKind.SHUTDOWN else None

    def _message(self, entry: _Entry) -> Any:  # noqa: ANN401 - of any topic
        """Decoded message of an input, with the constants of the installed definition."""
        topic, name, _, content = entry
        if isinstance(content, Taken):
            return content
        message = decoded(self.bag, name, content, _TYPES[str(topic)])
        if topic == topics.DVL and self._modes is not None:
            message.velocity_mode = int(self._modes[message.velocity_mode])
        return message

    @cached_property
    def _modes(self) -> Any:  # noqa: ANN401 - of `mode_table`
        return mode_table(self.bag, f'/{self.vehicle}/{topics.DVL}')


def _recorded_topics(
    bag: Bag, name: str, params: FollowerParams, used: Used | None
) -> tuple[str, ...]:
    """Topics of the vehicle that a follower took, without those that sources stand for.

    Raises
    ------
    BagError
        When the bag has no IMU data.
    """
    if used is None:
        inputs = session.inputs_of(params)
        bag.require([f'/{name}/{inputs[0]}'])
        return inputs
    mapped = used.sources(params)
    return tuple(t for t in session.inputs_of(params, mapped) if mapped.of(t) is None)


def _step(bag: Bag, topic: str, data: bytes) -> ClockStep:
    """Step of a clock of its recorded bytes."""
    try:
        return clock_step_from_msg(decoded(bag, topic, data, TimeReference))
    except ValueError as error:
        raise BagError(f'{bag.path}: a message on {topic} is damaged: {error}') from error


def _describes(data: bytes, vehicle: str) -> bool:
    """Whether a message on /run_info is of the follower_node of a vehicle."""
    try:
        info = json.loads(deserialize_message(data, String).data)
    except (RuntimeError, ValueError, MemoryError, RecursionError):
        return False  # read for lives only; what it has to state is read elsewhere
    return (
        isinstance(info, dict)
        and info.get('package') == FOLLOWER_PACKAGE
        and str(info.get('node', '')).startswith(f'/{vehicle}/')
    )


def followers_of(bag: Bag) -> dict[str, dict[str, Any]]:
    """Parameters of all followers that are described in the bag, by vehicle."""
    return {name: described.params for name, described in descriptions_of(bag).items()}


def choose_follower(bag: Bag, vehicle: str | None) -> tuple[str, dict[str, Any]]:
    """Vehicle and parameters of the follower to replay.

    Raises
    ------
    BagError
        As `choose_description`.
    ConfigError
        For a recorded parameter that is neither declared nor retired.
    """
    name, described = choose_description(bag, vehicle)
    described.require_known()
    return name, described.params


def choose_description(bag: Bag, vehicle: str | None) -> tuple[str, Description]:
    """Vehicle and description of the follower to replay.

    Raises
    ------
    BagError
        When there is none, or several and none was named.
    """
    found = descriptions_of(bag)
    if not found:
        raise BagError(
            f'{bag.path} tells of no follower_node on /run_info, so its parameters are not '
            'known; record with ./polar record or recorder_node'
        )
    if vehicle is None:
        if len(found) > 1:
            raise WrongRequestError(
                f'{bag.path} has {len(found)} followers ({some_of(found)}): '
                'name one with --vehicle'
            )
        vehicle = next(iter(found))
    elif vehicle not in found:
        raise WrongRequestError(f'{bag.path} has no follower {vehicle!r}; it has {some_of(found)}')
    return vehicle, found[vehicle]


def decoded(bag: Bag, topic: str, data: bytes, msg_type: type[Any]) -> Any:  # noqa: ANN401
    """Message decoded from recorded bytes; BagError if they are none."""
    try:
        return deserialize_message(data, msg_type)
    except (RuntimeError, ValueError, MemoryError) as error:
        raise BagError(
            f'{bag.path}: a message on {topic} is no {msg_type.__name__} message'
        ) from error
