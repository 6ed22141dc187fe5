"""Sequence of USBL cycles of one array: interrogations of its targets and their readings.

Driven by the stamps of truth messages alone: a cycle is solved as soon as the truth of both ends
has reached the time its reply is back.
"""

from __future__ import annotations

from collections.abc import Iterator

from .poses import NotKept, NotYet, TruthHistory
from .sensors.usbl import Reading, Usbl
from .trajectory import NS


class Interrogator:
    """One array that interrogates its targets in turn.

    Parameters
    ----------
    arrays : mapping of str to Usbl
        The model per target, in the order of interrogation.
    histories : mapping of str to TruthHistory
        Truth of the targets, and under the empty name that of the array's own vehicle.
    period_s, first_s : float
        Between interrogations; of the first one after the start of the mission [s].
    """

    def __init__(
        self,
        arrays: dict[str, Usbl],
        histories: dict[str, TruthHistory],
        period_s: float,
        first_s: float,
    ) -> None:
        self._arrays = arrays
        self._targets = tuple(arrays)
        self._histories = histories
        self._period_ns = round(period_s * NS)
        self._first_ns = round(first_s * NS)
        self._start_ns: int | None = None
        self._sequence = 0
        self._needed_ns = 0
        self.lost = 0

    @property
    def sequence(self) -> int:
        """Number of the next interrogation."""
        return self._sequence

    def begin(self, start_ns: int, now_ns: int) -> None:
        """Set the start of the mission; interrogations before ``now_ns`` are omitted."""
        self._start_ns = start_ns
        late_ns = now_ns - (start_ns + self._first_ns)
        self._sequence = max(0, -(-late_ns // self._period_ns))
        self._needed_ns = self._ping_ns()

    def advance(self) -> Iterator[tuple[str, Reading]]:
        """Readings completed by the truth so far, with their targets."""
        while self._start_ns is not None:
            target = self._targets[self._sequence % len(self._targets)]
            own, other = self._histories[''], self._histories[target]
            if min(own.newest_ns, other.newest_ns) < self._needed_ns:
                return
            usbl = self._arrays[target]
            try:
                cycle = usbl.cycle(self._sequence, self._ping_ns(), own, other)
            except NotYet as early:
                self._needed_ns = early.needed_ns
                return
            except NotKept:
                # The truth of the target began later than the own: omitted, as in begin.
                self._sequence += 1
                self._needed_ns = self._ping_ns()
                continue
            self._sequence += 1
            self._needed_ns = self._ping_ns()
            reading = usbl.read(cycle)
            if reading is None:
                self.lost += 1
            else:
                yield target, reading

    def _ping_ns(self) -> int:
        start_ns = self._start_ns or 0
        return start_ns + self._first_ns + self._sequence * self._period_ns
