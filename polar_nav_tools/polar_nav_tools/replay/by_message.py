"""Replay of a recorded bag through the follower's engine, message by message.

Comes in: a bag with the follower's inputs and its parameters (`/run_info`). Goes out: the messages
that the live node would have published, as bytes. Live and replay drive the same
`polar_nav_follower.session.Session`, so the bytes are the same when nothing is wrong;
`verification` says so or names the first difference.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from polar_nav_core.engine.configurations import parameters_of
from polar_nav_core.engine.events import Event
from polar_nav_core.engine.health.conditions import Health
from polar_nav_core.engine.health.runaway import divergence_of
from polar_nav_core.params import from_mapping
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.navigation_session import Published
from polar_nav_ros.stamps import to_ns
from polar_nav_ros.topics import (
    CLOCK_STEP,
    DECODED,
    IDENTIFICATION,
    MODEL,
    RECEIPT,
    STATE,
    STATION_DECODED,
)

from ..bags.arrays import estimates_from_cdr, receipts_from_cdr
from ..bags.model import model_run_from_cdr
from ..bags.reader import Bag
from .life import Life
from .outputs import Output, Outputs
from .recorded import RecordedInputs, load_inputs
from .result import ReplayedRun

_LIVE_ONLY = (DECODED, STATION_DECODED, CLOCK_STEP)
"""Contents of packets, steps of clocks: a live run publishes them, a replay does not."""
Progress = Callable[[float], None]
"""Called with the share of the work that is done."""


@dataclass(frozen=True)
class ReplayResult:
    """Result of a replay by message: published messages, counts and hashes.

    Attributes
    ----------
    vehicle : str
        The follower.
    params : FollowerParams
        Parameters used.
    outputs : sequence of Output
        Messages on full topic names, in order of publication.
    sha256 : dict of str to str
        Hash over the bytes of each compared topic, in order.
    taken : dict of str to int
        Messages taken per full topic name.
    verdicts : dict of str to int
        Verdict counts of everything that got a receipt.
    divergence : str
        Why the filter stopped; empty when it did not.
    health : tuple of Health
        Judgements of the watchdog, one each second.
    """

    vehicle: str
    params: FollowerParams
    outputs: Sequence[Output]
    sha256: dict[str, str]
    taken: dict[str, int]
    verdicts: dict[str, int]
    divergence: str = ''
    health: tuple[Health, ...] = ()

    def of(self, topic: str, life: int | None = None) -> list[bytes]:
        """Messages published on a topic (its name without the vehicle), as bytes.

        ``life`` is the number of one process of a follower that was started again.
        """
        name = f'/{self.vehicle}/{topic}'
        return [o.data for o in self.outputs if o.topic == name and life in (None, o.life)]

    @cached_property
    def published(self) -> Counter[str]:
        """Number of messages by topic (its name without the vehicle)."""
        return Counter(o.topic.removeprefix(f'/{self.vehicle}/') for o in self.outputs)

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of estimates and of receipts."""
        return self.published[STATE], self.published[RECEIPT]

    def as_run(self) -> ReplayedRun:
        """Decode the published messages to series."""
        return ReplayedRun(
            vehicle=self.vehicle,
            params=self.params,
            taken=self.taken,
            verdicts=self.verdicts,
            estimates=estimates_from_cdr(self.of(STATE), self.vehicle),
            receipts=receipts_from_cdr(self.of(RECEIPT)),
            model=model_run_from_cdr(self.of(MODEL), self.of(IDENTIFICATION), None),
            divergence=self.divergence,
            health=self.health,
        )


def parameters(
    recorded: Mapping[str, Any], configuration: str | None, changes: Mapping[str, Any]
) -> FollowerParams:
    """Recorded parameters with a named configuration and the user's changes."""
    values = dict(recorded)
    if configuration is not None:
        values |= parameters_of(configuration, recorded)
    values.update(changes)
    return from_mapping(FollowerParams, values)


def replay(
    source: RecordedInputs | Bag | Path | str,
    *,
    configuration: str | None = None,
    vehicle: str | None = None,
    changes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Result of a follower's recorded inputs, run through the engine again.

    Parameters
    ----------
    source : RecordedInputs, Bag or path
        Recorded run; inputs that were loaded before serve several replays.
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
    inputs = (
        source if isinstance(source, RecordedInputs) else load_inputs(source, vehicle, changes)
    )
    params = parameters(inputs.params, configuration, changes or {})
    collector = _Collector(inputs.vehicle, inputs.live)
    taken: Counter[str] = Counter()
    verdicts: Counter[str] = Counter()
    health: list[Health] = []
    divergence = ''
    for number, life in enumerate(inputs.lives):
        collector.life = number
        run = inputs.new_session(params)
        share = _share(progress, number, len(inputs.lives))
        if inputs.bag.injected:
            health += _drive_live(run, life, collector, share)
        else:
            decided = Counter(receipt.topic for receipt in life.refused)
            health += _drive(run, inputs.events(run, life), life, collector, decided, share)
        # What waited in a node that was killed, it took for nothing.
        taken.update(run.taken if life.until_ns is None else decided)
        verdicts.update({verdict.name: n for verdict, n in sorted(run.engine.verdicts.items())})
        divergence = divergence or run.engine.divergence
    if progress is not None:
        progress(1.0)
    return ReplayResult(
        vehicle=inputs.vehicle,
        params=params,
        outputs=collector.outputs,
        sha256=collector.digests(),
        taken={f'/{inputs.vehicle}/{topic}': count for topic, count in taken.items()},
        verdicts=dict(verdicts),
        divergence=divergence or divergence_of(tuple(health)),
        health=tuple(health),
    )


def _share(progress: Progress | None, number: int, count: int) -> Progress:
    """Progress of one life as that of all."""
    return lambda share: None if progress is None else progress((number + share) / count)


def _drive(
    run: session.Session,
    events: Iterable[Event],
    life: Life,
    collector: _Collector,
    decided: Counter[str],
    progress: Progress,
) -> list[Health]:
    """Process all events and count them by topic; returns the watchdog's judgements on the way."""
    health: list[Health] = []
    waiting = list(reversed(life.refused))
    every = max(1, len(life.messages) // 100)
    for i, event in enumerate(events):
        while waiting and waiting[-1].stamp_ns < event.stamp_ns:
            receipt = waiting.pop()
            collector.collect(run.advance(receipt.stamp_ns + 1))
            collector.collect([run.refuse(receipt)])
        collector.collect(run.process(event))
        decided[event.topic] += 1
        if run.engine.health is not None and (not health or run.engine.health is not health[-1]):
            health.append(run.engine.health)
        if i % every == 0:
            progress(i / len(life.messages))
    while waiting:
        collector.collect([run.refuse(waiting.pop())])
    # A node that was killed has not processed what waited in it.
    until_ns = life.until_ns
    collector.collect(run.flush() if until_ns is None else run.advance(until_ns + 1))
    return health


def _drive_live(
    run: session.Session, life: Life, collector: _Collector, progress: Progress
) -> list[Health]:
    """Process messages as they arrived, as a node does: no node has refused late ones before."""
    health: list[Health] = []
    every = max(1, len(life.messages) // 100)
    for i, (topic, message) in enumerate(life.messages):
        published = run.take(topic, message, int(life.arrivals_ns[i]))
        collector.collect(p for p in published if p.topic not in _LIVE_ONLY)
        if run.engine.health is not None and (not health or run.engine.health is not health[-1]):
            health.append(run.engine.health)
        if i % every == 0:
            progress(i / len(life.messages))
    collector.collect(run.flush())
    return health


class _Collector:
    """Collects the messages that the session publishes, and hashes them per topic."""

    def __init__(self, vehicle: str, compared: Iterable[str]) -> None:
        self._prefix = f'/{vehicle}/'
        self._hashes = {topic: hashlib.sha256() for topic in compared}
        self.outputs = Outputs()
        self.life = 0

    def collect(self, published: Iterable[Published]) -> None:
        for topic, message, data in published:
            stamp_ns = to_ns(message.header.stamp)
            self.outputs.add(Output(self._prefix + topic, stamp_ns, data, self.life))
            if topic in self._hashes:
                self._hashes[topic].update(data)

    def digests(self) -> dict[str, str]:
        return {topic: h.hexdigest() for topic, h in self._hashes.items()}
