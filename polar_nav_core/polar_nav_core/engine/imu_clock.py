"""The IMU's clock: which stamps to believe, and where its time goes on when it steps.

A sample ahead of the others waits for the next one. If that goes on from it, this is a gap, unless
the samples came too soon for one: then, and when stamps leap back, the clock has stepped. A step
needs five samples in a row, which go on from one another as samples do; of one back by a few
intervals, some of them are ahead of the newest again. The engine's time goes on by one interval
over it; a clock that returns gets its old offset again.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, TypeAlias

from .arrivals import Arrivals
from .events import ClockStep, Event, ImuSample, shifted

LEAST_STEP_NS = 500_000_000
"""A clock that steps by less is not followed: that much, messages can be late. The IMU's is, where
its samples came in order and arrival shows that they go on."""
_SHORT_NS = 200_000_000
"""Such a step ahead: samples that came so much too soon, or by half of the leap."""
STEP_SAMPLES = 5
"""Samples in a row that show a step."""
_IN_ORDER = 50
"""Samples in order before a shorter step: where they are jumbled, some are late."""
_MOST_HELD = 256
"""Samples that wait: a stamp that never changes lets no other one decide."""
_FIRST_NS = 10_000_000_000
"""Between the first two messages of a run."""
_UNSEEN_GAP_NS = 60_000_000_000
"""Where arrival tells nothing, a longer leap is a step, and a shorter one a gap."""
_ARRIVAL_NS = 250_000_000
"""Arrival is known no better."""
_LONGEST = 3
"""Intervals between two samples that go on from one another after a step."""
_BACK, _AHEAD = 1.5, 2.5
"""Intervals that a sample is behind the newest one, or ahead of it, at least, of a clock that has
stepped back or ahead."""


class Refused(NamedTuple):
    """A message stamped ahead that is not believed, with that stamp in the engine's time."""

    event: Event


Action: TypeAlias = Event | Refused | ClockStep
"""Message to use, with a stamp of the engine's time; message to refuse; step of a clock."""


class ImuClock:
    """Judge of the stamps of one vehicle's IMU.

    Parameters
    ----------
    leap_s : float
        Stamp time that a sample may be ahead of the one before.
    window_s : float
        Stamp time that it may be behind the newest one.

    Attributes
    ----------
    newest_ns : int or None
        Engine time of the newest sample.
    offsets_ns : list of int
        Engine time less stamp, one for each step so far; the last one holds.
    arrivals : Arrivals
    """

    def __init__(self, leap_s: float, window_s: float = math.inf) -> None:
        self._leap_ns = round(leap_s * 1e9)
        self._window_ns = window_s * 1e9
        self.newest_ns: int | None = None
        self.offsets_ns = [0]
        self.arrivals = Arrivals()
        self._interval_ns = 0
        self._held: list[tuple[ImuSample, int | None]] = []
        self._behind = False
        self._in_order = 0
        self._ways: deque[int] = deque(maxlen=_IN_ORDER)
        self._gaps: deque[tuple[int, int]] = deque(maxlen=64)

    @property
    def undecided(self) -> bool:
        """Whether samples wait for others to decide on a leap."""
        return bool(self._held)

    def take(self, sample: ImuSample, arrival_ns: int | None) -> list[Action]:
        """Samples to use and to refuse, and steps of the clock, after another sample came."""
        stamp_ns = sample.stamp_ns + self.offsets_ns[-1]
        if self.newest_ns is None:
            return self._first(sample, arrival_ns)
        ahead = self._may_be_ahead(stamp_ns, arrival_ns)
        behind = self._may_be_back(stamp_ns, arrival_ns)
        if self._held and self._is_step and self._goes_on(sample.stamp_ns):
            ahead, behind = not self._behind, self._behind
        if not (ahead or behind):
            return [*self._let_go(), *self._use([(sample, arrival_ns)])]
        if self._held and behind == self._behind:
            if sample.stamp_ns in (self._held[0][0].stamp_ns, self._held[-1][0].stamp_ns):
                self._held.append((sample, arrival_ns))  # the same again agrees with nothing
                return self._let_go() if len(self._held) >= _MOST_HELD else []
            if self._goes_on(sample.stamp_ns):
                self._held.append((sample, arrival_ns))
                return self._decide()
        out = self._let_go()
        self._held, self._behind = [(sample, arrival_ns)], behind
        return out

    def flush(self) -> list[Action]:
        """Samples to use and to refuse at the end of a run."""
        if self.newest_ns is None:  # the only ones are no worse than any
            held, self._held = self._held, []
            return [sample for sample, _ in held]
        return self._let_go()

    def _first(self, sample: ImuSample, arrival_ns: int | None) -> list[Action]:
        """The first of a run waits for a second one that agrees: it sets the time."""
        if self._held:
            way_ns = sample.stamp_ns - self._held[0][0].stamp_ns
            agrees = -self._leap_ns <= way_ns <= max(_FIRST_NS, self._leap_ns)
            if way_ns == 0 or agrees:
                self._held.append((sample, arrival_ns))
                if way_ns:
                    return self._use(self._let_all())
                return self._let_go() if len(self._held) >= _MOST_HELD else []
        out = self._let_go()
        self._held, self._behind = [(sample, arrival_ns)], False
        return out

    def _may_be_ahead(self, stamp_ns: int, arrival_ns: int | None) -> bool:
        """Whether a sample may be of a clock that stepped ahead, or behind a gap."""
        way_ns = stamp_ns - (self.newest_ns or 0)
        if way_ns > self._leap_ns:
            return True
        if way_ns <= _AHEAD * self._interval_ns or self._in_order < _IN_ORDER:
            return False
        possible_ns = self.arrivals.newest_possible_ns(arrival_ns)
        return possible_ns is not None and stamp_ns - possible_ns > self._too_soon_ns(stamp_ns)

    def _too_soon_ns(self, stamp_ns: int) -> int:
        """How much too soon the first sample behind a leap came, if its clock has stepped.

        Half of the leap tells it from a gap, of which nothing comes too soon.
        """
        if self._in_order < _IN_ORDER:
            return LEAST_STEP_NS
        return min(_SHORT_NS, (stamp_ns - (self.newest_ns or 0) - self._interval_ns) // 2)

    def _may_be_back(self, stamp_ns: int, arrival_ns: int | None) -> bool:
        """Whether a sample may be of a clock that stepped back, and is not only late."""
        back_ns = (self.newest_ns or 0) - stamp_ns
        if back_ns < min(self._window_ns, _BACK * self._interval_ns):
            return False
        if back_ns < LEAST_STEP_NS:
            seen = self.arrivals.newest_possible_ns(arrival_ns) is not None
            if not seen or self._in_order < _IN_ORDER:
                return False
            # Stamps that are back from a leap ahead have not stepped.
            if 2 * (max(self._ways) - self._interval_ns) >= back_ns:
                return False
        return not any(a < stamp_ns < b for a, b in self._gaps)

    def _goes_on(self, own_ns: int) -> bool:
        """Whether a sample goes on from those that wait."""
        way_ns = own_ns - self._held[-1][0].stamp_ns
        if self._is_step:
            return 0 < way_ns <= _LONGEST * max(self._interval_ns, 1)
        longest_ns = self._held[0][0].stamp_ns + self.offsets_ns[-1] - (self.newest_ns or 0)
        return -self._leap_ns <= way_ns <= max(longest_ns, self._leap_ns)

    @property
    def _is_step(self) -> bool:
        """Whether the first sample that waits is of a clock that stepped, if others agree."""
        sample, arrival_ns = self._held[0]
        if self._behind:
            return True
        stamp_ns = sample.stamp_ns + self.offsets_ns[-1]
        possible_ns = self.arrivals.newest_possible_ns(arrival_ns)
        if possible_ns is None:
            return stamp_ns - (self.newest_ns or 0) > _UNSEEN_GAP_NS
        return stamp_ns - possible_ns > self._too_soon_ns(stamp_ns)

    def _decide(self) -> list[Action]:
        """What becomes of samples that wait and agree."""
        if not self._is_step:
            if self.newest_ns is not None:
                self._gaps.append(
                    (self.newest_ns, self._held[0][0].stamp_ns + self.offsets_ns[-1])
                )
            return self._use(self._let_all())
        stamps_ns = {sample.stamp_ns for sample, _ in self._held}
        if len(stamps_ns) < STEP_SAMPLES:
            return []
        span_ns = (max(stamps_ns) - min(stamps_ns)) / (len(stamps_ns) - 1)
        if not 0.5 * self._interval_ns <= span_ns <= 1.5 * self._interval_ns:
            return self._let_go()
        if self._behind and self._is_burst(max(stamps_ns) - min(stamps_ns)):
            return self._let_go()
        return [self._step(), *self._use(self._let_all())]

    def _is_burst(self, span_ns: int) -> bool:
        """Whether samples that wait came faster than they were taken: late, and no step."""
        first, last = self._held[0], self._held[-1]
        back_ns = (self.newest_ns or 0) - first[0].stamp_ns - self.offsets_ns[-1]
        if back_ns >= LEAST_STEP_NS or first[1] is None or last[1] is None:
            return False
        return last[1] - first[1] < span_ns // 2

    def _step(self) -> ClockStep:
        """Step of the clock at the first sample that waits."""
        first, arrival_ns = self._held[0]
        newest_ns = self.newest_ns or 0
        stamp_ns = newest_ns + self._interval_ns
        possible_ns = self.arrivals.newest_possible_ns(arrival_ns)
        near_ns = _ARRIVAL_NS
        if possible_ns is not None and possible_ns - stamp_ns > _ARRIVAL_NS:
            stamp_ns = possible_ns  # it stepped in a gap
            self._gaps.append((newest_ns, stamp_ns))
        elif possible_ns is not None and self._in_order >= _IN_ORDER:
            near_ns = _LONGEST * self._interval_ns
        *offsets_ns, was_ns = self.offsets_ns
        for offset_ns in reversed(offsets_ns):
            before_ns = first.stamp_ns + offset_ns
            if before_ns > newest_ns and abs(before_ns - stamp_ns) <= near_ns:
                stamp_ns = before_ns  # it is back
                break
        self.offsets_ns.append(stamp_ns - first.stamp_ns)
        return ClockStep(first.topic, first.sequence, stamp_ns, first.stamp_ns, was_ns)

    def _use(self, samples: list[tuple[ImuSample, int | None]]) -> list[Action]:
        out: list[Action] = []
        for sample, arrival_ns in samples:
            one = shifted(sample, self.offsets_ns[-1])
            out.append(one)
            if self.newest_ns is not None:
                way_ns = one.stamp_ns - self.newest_ns
                self._in_order = self._in_order + 1 if way_ns > 0 else 0
                self._ways.append(way_ns)
                if 0 < way_ns <= self._leap_ns:
                    self._interval_ns += (way_ns - self._interval_ns) // (
                        16 if self._interval_ns else 1
                    )
            self.newest_ns = max(one.stamp_ns, self.newest_ns or one.stamp_ns)
            self.arrivals.note(arrival_ns, one.stamp_ns)
        return out

    def _let_all(self) -> list[tuple[ImuSample, int | None]]:
        held, self._held = self._held, []
        return held

    def _let_go(self) -> list[Action]:
        """Samples that waited, and that no other one agreed with."""
        held = [shifted(sample, self.offsets_ns[-1]) for sample, _ in self._let_all()]
        if self._behind:  # they are late
            if held:
                self._in_order = 0
            return [*held]
        return [Refused(sample) for sample in held]
