"""Replays a bag through the follower's engine, and compares the result with the live recording.

Comes in: a bag with the follower's inputs and its parameters (`/run_info`). Goes out: the messages
that the live node would have published, as bytes. Live and replay drive the same
`polar_nav_follower.session.Session`, so the bytes are the same when nothing is wrong; `verify`
says so or names the first difference.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping, to_mapping
from polar_nav_follower import convert, session
from polar_nav_follower.events import CommandKind, Event, Fix, Receipt, Verdict
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Command, Depth, Dvl, FixReceipt, NavState
from polar_nav_ros.stamps import to_ns

from .bags.errors import BagError
from .bags.reader import Bag, open_bag

FOLLOWER_PACKAGE = 'polar_nav_follower'
COMPARED = (session.STATE, session.RECEIPT)
"""Topics that a replay reproduces bit for bit."""

_TYPES: dict[str, type[Any]] = {
    session.IMU: Imu,
    session.DVL: Dvl,
    session.DEPTH: Depth,
    session.PACKET: AcousticPacket,
    session.COMMAND: Command,
}

_NO_LIMIT = 1 << 62

Progress = Callable[[float], None]
"""Called with the share of the work that is done."""


@dataclass(frozen=True)
class Output:
    """One message of a replay."""

    topic: str
    stamp_ns: int
    data: bytes


@dataclass(frozen=True)
class ReplayResult:
    """What the engine made of a bag.

    Attributes
    ----------
    vehicle : str
        The follower.
    params : FollowerParams
        Parameters used.
    outputs : list of Output
        Messages on full topic names, in order of publication.
    sha256 : dict of str to str
        Hash over the bytes of each compared topic, in order.
    taken : dict of str to int
        Messages taken per full topic name.
    verdicts : dict of str to int
        Verdict counts of everything that got a receipt.
    """

    vehicle: str
    params: FollowerParams
    outputs: list[Output]
    sha256: dict[str, str]
    taken: dict[str, int]
    verdicts: dict[str, int]
    divergence: str = ''

    def of(self, topic: str) -> list[bytes]:
        """Bytes published on a topic, given without the vehicle."""
        name = f'/{self.vehicle}/{topic}'
        return [o.data for o in self.outputs if o.topic == name]


@dataclass(frozen=True)
class Difference:
    """First place where live and replay differ."""

    topic: str
    index: int
    stamp_ns: int
    field: str
    live: str
    replayed: str

    def __str__(self) -> str:
        at = f'{self.topic}, message {self.index}, stamp {self.stamp_ns * 1e-9:.6f} s'
        return f'{at}, {self.field}: live {self.live}, replayed {self.replayed}'


@dataclass(frozen=True)
class VerifyResult:
    """Whether a replay gives the bytes that were recorded.

    Attributes
    ----------
    equal : bool
        All bytes of all compared topics are the same.
    live_sha256, replay_sha256 : dict
        Per topic, over the bytes in order.
    counts : dict
        Messages per topic: (live, replayed).
    difference : Difference or None
        The first one.
    problems : list of str
        What is wrong with the bag itself.
    """

    vehicle: str
    equal: bool
    live_sha256: dict[str, str]
    replay_sha256: dict[str, str]
    counts: dict[str, tuple[int, int]]
    difference: Difference | None
    problems: list[str] = field(default_factory=list)


def followers_of(bag: Bag) -> dict[str, dict[str, Any]]:
    """Parameters of every follower whose node described itself in the bag, by vehicle."""
    out: dict[str, dict[str, Any]] = {}
    for name, info in bag.node_infos.items():
        if info.get('package') == FOLLOWER_PACKAGE:
            out[name.strip('/').split('/')[0]] = dict(info.get('params', {}))
    return out


def choose_follower(bag: Bag, vehicle: str | None) -> tuple[str, dict[str, Any]]:
    """Vehicle and recorded parameters of the follower to replay.

    Raises
    ------
    BagError
        When there is none, or several and none was named.
    """
    found = followers_of(bag)
    if vehicle is None:
        if len(found) == 1:
            return next(iter(found.items()))
        if not found:
            raise BagError(
                f'{bag.path} tells of no follower_node on /run_info, so its parameters are not '
                'known; record with ./polar record or recorder_node'
            )
        raise BagError(
            f'{bag.path} has {len(found)} followers ({", ".join(sorted(found))}): '
            'name one with --vehicle'
        )
    if vehicle not in found:
        raise BagError(
            f'{bag.path} has no follower {vehicle!r}; it has {", ".join(sorted(found)) or "none"}'
        )
    return vehicle, found[vehicle]


def parameters(
    recorded: Mapping[str, Any], configuration: str | None, changes: Mapping[str, Any]
) -> FollowerParams:
    """Recorded parameters with the user's changes; replays need no lockstep, no reorder window."""
    values = dict(recorded)
    if configuration is not None:
        values['configuration'] = configuration
    values.update(changes)
    return from_mapping(FollowerParams, values)


def replay(
    bag: Bag | Path | str,
    *,
    configuration: str | None = None,
    vehicle: str | None = None,
    changes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Run a bag's messages through the engine.

    Parameters
    ----------
    bag : Bag or path
        Recorded run.
    configuration : str, optional
        Named configuration instead of the recorded one.
    vehicle : str, optional
        Which follower, when there are several.
    changes : mapping, optional
        Other parameters to change, by name.

    Raises
    ------
    BagError
        When the bag lacks what the engine needs.
    ConfigError
        For an unknown parameter or a value out of range.
    """
    bag = bag if isinstance(bag, Bag) else open_bag(bag)
    name, recorded = choose_follower(bag, vehicle)
    params = parameters(recorded, configuration, changes or {})
    run = session.Session(params, name)
    bag.require([f'/{name}/{session.IMU}'])
    events, refused = _collect(bag, name, run)
    collector = _Collector(name)
    _drive(run, events, refused, collector, progress)
    return ReplayResult(
        vehicle=name,
        params=params,
        outputs=collector.outputs,
        sha256=collector.digests(),
        taken={f'/{name}/{topic}': count for topic, count in run.taken.items()},
        verdicts={v.name: n for v, n in sorted(run.follower.verdicts.items())},
        divergence=run.follower.divergence,
    )


def verify(
    bag: Bag | Path | str, *, vehicle: str | None = None, progress: Progress | None = None
) -> VerifyResult:
    """Replay a bag with its own parameters and compare bit for bit with the live outputs."""
    bag = bag if isinstance(bag, Bag) else open_bag(bag)
    result = replay(bag, vehicle=vehicle, progress=progress)
    live: dict[str, list[bytes]] = {topic: [] for topic in COMPARED}
    names = {f'/{result.vehicle}/{topic}': topic for topic in COMPARED}
    bag.require([f'/{result.vehicle}/{session.STATE}'])
    for full_name, _, data in bag.messages(names):
        live[names[full_name]].append(data)
    difference = None
    for topic in COMPARED:
        replayed = result.of(topic)
        if live[topic] != replayed:
            difference = difference or _first_difference(topic, live[topic], replayed)
    return VerifyResult(
        vehicle=result.vehicle,
        equal=difference is None,
        live_sha256={topic: _digest(live[topic]) for topic in COMPARED},
        replay_sha256=result.sha256,
        counts={topic: (len(live[topic]), len(result.of(topic))) for topic in COMPARED},
        difference=difference,
        problems=list(bag.problems),
    )


def merged_parameters(result: ReplayResult) -> dict[str, Any]:
    """Parameters of a replay as plain values, for the metadata of its bag."""
    return to_mapping(result.params)


def _collect(bag: Bag, vehicle: str, run: session.Session) -> tuple[list[Event], list[Receipt]]:
    """Events in their total order, and receipts of what the live node refused as too late."""
    limits = _taken_at_shutdown(bag, vehicle)
    refused = _refused_live(bag, vehicle)
    refused_keys = Counter(_refusal_key(r) for r in refused)
    topics = {f'/{vehicle}/{topic}': topic for topic in session.INPUTS}
    events: list[Event] = []
    for full_name, _, data in bag.messages(topics):
        topic = topics[full_name]
        if limits is not None and run.taken[topic] >= limits.get(full_name, _NO_LIMIT):
            continue
        message = _decoded(bag, full_name, data, _TYPES[topic])
        if topic == session.COMMAND and message.kind == CommandKind.SHUTDOWN:
            continue
        try:
            event = run.event_of(topic, message)
        except ValueError as error:
            raise BagError(
                f'{bag.path}: a message on {full_name} makes no sense: {error}'
            ) from error
        key = _event_refusal_key(event)
        if refused_keys[key]:
            refused_keys[key] -= 1
            continue
        events.append(event)
    # Contents of packets, for people: the live run published them, a replay does not repeat them.
    for _ in run.decoded():
        pass
    events.sort(key=lambda e: e.key)
    return events, refused


def _drive(
    run: session.Session,
    events: list[Event],
    refused: list[Receipt],
    collector: _Collector,
    progress: Progress | None,
) -> None:
    waiting = list(reversed(refused))
    every = max(1, len(events) // 100)
    for i, event in enumerate(events):
        while waiting and waiting[-1].stamp_ns < event.stamp_ns:
            receipt = waiting.pop()
            collector.take(run.advance(receipt.stamp_ns + 1))
            collector.take([run.refuse(receipt)])
        collector.take(run.process(event))
        if progress is not None and i % every == 0:
            progress(i / len(events))
    while waiting:
        collector.take([run.refuse(waiting.pop())])
    collector.take(run.flush())
    if progress is not None:
        progress(1.0)


class _Collector:
    """Serializes what the session publishes, and hashes it per topic."""

    def __init__(self, vehicle: str) -> None:
        self._prefix = f'/{vehicle}/'
        self._hashes = {topic: hashlib.sha256() for topic in COMPARED}
        self.outputs: list[Output] = []

    def take(self, published: Iterable[session.Published]) -> None:
        for topic, message, data in published:
            stamp_ns = to_ns(message.header.stamp)
            self.outputs.append(Output(self._prefix + topic, stamp_ns, data))
            if topic in self._hashes:
                self._hashes[topic].update(data)

    def digests(self) -> dict[str, str]:
        return {topic: h.hexdigest() for topic, h in self._hashes.items()}


def _decoded(bag: Bag, topic: str, data: bytes, msg_type: type[Any]) -> Any:  # noqa: ANN401
    """Message of recorded bytes; BagError when they are none."""
    try:
        return deserialize_message(data, msg_type)
    except (RuntimeError, ValueError, MemoryError) as error:
        raise BagError(f'{bag.path}: a message on {topic} is not a {msg_type.__name__}') from error


def _digest(messages: Iterable[bytes]) -> str:
    h = hashlib.sha256()
    for data in messages:
        h.update(data)
    return h.hexdigest()


def _taken_at_shutdown(bag: Bag, vehicle: str) -> dict[str, int] | None:
    """Messages of each topic that the live node took until it ended; None if it did not say."""
    for _, _, data in bag.messages([f'/{vehicle}/{session.COMMAND}']):
        message = _decoded(bag, f'/{vehicle}/{session.COMMAND}', data, Command)
        if message.kind == CommandKind.SHUTDOWN:
            return dict(zip(message.taken_topics, map(int, message.taken_counts), strict=True))
    return None


def _refused_live(bag: Bag, vehicle: str) -> list[Receipt]:
    out = []
    for _, _, data in bag.messages([f'/{vehicle}/{session.RECEIPT}']):
        message = _decoded(bag, f'/{vehicle}/{session.RECEIPT}', data, FixReceipt)
        if message.verdict == Verdict.TOO_LATE:
            out.append(convert.receipt_from_msg(message))
    return out


def _refusal_key(r: Receipt) -> tuple[str, str, int, int]:
    return (r.topic, r.source, r.sequence, r.receive_ns or r.validity_ns)


def _event_refusal_key(event: Event) -> tuple[str, str, int, int]:
    source = event.source if isinstance(event, Fix) else ''
    return (event.topic, source, event.sequence, event.stamp_ns)


def _first_difference(topic: str, live: list[bytes], replayed: list[bytes]) -> Difference:
    msg_type = NavState if topic == session.STATE else FixReceipt
    for i, (a, b) in enumerate(zip(live, replayed, strict=False)):
        if a != b:
            left, right = deserialize_message(a, msg_type), deserialize_message(b, msg_type)
            stamp_ns = to_ns(left.header.stamp)
            for name in left.get_fields_and_field_types():
                x, y = getattr(left, name), getattr(right, name)
                if repr(x) != repr(y):
                    return Difference(topic, i, stamp_ns, name, repr(x), repr(y))
            return Difference(topic, i, stamp_ns, 'bytes', a.hex()[:40], b.hex()[:40])
    longer = live if len(live) > len(replayed) else replayed
    i = min(len(live), len(replayed))
    stamp_ns = to_ns(deserialize_message(longer[i], msg_type).header.stamp)
    present, absent = 'a message', 'none'
    values = (present, absent) if longer is live else (absent, present)
    return Difference(topic, i, stamp_ns, 'count', *values)


__all__ = [
    'BagError',
    'ConfigError',
    'Difference',
    'Output',
    'ReplayResult',
    'VerifyResult',
    'choose_follower',
    'followers_of',
    'replay',
    'verify',
]
