"""Messages of a follower in its bag: topics and times are kept, contents read again when used."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.engine.events import ClockStep
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Taken
from polar_nav_ros.navigation_session import SENSORS
from polar_nav_ros.stamps import stamp_ns_of_cdr, to_ns

_PLACED = np.dtype([('place', 'i8'), ('topic', 'i2'), ('stamp_ns', 'i8'), ('arrival_ns', 'i8')])
Input: TypeAlias = tuple[str, Callable[[], Any]]
"""Topic without the vehicle, and what decodes the message."""
Timed: TypeAlias = tuple[str, int, Callable[[], Any] | None]
"""Topic, stamp [ns], and what decodes a message whose event may have another stamp."""


class Heard(Sequence[tuple[str, Any]]):
    """Inputs of a life, read from the bag whenever they are gone through.

    Parameters
    ----------
    records : Records
    chosen : ndarray of bool
        The inputs that count.
    """

    def __init__(self, records: Records, chosen: NDArray[np.bool_]) -> None:
        self._records = records
        self._inputs = records.read_inputs
        self._chosen = chosen

    def timed(self) -> Iterator[Timed]:
        """Topics and stamps, and what decodes those whose events may have another stamp."""
        own = {topic for topic in SENSORS if topic not in self._records.mapped}
        rows, inputs = self._records.inputs, self._inputs()
        for part in spilled.parts(len(rows)):
            stamps_ns = rows['stamp_ns'][part].tolist()
            for stamp_ns, counts in zip(stamps_ns, self._chosen[part].tolist(), strict=True):
                topic, message = next(inputs)
                if counts:
                    yield topic, stamp_ns, None if topic in own else message

    def __len__(self) -> int:
        return int(np.count_nonzero(self._chosen))

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        for (topic, message), counts in zip(self._inputs(), self._chosen, strict=False):
            if counts:
                yield topic, message()

    @overload
    def __getitem__(self, index: int) -> tuple[str, Any]: ...

    @overload
    def __getitem__(self, index: slice) -> list[tuple[str, Any]]: ...

    def __getitem__(self, index: int | slice) -> tuple[str, Any] | list[tuple[str, Any]]:
        return list(self)[index]


class Live(Mapping[str, list[bytes]]):
    """Messages that a life published by topic, read from the bag when they are first asked for.

    Parameters
    ----------
    outputs : callable
        Returns all compared outputs in the bag, as topics and bytes.
    topics : sequence of str
        The compared topics.
    chosen : ndarray of bool
        Outputs that count.
    """

    def __init__(
        self,
        outputs: Callable[[], Iterator[tuple[str, bytes]]],
        topics: Sequence[str],
        chosen: NDArray[np.bool_],
    ) -> None:
        self._outputs = outputs
        self._topics = topics
        self._chosen = chosen

    @cached_property
    def _found(self) -> dict[str, list[bytes]]:
        found: dict[str, list[bytes]] = {topic: [] for topic in self._topics}
        if self.any:
            for (topic, data), counts in zip(self._outputs(), self._chosen, strict=False):
                if counts:
                    found[topic].append(data)
        return found

    @property
    def any(self) -> bool:
        """Whether there is a message, which needs no reading."""
        return bool(self._chosen.any())

    def __getitem__(self, topic: str) -> list[bytes]:
        return self._found[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)


class Records:
    """Messages of a follower in the order of its bag, each with its place in it.

    Of inputs and outputs, which are many, topics and times are kept; they are read again.

    Parameters
    ----------
    by_name : mapping of str to str
        Topics without the vehicle by their full names.
    compared : iterable of str
        Topics of its outputs.
    inputs, outputs : callable
        As of `Heard` and `Live`.
    """

    def __init__(
        self,
        by_name: Mapping[str, str],
        compared: Iterable[str],
        inputs: Callable[[], Iterator[Input]],
        outputs: Callable[[], Iterator[tuple[str, bytes]]],
    ) -> None:
        self.by_name = by_name
        self.compared = tuple(compared)
        self.read_inputs, self.read_outputs = inputs, outputs
        self.receipts: list[tuple[int, bytes]] = []
        self.steps: list[tuple[int, ClockStep]] = []
        self.ends: list[tuple[int, Mapping[str, int]]] = []
        self.births: list[int] = []
        self.holes: list[int] = []
        self.mapped: set[str] = set()
        self._inputs, self._outputs = spilled.Rows(_PLACED), spilled.Rows(_PLACED)
        self._topics: dict[str, int] = {}
        self._place = 0

    @property
    def inputs(self) -> NDArray[Any]:
        """Places, numbers of topics, stamps and arrivals of the inputs."""
        return self._inputs.array()

    @property
    def outputs(self) -> NDArray[Any]:
        """The same of the outputs."""
        return self._outputs.array()

    def number(self, topic: str) -> int:
        """Number of a topic."""
        return self._topics.setdefault(topic, len(self._topics))

    @property
    def topics(self) -> dict[str, int]:
        """Numbers of all topics so far."""
        return self._topics

    def of(self, start: ClockStep) -> list[int]:
        """Places of the messages on the topic of a start that have its stamp."""
        rows, topic = self.inputs, self.number(start.topic)
        found: list[int] = []
        for part in spilled.parts(len(rows)):
            some = rows[part]
            same = (some['topic'] == topic) & (some['stamp_ns'] == start.own_ns)
            found += some['place'][same].tolist()
        return found

    def input(self, topic: str, stamp_ns: int, arrival_ns: int, *, mapped: bool = False) -> None:
        """Add a message that a node may have taken; of a mapped source, one that it took."""
        if mapped:
            self.mapped.add(topic)
        self._inputs.add((self._next(), self.number(topic), stamp_ns, arrival_ns))

    def output(self, topic: str, data: bytes) -> None:
        """Add a message that it published."""
        place = self._next()
        self._outputs.add((place, self.number(topic), stamp_in(data), 0))
        if topic == topics.RECEIPT:
            self.receipts.append((place, data))

    def step(self, step: ClockStep) -> None:
        """Add a step of a clock, or the start of a topic."""
        self.steps.append((self._next(), step))

    def end(self, taken: Mapping[str, int]) -> None:
        """Add the orderly end of a node, with the messages taken per full topic name."""
        self.ends.append((self._next(), taken))

    def born(self) -> None:
        """Add the description of a node: nothing after it is of the one before.

        A recorder that is started again hears it once more.
        """
        self.births.append(self._next())

    def hole(self) -> None:
        """Add a hole in the recording."""
        self.holes.append(self._next())

    def _next(self) -> int:
        self._place += 1
        return self._place


def stamp_of(message: Any) -> int:  # noqa: ANN401 - of any topic
    """Stamp of an input [ns], of a mapped source that with which it counted."""
    return message.stamp_ns if isinstance(message, Taken) else to_ns(message.header.stamp)


def stamp_in(data: bytes) -> int:
    """Stamp in the bytes of an output [ns]; 0 where they are too few."""
    try:
        return stamp_ns_of_cdr(data)
    except (LookupError, struct.error):
        return 0
