"""Sorts live messages into the total order of events by a window of stamp time.

The newest IMU stamp less the window is the watermark: messages up to it have come, or come too
late. A message that comes too late is refused with a receipt (TOO_LATE); one that is stamped far
ahead waits for others that agree, or is refused (FROM_FUTURE). A clock that steps is followed
(`clocks`). A replay reads these receipts and steps, and does the same.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import itemgetter

from .clocks import Clocks
from .engine import Engine
from .events import ClockStep, Command, Event, Fix, ImuSample, OrderKey
from .imu_clock import Action, Refused
from .outputs import Output, Receipt
from .verdicts import Verdict

_AHEAD_NS = 60_000_000_000
"""A packet received farther ahead of the IMU does not wait for it."""
_MOST_WAITING = 65_536
"""Messages that others may wait with, in a flood or while the IMU is silent."""


class Reorder:
    """Live driver of an :class:`Engine`: a priority queue of messages with a watermark.

    Parameters
    ----------
    engine : Engine
        The engine.
    window_s : float
        Stamp time that messages may come out of order.
    leap_s : float
        Stamp time that one IMU sample may be ahead without another one that agrees.
    """

    def __init__(self, engine: Engine, window_s: float, leap_s: float) -> None:
        self.engine = engine
        self._clocks = Clocks(leap_s, window_s)
        self._window_ns = round(window_s * 1e9)
        self._heap: list[tuple[OrderKey, Event]] = []
        self.newest_imu_ns: int | None = None
        self._first_imu_ns: int | None = None
        self.watermark_ns: int | None = None

    @property
    def start_ns(self) -> int | None:
        """Stamp [ns] for an event at the first IMU sample, or as soon after it as one can be."""
        if self._first_imu_ns is None:
            return None
        return max(self._first_imu_ns, (self.watermark_ns or 0) + 1)

    @property
    def pending(self) -> int:
        """Number of events that wait for the window to pass."""
        return len(self._heap)

    def waiting_imu(self) -> list[ImuSample]:
        """IMU samples that wait for the window to pass, in order."""
        events = (event for _, event in sorted(self._heap, key=itemgetter(0)))
        return [event for event in events if isinstance(event, ImuSample)]

    def add(self, event: Event, arrival_ns: int | None = None) -> Iterator[Output | ClockStep]:
        """Queue one message; yields estimates and receipts of all events that are due now.

        Parameters
        ----------
        event : Event
        arrival_ns : int or None
            When it came, by a steady clock [ns]; None where that means nothing (a simulation).
        """
        if isinstance(event, Command):  # its stamp is of the engine's time
            yield from self._add(event)
        else:
            yield from self._act(self._clocks.take(event, arrival_ns))

    def _act(self, actions: list[Action]) -> Iterator[Output | ClockStep]:
        for action in actions:
            if isinstance(action, ClockStep):
                self.engine.clock.note(action)
                yield action
            elif isinstance(action, Refused):
                yield self._refuse_ahead(action.event)
            else:
                yield from self._add(action)

    def _refuse_ahead(self, event: Event) -> Receipt:
        """Receipt of a message stamped ahead that no other one agreed with."""
        newest_ns = self._clocks.imu.newest_ns
        ahead_s = 0.0 if newest_ns is None else (event.stamp_ns - newest_ns) * 1e-9
        reason = f'{ahead_s:.3f} s ahead of its stream, and the next message did not agree'
        return self.engine.refuse(event, Verdict.FROM_FUTURE, reason, self.watermark_ns or 0)

    def _add(self, event: Event) -> Iterator[Output]:
        """Queue one message whose stamp is believed."""
        no_room = self._no_room(event)
        if no_room:
            stamp_ns = self.watermark_ns or 0
            yield self.engine.refuse(event, Verdict.TOO_LATE, no_room, stamp_ns)
            return
        if self.watermark_ns is not None and event.stamp_ns <= self.watermark_ns:
            late = (self.watermark_ns + self._window_ns - event.stamp_ns) * 1e-9
            window = self._window_ns * 1e-9
            reason = (
                f'{late:.3f} s behind the newest IMU sample, the reorder window is {window:.3f} s'
            )
            yield self.engine.refuse(event, Verdict.TOO_LATE, reason, self.watermark_ns)
            return
        heapq.heappush(self._heap, (event.key, event))
        if isinstance(event, ImuSample) and (
            self.newest_imu_ns is None or event.stamp_ns > self.newest_imu_ns
        ):
            self.newest_imu_ns = event.stamp_ns
            if self._first_imu_ns is None:
                self._first_imu_ns = event.stamp_ns
            self.watermark_ns = event.stamp_ns - self._window_ns
            yield from self._release(self.watermark_ns)

    def _no_room(self, event: Event) -> str:
        """Reason not to let a message wait for the IMU; empty if there is room for it."""
        if isinstance(event, ImuSample | Command):  # time goes on by it; a person sent it
            return ''
        if len(self._heap) >= _MOST_WAITING:
            return f'{_MOST_WAITING} messages wait for the IMU already'
        if not isinstance(event, Fix):
            return ''
        ahead_ns = 0 if self.newest_imu_ns is None else event.stamp_ns - self.newest_imu_ns
        if ahead_ns > _AHEAD_NS:
            return f'received {ahead_ns * 1e-9:.0f} s ahead of the newest IMU sample'
        return ''

    def flush(self) -> Iterator[Output | ClockStep]:
        """Process all waiting events at the end of a run; yields estimates and receipts."""
        yield from self._act(self._clocks.flush())
        while self._heap:
            yield from self.engine.process(heapq.heappop(self._heap)[1])
        yield from self.engine.finish()

    def _release(self, until_ns: int) -> Iterator[Output]:
        while self._heap and self._heap[0][0][0] <= until_ns:
            yield from self.engine.process(heapq.heappop(self._heap)[1])
        yield from self.engine.advance(until_ns + 1)
