"""Inputs of a follower in a recorded run as events, read in one pass over the bag.

The messages are decoded once and serve any number of replays; what the live node published is kept
as bytes, to be compared with.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import TimeReference

from polar_nav_core.engine.events import ClockStep, CommandKind, Event, Fix, Receipt, Verdict
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Command, FixReceipt, Restore
from polar_nav_ros import topics
from polar_nav_ros.navigation_outputs import clock_step_from_msg, receipt_from_msg
from polar_nav_ros.navigation_session import MODEL_OUTPUTS, SENSORS

from ..bags.errors import BagError, WrongRequestError, some_of
from ..bags.opening import open_bag
from ..bags.reader import Bag
from .constants import mode_table, require_same
from .described import Description, descriptions_of

COMPARED = (topics.STATE, topics.RECEIPT)
"""Topics that a replay reproduces bit for bit; and those of `MODEL_OUTPUTS` that the bag has."""

_TYPES: dict[str, type[Any]] = {
    **SENSORS,
    topics.RX: AcousticPacket,
    topics.COMMAND: Command,
    topics.RESTORE: Restore,
}
_NO_LIMIT = 1 << 62


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
    messages : list of (str, message)
        Inputs by topic without the vehicle, each topic in its order, up to where the node ended.
    refused : list of Receipt
        What the live node refused because it came too late.
    live : mapping of str to list of bytes
        What the live node published on the compared topics.
    steps : list of ClockStep
        Of the clocks of its topics, as the live node found them.
    arrivals_ns : list of int
        When the messages were recorded, for a bag with injected faults [ns].
    imu : str
        Topic of the IMU that the node took.
    engine_version : int
        Engine that recorded the run.
    retired : list of str
        One sentence for each recorded parameter that was retired since.
    """

    bag: Bag
    vehicle: str
    params: Mapping[str, Any]
    messages: list[tuple[str, Any]]
    refused: list[Receipt]
    live: Mapping[str, list[bytes]]
    steps: list[ClockStep] = field(default_factory=list)
    arrivals_ns: list[int] = field(default_factory=list)
    imu: str = topics.IMU
    engine_version: int = ENGINE_VERSION
    retired: list[str] = field(default_factory=list)

    def events(self, run: session.Session) -> list[Event]:
        """Events in their total order, without those that the live node refused.

        Raises
        ------
        BagError
            For a message that can be decoded and still makes no sense.
        """
        refused = Counter(refusal_key(r) for r in self.refused)
        events: list[Event] = []
        for step in self.steps:
            run.engine.clock.note(step)
        for topic, message in self.messages:
            try:
                event = run.recorded_event_of(topic, message)
            except ValueError as error:
                where = f'{self.bag.path}: a message on /{self.vehicle}/{topic}'
                raise BagError(f'{where} makes no sense: {error}') from error
            key = event_key(event)
            if refused[key]:
                refused[key] -= 1
            else:
                events.append(event)
        # Contents of packets, for people: the live run published them, a replay does not.
        for _ in run.decoded():
            pass
        events.sort(key=lambda e: e.key)
        return events


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
    inputs = session.inputs_of(from_mapping(FollowerParams, {**params, **(changes or {})}))
    bag.require([f'/{name}/{inputs[0]}'])
    compared = (*COMPARED, *(t for t in MODEL_OUTPUTS if f'/{name}/{t}' in bag.topics))
    by_name = {f'/{name}/{t}': t for t in (*inputs, *compared, topics.CLOCK_STEP)}
    messages: list[tuple[str, Any]] = []
    steps: list[ClockStep] = []
    arrivals_ns: list[int] = []
    live: dict[str, list[bytes]] = {topic: [] for topic in compared}
    limits: dict[str, int] | None = None
    require_same(bag, by_name)
    modes = mode_table(bag, f'/{name}/{topics.DVL}')
    for full_name, arrival_ns, data in bag.messages(by_name):
        topic = by_name[full_name]
        if topic in live:
            live[topic].append(data)
            continue
        if topic == topics.CLOCK_STEP:
            steps.append(_step(bag, full_name, data))
            continue
        message = decoded(bag, full_name, data, _TYPES[topic])
        if topic == topics.DVL and modes is not None:
            message.velocity_mode = int(modes[message.velocity_mode])
        if topic == topics.COMMAND and message.kind == CommandKind.SHUTDOWN:
            limits = taken_counts(message)
        else:
            messages.append((topic, message))
            arrivals_ns.append(arrival_ns)
    receipt_topic = f'/{name}/{topics.RECEIPT}'
    receipts = [decoded(bag, receipt_topic, d, FixReceipt) for d in live[topics.RECEIPT]]
    refused = [receipt_from_msg(r) for r in receipts if never_an_event(r)]
    if limits is not None and not bag.injected:  # it counted what came without the faults
        messages = _up_to(messages, {t: limits.get(f, _NO_LIMIT) for f, t in by_name.items()})
    return RecordedInputs(
        bag=bag,
        vehicle=name,
        params=params,
        messages=messages,
        refused=refused,
        live=live,
        steps=steps,
        arrivals_ns=arrivals_ns,
        imu=inputs[0],
        engine_version=described.engine_version,
        retired=described.retired_texts(),
    )


def _step(bag: Bag, topic: str, data: bytes) -> ClockStep:
    """Step of a clock of its recorded bytes."""
    try:
        return clock_step_from_msg(decoded(bag, topic, data, TimeReference))
    except ValueError as error:
        raise BagError(f'{bag.path}: a message on {topic} is damaged: {error}') from error


def never_an_event(receipt: Any) -> bool:  # noqa: ANN401 - a FixReceipt
    """Whether a message was refused for its stamp, before it reached the engine.

    A fix from the future was an event: its receipt names a source.
    """
    return receipt.verdict == Verdict.TOO_LATE or (
        receipt.verdict == Verdict.FROM_FUTURE and not receipt.source
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
    if vehicle is None:
        if not found:
            raise BagError(
                f'{bag.path} tells of no follower_node on /run_info, so its parameters are not '
                'known; record with ./polar record or recorder_node'
            )
        if len(found) > 1:
            raise WrongRequestError(
                f'{bag.path} has {len(found)} followers ({some_of(found)}): '
                'name one with --vehicle'
            )
        vehicle = next(iter(found))
    elif vehicle not in found:
        have = some_of(found) or 'none'
        raise WrongRequestError(f'{bag.path} has no follower {vehicle!r}; it has {have}')
    return vehicle, found[vehicle]


def decoded(bag: Bag, topic: str, data: bytes, msg_type: type[Any]) -> Any:  # noqa: ANN401
    """Message decoded from recorded bytes; BagError if they are none."""
    try:
        return deserialize_message(data, msg_type)
    except (RuntimeError, ValueError, MemoryError) as error:
        raise BagError(f'{bag.path}: a message on {topic} is not a {msg_type.__name__}') from error


def taken_counts(shutdown: Command) -> dict[str, int]:
    """Messages per full topic name that a node had received at its end, from its last command.

    Raises
    ------
    BagError
        When the command has not one count for each topic: its bytes were changed.
    """
    names, counts = list(shutdown.taken_topics), [int(n) for n in shutdown.taken_counts]
    if len(names) != len(counts):
        raise BagError(
            f'the last message on {topics.COMMAND} is damaged: it names {len(names)} topics and '
            f'{len(counts)} counts'
        )
    return dict(zip(names, counts, strict=True))


def _up_to(messages: list[tuple[str, Any]], limits: Mapping[str, int]) -> list[tuple[str, Any]]:
    """Messages that the live node had received at its end, by its own counts."""
    taken: Counter[str] = Counter()
    out = []
    for topic, message in messages:
        taken[topic] += 1
        if taken[topic] <= limits[topic]:
            out.append((topic, message))
    return out


def refusal_key(r: Receipt) -> tuple[str, str, int, int]:
    """Key of a refused message, from its receipt."""
    return (r.topic, r.source, r.sequence, r.receive_ns or r.validity_ns)


def event_key(event: Event) -> tuple[str, str, int, int]:
    """Key of a refused message, from its event."""
    source = event.source if isinstance(event, Fix) else ''
    return (event.topic, source, event.sequence, event.stamp_ns)
