"""Stamps ahead of their stream: held back until a second message agrees.

One message with a stamp far ahead (a wrong clock, a damaged field) would carry the time of all
streams with it, and everything after it would come too late for good. So it waits for the next
message of its topic: if that goes on from it, time has really moved on; else it is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from .events import Event, ImuSample

_FIRST_NS = 10_000_000_000
"""Between the first two messages of a topic."""
_OTHERS_NS = 10_000_000_000
"""That a message of another sensor may be ahead of its topic and of the IMU."""


@dataclass
class _Stream:
    newest_ns: int | None = None
    held: list[Event] = field(default_factory=list)


class Ahead:
    """Judges the stamps of one vehicle's sensors, topic by topic.

    Parameters
    ----------
    leap_s : float
        Stamp time that an IMU sample may be ahead of the one before.
    """

    def __init__(self, leap_s: float) -> None:
        self._leap_ns = round(leap_s * 1e9)
        self._streams: dict[str, _Stream] = {}

    def take(self, event: Event, now_ns: int | None) -> tuple[list[Event], list[Event]]:
        """Messages to take now, and messages that nothing agreed with, after another one came.

        Parameters
        ----------
        event : Event
            The newest message of its topic.
        now_ns : int or None
            Newest stamp of the IMU; None before the first.
        """
        stream = self._streams.setdefault(event.topic, _Stream())
        last_ns = _last_ns(stream, now_ns)
        is_ahead = self._is_ahead(last_ns, event)
        if stream.held and stream.held[0].stamp_ns == event.stamp_ns:
            stream.held.append(event)  # the same again: no other one that agrees
            return [], []
        held, stream.held = stream.held, []
        if is_ahead and held and self._agree(last_ns, held[0].stamp_ns, event.stamp_ns):
            held.append(event)
            stream.newest_ns = max(e.stamp_ns for e in held)
            return held, []
        if is_ahead:
            stream.held = [event]
            return [], held
        stream.newest_ns = max(event.stamp_ns, stream.newest_ns or 0)
        return [event], held

    def flush(self) -> tuple[list[Event], list[Event]]:
        """Messages to take at the end of a run, and messages that nothing agreed with."""
        taken: list[Event] = []
        refused: list[Event] = []
        for stream in self._streams.values():
            # The only ones of their topic are no worse than any.
            (taken if stream.newest_ns is None else refused).extend(stream.held)
            stream.held = []
        return taken, refused

    def ahead_s(self, event: Event, now_ns: int | None) -> float:
        """How far a message is ahead of its topic and of the IMU [s]."""
        last_ns = _last_ns(self._streams[event.topic], now_ns)
        return 0.0 if last_ns is None else (event.stamp_ns - last_ns) * 1e-9

    def _is_ahead(self, last_ns: int | None, event: Event) -> bool:
        if last_ns is None:  # the first of a run: the IMU's, which moves the time, waits, too
            return isinstance(event, ImuSample)
        # Others wait for the IMU's time anyhow, and may come before it by what a node lags behind.
        leap_ns = self._leap_ns if isinstance(event, ImuSample) else _OTHERS_NS
        return event.stamp_ns - last_ns > leap_ns

    def _agree(self, last_ns: int | None, held_ns: int, stamp_ns: int) -> bool:
        """Whether a message goes on from the held one, by no longer a way than the leap to it."""
        longest_ns = _FIRST_NS if last_ns is None else held_ns - last_ns
        way_ns = stamp_ns - held_ns
        return -self._leap_ns <= way_ns <= max(longest_ns, self._leap_ns)


def _last_ns(stream: _Stream, now_ns: int | None) -> int | None:
    """Newest stamp of a topic or of the IMU."""
    known = [ns for ns in (stream.newest_ns, now_ns) if ns is not None]
    return max(known, default=None)
