"""Compares what a follower published live with a replay of its bag, bit for bit."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from polar_nav_msgs.msg import FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.navigation_session import MODEL_OUTPUTS
from polar_nav_ros.stamps import to_ns

from ..bags.decode import is_installed
from ..bags.errors import BagError
from ..bags.reader import Bag
from .by_message import Progress, ReplayResult, parameters, replay
from .recorded import RecordedInputs, load_inputs

_TYPES: dict[str, type[Any]] = {
    topics.STATE: NavState,
    topics.RECEIPT: FixReceipt,
    **MODEL_OUTPUTS,
}


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


def verify(
    source: RecordedInputs | Bag | Path | str,
    *,
    vehicle: str | None = None,
    replayed: ReplayResult | None = None,
    progress: Progress | None = None,
) -> VerifyResult:
    """Replay a bag with its own parameters and compare bit for bit with the live outputs.

    Parameters
    ----------
    source : RecordedInputs, Bag or path
        Recorded run.
    vehicle : str, optional
        Which follower, when there are several.
    replayed : ReplayResult, optional
        A replay of the same inputs that was made already; used if it had the run's own parameters.

    Raises
    ------
    BagError
        When the bag lacks inputs or the live estimates, or those have other fields than now.
    """
    inputs = source if isinstance(source, RecordedInputs) else load_inputs(source, vehicle)
    require_comparable(inputs)
    if replayed is None or replayed.params != parameters(inputs.params, None, {}):
        replayed = replay(inputs, progress=progress)
    difference = _late_start(inputs)
    for topic in inputs.live:
        if inputs.live[topic] != replayed.of(topic):
            found = _first_difference(topic, inputs.live[topic], replayed.of(topic))
            difference = difference or found
    return VerifyResult(
        vehicle=inputs.vehicle,
        equal=difference is None,
        live_sha256={topic: _digest(messages) for topic, messages in inputs.live.items()},
        replay_sha256=replayed.sha256,
        counts={t: (len(m), len(replayed.of(t))) for t, m in inputs.live.items()},
        difference=difference,
        problems=list(inputs.bag.problems),
    )


def require_comparable(inputs: RecordedInputs) -> None:
    """Refuse a bag without live outputs, or with those of a version with other fields.

    Raises
    ------
    BagError
        Naming the topic.
    """
    inputs.bag.require([f'/{inputs.vehicle}/{topics.STATE}'])
    for topic in inputs.live:
        name = f'/{inputs.vehicle}/{topic}'
        if name not in inputs.bag.topics or is_installed(inputs.bag.channel(name)):
            continue
        raise BagError(
            f'{inputs.bag.path}: {name} was recorded by a version whose'
            f' {inputs.bag.channel(name).type} has other fields than the installed one, so its'
            ' bytes cannot be compared; replay and score read it all the same'
        )


def _late_start(inputs: RecordedInputs) -> Difference | None:
    """What cannot be compared: a recording that began when the follower was already running."""
    first = next(to_ns(m.header.stamp) for topic, m in inputs.messages if topic == inputs.imu)
    states = inputs.live[topics.STATE]
    began = to_ns(deserialize_message(states[0], NavState).header.stamp)
    if began >= first:
        return None
    live, bag = (
        'was already navigating',
        f'the first IMU sample in the bag is of {first * 1e-9:.3f} s',
    )
    return Difference(topics.STATE, 0, began, 'start', live, bag)


def _digest(messages: Iterable[bytes]) -> str:
    h = hashlib.sha256()
    for data in messages:
        h.update(data)
    return h.hexdigest()


def _first_difference(topic: str, live: list[bytes], replayed: list[bytes]) -> Difference:
    msg_type = _TYPES[topic]
    for i, (a, b) in enumerate(zip(live, replayed, strict=False)):
        if a != b:
            left, right = deserialize_message(a, msg_type), deserialize_message(b, msg_type)
            stamp_ns = to_ns(left.header.stamp)
            found = _first_field(left, right, '')
            if found is not None:
                return Difference(topic, i, stamp_ns, *found)
            at = next(k for k, (x, y) in enumerate(zip_longest(a, b)) if x != y)
            return Difference(
                topic, i, stamp_ns, f'byte {at}', a[at:].hex()[:16], b[at:].hex()[:16]
            )
    longer = live if len(live) > len(replayed) else replayed
    i = min(len(live), len(replayed))
    stamp_ns = to_ns(deserialize_message(longer[i], msg_type).header.stamp)
    present, absent = 'a message', 'none'
    values = (present, absent) if longer is live else (absent, present)
    return Difference(topic, i, stamp_ns, 'count', *values)


def _first_field(left: Any, right: Any, name: str) -> tuple[str, str, str] | None:  # noqa: ANN401
    """Name and both values, with all digits, of the first number or text that differs."""
    if hasattr(left, 'get_fields_and_field_types'):
        for part in left.get_fields_and_field_types():
            inner = f'{name}.{part}' if name else part
            found = _first_field(getattr(left, part), getattr(right, part), inner)
            if found is not None:
                return found
        return None
    if not isinstance(left, str) and hasattr(left, '__len__'):
        if len(left) != len(right):
            return f'{name}, length', str(len(left)), str(len(right))
        for i, (x, y) in enumerate(zip(left, right, strict=True)):
            found = _first_field(x, y, f'{name}[{i}]')
            if found is not None:
                return found
        return None
    x, y = (repr(v.item() if hasattr(v, 'item') else v) for v in (left, right))
    return (name, x, y) if x != y else None
