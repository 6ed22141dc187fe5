"""Comparison of a follower's live outputs with a replay of its bag.

Bit for bit where the bag was recorded with the engine that replays it, else by their numbers
(`comparison`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rclpy.serialization import deserialize_message

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError
from polar_nav_msgs.msg import NavState
from polar_nav_ros import topics
from polar_nav_ros.stamps import to_ns

from ..bags.decode import is_installed
from ..bags.errors import BagError
from ..bags.reader import Bag
from .by_message import Progress, ReplayResult, parameters, replay
from .comparison import RUNNING, Comparison, compare, first_imu_ns, first_sample, replayed_as_live
from .difference import Difference, first_difference
from .recorded import RecordedInputs, choose_description, load_inputs


@dataclass(frozen=True)
class VerifyResult:
    """Result of the comparison of a replay with the recorded bytes.

    Attributes
    ----------
    engine_version : int
        Engine that recorded the bag; bits must be the same where it is the engine of the replay.
    equal : bool
        All bytes of all compared topics are the same.
    live_sha256, replay_sha256 : dict
        Per topic, over the bytes in order.
    counts : dict
        Messages per topic: (live, replayed).
    difference : Difference or None
        The first one, where bits must be the same.
    comparison : Comparison or None
        In units of sigma, where another engine recorded the bag.
    retired : list of str
        One sentence for each recorded parameter that was retired since.
    problems : list of str
        What is wrong with the bag itself, then what it lacks of the follower's inputs.
    unheard : list of str
        One sentence for each compared topic whose first messages came before the recorder.
    lives_s : list of (float, float)
        First and last estimate of each process of a follower that was started again, since the
        first one of all [s].
    torn : bool
        Whether the recording has a hole, after which a life cannot be compared.
    """

    vehicle: str
    equal: bool
    live_sha256: dict[str, str]
    replay_sha256: dict[str, str]
    counts: dict[str, tuple[int, int]]
    difference: Difference | None
    problems: list[str] = field(default_factory=list)
    engine_version: int = ENGINE_VERSION
    comparison: Comparison | None = None
    retired: list[str] = field(default_factory=list)
    lives_s: list[tuple[float, float]] = field(default_factory=list)
    torn: bool = False
    unheard: list[str] = field(default_factory=list)

    @property
    def lives_text(self) -> str:
        """Number and times of the lives of a follower; empty for a whole one."""
        if len(self.lives_s) < 2 and not self.torn:
            return ''
        spans = ', '.join(f'{begin:.1f} to {end:.1f} s' for begin, end in self.lives_s)
        number = f'{len(self.lives_s)} lives' if len(self.lives_s) > 1 else '1 life'
        hole = ' (up to the hole in the recording)' if self.torn else ''
        return f'{number}: {spans}{hole}'

    @property
    def ok(self) -> bool:
        """Whether the replay equals the recording, as exactly as its engine version allows."""
        return self.equal if self.comparison is None else self.comparison.ok


def verify(
    source: RecordedInputs | Bag | Path | str,
    *,
    vehicle: str | None = None,
    replayed: ReplayResult | None = None,
    progress: Progress | None = None,
) -> VerifyResult:
    """Bitwise comparison of the live outputs with a replay by the recorded parameters.

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
    difference: Difference | None = None
    comparison: Comparison | None = None
    live, (again, late) = inputs.live, replayed_as_live(inputs, replayed)
    if inputs.engine_version == ENGINE_VERSION:
        difference = _late_start(inputs)
        for topic in live:
            if live[topic] != again[topic]:
                difference = difference or first_difference(topic, live[topic], again[topic])
    else:
        comparison = compare(inputs, replayed)
    return VerifyResult(
        vehicle=inputs.vehicle,
        equal=difference is None and live == again,
        live_sha256={topic: _digest(messages) for topic, messages in live.items()},
        replay_sha256={topic: _digest(messages) for topic, messages in again.items()},
        counts={topic: (len(messages), len(again[topic])) for topic, messages in live.items()},
        difference=difference,
        problems=[
            *inputs.bag.problems,
            *([] if inputs.used is None else inputs.used.lacks),
            *([] if live == again else _never_taken(inputs)),
        ],
        engine_version=inputs.engine_version,
        comparison=comparison,
        retired=list(inputs.retired),
        lives_s=_lives_s(inputs),
        torn=any(life.torn for life in inputs.lives),
        unheard=_unheard(inputs, again, late),
    )


def _unheard(
    inputs: RecordedInputs, again: Mapping[str, list[bytes]], late: Mapping[str, int]
) -> list[str]:
    """One sentence for each compared topic that the recorder found late."""
    return [
        f'{count:,} messages of /{inputs.vehicle}/{topic} are not in the bag: they were published '
        f'before the recorder had found the {what}'
        + ('; the others are equal' if messages == again[topic] else '')
        for topic, messages in inputs.live.items()
        for count, what in (
            (inputs.lives[0].unheard.get(topic, 0), 'topic'),
            (late[topic], 'follower that was started again'),
        )
        if count
    ]


def _never_taken(inputs: RecordedInputs) -> list[str]:
    """One sentence for each topic of which the recorder got messages that the follower did not."""
    return [
        f'{count} of {in_all} messages of /{inputs.vehicle}/{topic} in the bag never reached the '
        'follower (the middleware dropped them); which ones is not recorded, so no replay can '
        'equal it'
        for life in inputs.lives
        for topic, (count, in_all) in life.dropped.items()
    ]


def _lives_s(inputs: RecordedInputs) -> list[tuple[float, float]]:
    """First and last estimate of each life, since the first one of all [s]."""
    spans_ns = [life.span_ns for life in inputs.lives]
    found = [span for span in spans_ns if span is not None]
    return [((a - found[0][0]) * 1e-9, (b - found[0][0]) * 1e-9) for a, b in found]


def load_comparable(bag: Bag, vehicle: str | None = None) -> RecordedInputs:
    """Inputs and outputs of a follower, from a bag whose replay can be compared.

    Raises
    ------
    BagError
        As `load_inputs` and `require_comparable`; and for a bag of another engine with parameters
        that this one refuses.
    ConfigError
        For a bag of this engine with such parameters.
    """
    _require_recorded(bag)
    version = choose_description(bag, vehicle)[1].engine_version
    try:
        inputs = load_inputs(bag, vehicle)
    except ConfigError as error:
        if version == ENGINE_VERSION:
            raise
        raise BagError(
            f'{bag.path}: recorded with engine {version}, not comparable with engine '
            f'{ENGINE_VERSION}: {error}'
        ) from error
    require_comparable(inputs)
    return inputs


def require_comparable(inputs: RecordedInputs) -> None:
    """Raise BagError for a bag without live outputs, or with outputs of other fields.

    Estimates of another engine may have other fields: they are compared by their numbers.

    Raises
    ------
    BagError
        Naming the topic.
    """
    _require_recorded(inputs.bag)
    inputs.bag.require([f'/{inputs.vehicle}/{topics.STATE}'])
    for topic in inputs.live:
        name = f'/{inputs.vehicle}/{topic}'
        if name not in inputs.bag.topics or is_installed(inputs.bag.channel(name)):
            continue
        if topic == topics.STATE and inputs.engine_version != ENGINE_VERSION:
            continue
        raise BagError(
            f'{inputs.bag.path}: not comparable: {name} was recorded by a version whose'
            f' {inputs.bag.channel(name).type} has other fields than the installed one, so its'
            ' bytes cannot be compared; replay and score read it all the same'
        )


def _require_recorded(bag: Bag) -> None:
    """Raise BagError for a bag of `polar inject`: no live node has received its messages."""
    if bag.injected:
        raise BagError(
            f'{bag.path}: an injected bag ({bag.injected}): no live run has received these '
            'messages, so there is nothing to compare; replay and score read it'
        )


def _late_start(inputs: RecordedInputs) -> Difference | None:
    """Difference at the start if the follower ran before the recording began; else None."""
    first_ns = first_imu_ns(inputs)
    states = inputs.live[topics.STATE]
    began_ns = to_ns(deserialize_message(states[0], NavState).header.stamp)
    if began_ns >= first_ns:
        return None
    return Difference(topics.STATE, 0, began_ns, 'start', RUNNING, first_sample(first_ns))


def _digest(messages: Iterable[bytes]) -> str:
    h = hashlib.sha256()
    for data in messages:
        h.update(data)
    return h.hexdigest()
