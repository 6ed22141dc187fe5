"""Clocks of one vehicle's topics: all stamps on the engine's time, which goes on over steps.

The IMU's clock is the one that the engine's time goes on with (`imu_clock`). When it steps, the
topics whose stamps make the same step follow it; a topic with a clock of its own keeps its
offset, and gets another one when its own clock steps: three messages in a row then show it. One
that came in time, and of which nothing does any more, is put beside the IMU's newest sample again:
its clock or the IMU's steps by less, or creeps, and all would be refused for good. Without a step,
the stamps of all topics are the engine's time. The validity of a packet is of its sender's clock,
and stays.

The steps are the one thing that depends on the order in which topics arrive, and on the steady
clock: they are recorded, and a replay reads them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median_low

from .events import ClockStep, Event, Fix, ImuSample, number_of, shifted
from .imu_clock import LEAST_STEP_NS, Action, ImuClock, Refused

_AHEAD_NS = 10_000_000_000
"""That a message may be ahead of its topic and of the IMU, where arrival tells nothing."""
_AGREE_NS = 250_000_000
"""Messages of a clock that stepped are off by the same, but for their delays."""
_STEP_MESSAGES = 3
_SETTLED = 5
"""Messages in a row for which a topic's own offset is right after a step of the IMU's clock."""
_USUAL = 10
"""Messages in time that show how far their topic is behind the IMU's newest sample."""
_OFF, _OFF_NS = 5, 3_000_000_000
"""Messages in a row that are all off, and for how long: less are a computer that is busy."""
_EARLY_NS = 50_000_000
"""A message stamped so long after it came is of another clock."""
_MOST_HELD = 256
_MOST_STEPS = 64
"""Newest steps of the IMU's clock, of which a topic may have made the first ones."""


@dataclass
class _Topic:
    """Clock of a topic.

    ``base`` is the number of the IMU's offset that it has, ``extra_ns`` its own besides;
    ``before_ns`` the same before its own last step, None where that was long right. ``newest_off``
    is engine time less the newest possible one, of its newest messages. ``lags_ns`` is how far its
    first ones in time were behind the IMU's newest sample, ``off`` the same of those since the
    last one in time, which were too late or stamped after they came, each with the IMU's time.
    """

    base: int = 0
    extra_ns: int = 0
    before_ns: int | None = None
    newest_ns: int | None = None
    newest_own_ns: int | None = None
    newest_off: deque[int] = field(default_factory=lambda: deque(maxlen=_USUAL))
    right: int = 0
    held: list[tuple[Event, int | None]] = field(default_factory=list)
    lags_ns: list[int] = field(default_factory=list)
    off: list[tuple[int, int]] = field(default_factory=list)

    @property
    def usual_ns(self) -> int | None:
        """Engine time less the newest possible one of the least late of its newest messages.

        The last one alone may be late by chance, and the next one would seem to be ahead.
        """
        return max(self.newest_off, default=None)


class Clocks:
    """Judge of all stamps of one vehicle's sensors and packets.

    Parameters
    ----------
    leap_s : float
        Stamp time that an IMU sample may be ahead of the one before.
    window_s : float
        Stamp time that a message may be behind the IMU's newest sample.
    """

    def __init__(self, leap_s: float, window_s: float = math.inf) -> None:
        self._leap_ns = round(leap_s * 1e9)
        self._window_ns = window_s * 1e9
        self.imu = ImuClock(leap_s, window_s)
        self._topics: dict[str, _Topic] = {}

    def take(self, event: Event, arrival_ns: int | None = None) -> list[Action]:
        """Messages to use and to refuse, and steps of clocks, after another message came.

        Parameters
        ----------
        event : Event
            Newest message of its topic, with the stamp of its own clock.
        arrival_ns : int or None
            When it came, by a steady clock; None where that means nothing.
        """
        if isinstance(event, ImuSample):
            out = self.imu.take(event, arrival_ns)
            if not self.imu.undecided and any(topic.held for topic in self._topics.values()):
                for topic in self._topics.values():
                    out += self._again(topic)
            return out
        topic = self._topics.setdefault(event.topic, _Topic())
        return self._take(topic, event, arrival_ns)

    def flush(self) -> list[Action]:
        """Messages to use and to refuse at the end of a run."""
        out = self.imu.flush()
        for topic in self._topics.values():
            held, topic.held = topic.held, []
            late = [shifted(e, self._offset_ns(topic)) for e, _ in held]
            # The only ones of their topic are no worse than any.
            out += late if topic.newest_ns is None else [self._let_go(e) for e in late]
        return out

    def _take(self, topic: _Topic, event: Event, arrival_ns: int | None) -> list[Action]:
        """`take` of a message of another topic than the IMU's."""
        now_ns = self.imu.newest_ns
        if now_ns is None:
            return self._use(topic, event, arrival_ns)
        out = self._follow(topic, event, now_ns)
        if out or not self._is_off(topic, event, arrival_ns):
            return [*out, *self._release(topic), *self._use(topic, event, arrival_ns)]
        if self.imu.undecided and len(topic.held) < _MOST_HELD:
            topic.held.append((event, arrival_ns))
            return []
        return self._judge(topic, event, arrival_ns)

    def _follow(self, topic: _Topic, event: Event, now_ns: int) -> list[Action]:
        """Step of a topic together with the IMU's clock, if its stamps make the same one."""
        newest = len(self.imu.offsets_ns) - 1
        if topic.base == newest:
            return []
        off_ns = event.stamp_ns + self._offset_ns(topic) - now_ns
        if abs(off_ns) <= _AGREE_NS:
            topic.right += 1
            if topic.right >= _SETTLED:  # a clock of its own
                topic.extra_ns = self._offset_ns(topic) - self.imu.offsets_ns[newest]
                topic.base = newest
            return []
        topic.right = 0

        def left_ns(base: int) -> int:
            return abs(event.stamp_ns + self.imu.offsets_ns[base] + topic.extra_ns - now_ns)

        # While it was silent it may have made an earlier step, and not the later ones.
        steps = range(newest, max(topic.base, newest - _MOST_STEPS), -1)
        base = min(steps, key=left_ns)
        if left_ns(base) >= 0.5 * abs(off_ns):
            return []
        out = self._release(topic)
        was_ns, topic.base = self._offset_ns(topic), base
        return [*out, self._step(topic, event, was_ns)]

    def _is_off(self, topic: _Topic, event: Event, arrival_ns: int | None) -> bool:
        """Whether a message is stamped as no message of its topic can be."""
        stamp_ns = event.stamp_ns + self._offset_ns(topic)
        possible_ns = self.imu.arrivals.newest_possible_ns(arrival_ns)
        if possible_ns is None or topic.usual_ns is None:
            known = [ns for ns in (topic.newest_ns, self.imu.newest_ns) if ns is not None]
            back = self.imu.undecided and stamp_ns < max(known) - LEAST_STEP_NS
            return back or stamp_ns - max(known) > _AHEAD_NS
        off_ns = stamp_ns - possible_ns - topic.usual_ns
        if off_ns > LEAST_STEP_NS:
            return True
        # One that is late still goes on from the others of its topic.
        back_ns = (topic.newest_own_ns or 0) - event.stamp_ns
        return off_ns < -LEAST_STEP_NS and back_ns > LEAST_STEP_NS

    def _judge(self, topic: _Topic, event: Event, arrival_ns: int | None) -> list[Action]:
        """What becomes of a message that is off, while the IMU goes on."""
        if isinstance(event, Fix):  # its reception alone says nothing: it waits for the IMU's time
            return self._use(topic, event, arrival_ns)
        possible_ns = self.imu.arrivals.newest_possible_ns(arrival_ns)
        unseen = possible_ns is None or topic.usual_ns is None
        out: list[Action] = []
        if topic.held and topic.held[0][0].stamp_ns == event.stamp_ns:
            topic.held.append((event, arrival_ns))  # the same again: no other one that agrees
            return self._release(topic) if len(topic.held) >= _MOST_HELD else []
        if topic.held and not self._agrees(topic, event, arrival_ns):
            out = self._release(topic)
        topic.held.append((event, arrival_ns))
        if unseen and len(topic.held) > 1:  # a gap of its own, or of the IMU
            return [*out, *self._use_held(topic)]
        if unseen or len(topic.held) < _STEP_MESSAGES:
            return out
        first, first_arrival_ns = topic.held[0]
        first_possible_ns = self.imu.arrivals.newest_possible_ns(first_arrival_ns)
        was_ns = self._offset_ns(topic)
        stamp_ns = (first_possible_ns or 0) + (topic.usual_ns or 0)
        topic.before_ns = topic.extra_ns
        topic.extra_ns += stamp_ns - first.stamp_ns - was_ns
        return [*out, self._step(topic, first, was_ns), *self._use_held(topic)]

    def _agrees(self, topic: _Topic, event: Event, arrival_ns: int | None) -> bool:
        """Whether a message that is off goes on from those that wait."""
        (first, _), (last, last_arrival_ns) = topic.held[0], topic.held[-1]
        possible_ns = self.imu.arrivals.newest_possible_ns(arrival_ns)
        last_possible_ns = self.imu.arrivals.newest_possible_ns(last_arrival_ns)
        way_ns = event.stamp_ns - last.stamp_ns
        if possible_ns is None or last_possible_ns is None:
            known = [ns for ns in (topic.newest_ns, self.imu.newest_ns) if ns is not None]
            longest_ns = first.stamp_ns + self._offset_ns(topic) - max(known)
            way_ns = event.stamp_ns - first.stamp_ns
            return -self._leap_ns <= way_ns <= max(longest_ns, self._leap_ns)
        return way_ns > 0 and abs(way_ns - (possible_ns - last_possible_ns)) <= _AGREE_NS

    def _again(self, topic: _Topic) -> list[Action]:
        """Judge messages that waited for the IMU's clock once more."""
        held, topic.held = topic.held, []
        out: list[Action] = []
        for event, arrival_ns in held:
            out += self._take(topic, event, arrival_ns)
        return out

    def _release(self, topic: _Topic) -> list[Action]:
        """Messages that waited, and that no other one agreed with."""
        held, topic.held = topic.held, []
        return [self._let_go(shifted(e, self._offset_ns(topic))) for e, _ in held]

    def _let_go(self, event: Event) -> Action:
        """What to do with a message that no other one agreed with."""
        ahead = self.imu.newest_ns is None or event.stamp_ns > self.imu.newest_ns
        return Refused(event) if ahead else event

    def _use_held(self, topic: _Topic) -> list[Action]:
        held, topic.held = topic.held, []
        return [one for event, arrival_ns in held for one in self._use(topic, event, arrival_ns)]

    def _use(self, topic: _Topic, event: Event, arrival_ns: int | None) -> list[Action]:
        out = self._put_right(topic, event, arrival_ns)
        one = shifted(event, self._offset_ns(topic))
        topic.newest_ns = max(one.stamp_ns, topic.newest_ns or one.stamp_ns)
        topic.newest_own_ns = event.stamp_ns
        possible_ns = self.imu.arrivals.newest_possible_ns(arrival_ns)
        if possible_ns is not None:
            off_ns = one.stamp_ns - possible_ns
            if topic.usual_ns is None or abs(off_ns - topic.usual_ns) <= LEAST_STEP_NS:
                topic.newest_off.append(off_ns)
        return [*out, one]

    def _put_right(self, topic: _Topic, event: Event, arrival_ns: int | None) -> list[Action]:
        """Step of a topic that has been off for a while, to where it was at first."""
        now_ns, was_ns = self.imu.newest_ns, self._offset_ns(topic)
        if now_ns is None:
            return []
        lag_ns = now_ns - event.stamp_ns - was_ns
        known = len(topic.lags_ns) == _USUAL
        early = known and self._is_early(topic, lag_ns, now_ns, arrival_ns)
        if not early and lag_ns < self._window_ns:
            topic.off.clear()
            topic.before_ns = None
            if not known:
                topic.lags_ns.append(lag_ns)
            return []
        if topic.off and abs(lag_ns - topic.off[0][1]) > _AGREE_NS:
            topic.off.clear()
        back_ns = 0 if topic.before_ns is None else topic.before_ns - topic.extra_ns
        no_step = back_ns != 0 and abs(lag_ns - back_ns) < self._window_ns
        # `_judge` follows longer steps, and knows late ones; one that was none it cannot see.
        if abs(lag_ns) > LEAST_STEP_NS and not no_step:
            return []
        topic.off = [*topic.off[: _MOST_HELD - 1], (now_ns, lag_ns)]
        if not known or len(topic.off) < _OFF or now_ns - topic.off[0][0] < _OFF_NS:
            return []
        off_ns = median_low(ns for _, ns in topic.off) - median_low(topic.lags_ns)
        topic.off.clear()
        topic.newest_off.clear()
        topic.extra_ns, topic.before_ns = topic.extra_ns + (back_ns if no_step else off_ns), None
        return [self._step(topic, event, was_ns)]

    def _is_early(self, topic: _Topic, lag_ns: int, now_ns: int, arrival_ns: int | None) -> bool:
        """Whether a message is stamped after it came, as none of its topic was at first."""
        possible_ns = self.imu.arrivals.newest_possible_ns(arrival_ns)
        if possible_ns is None:
            return False
        usual_ns = median_low(topic.lags_ns)
        return now_ns - lag_ns > possible_ns + _EARLY_NS and lag_ns < usual_ns - _EARLY_NS

    def _step(self, topic: _Topic, event: Event, was_ns: int) -> ClockStep:
        """Step of a topic's clock to its present offset, from a message on."""
        stamp_ns = event.stamp_ns + self._offset_ns(topic)
        return ClockStep(event.topic, number_of(event), stamp_ns, event.stamp_ns, was_ns)

    def _offset_ns(self, topic: _Topic) -> int:
        return self.imu.offsets_ns[topic.base] + topic.extra_ns
