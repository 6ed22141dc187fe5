"""One run of a follower over messages, as its node takes them: session, health, diagnostics.

What `FollowerNode` does, without the middleware: each message goes into the node's own session
when it arrives, and once a second of true time health and diagnostics are looked at. A steady
clock that no fault changes says when that is, as the node's does.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_msgs.msg import Command
from polar_nav_ros import topics
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.navigation_health import NavigationHealth
from polar_nav_ros.navigation_session import Published
from polar_nav_ros.stamps import to_msg

from ...inject.readings import IMU, NS, Reading
from ..received import VEHICLE, Received
from .trace import Listener, Trace


class Taken(NamedTuple):
    """A message that a follower takes, as bytes too, and the reading that it is of."""

    received: Received
    data: bytes
    reading: Reading


class Recorded(NamedTuple):
    """A message as a recorder gets it: topic without the vehicle, bytes, when [ns]."""

    topic: str
    data: bytes
    log_ns: int


class LiveRun:
    """A follower that runs.

    Parameters
    ----------
    params : FollowerParams
    start_ns : int
        True time of the start [ns].

    Attributes
    ----------
    record : list of Recorded
        What it took and published, in order.
    """

    def __init__(self, params: FollowerParams, start_ns: int) -> None:
        self._now_ns = start_ns
        self._session = Session(params, VEHICLE)
        self._session.marks_starts = True
        self._health = NavigationHealth(
            self._session.engine, _Quiet(), lambda: 1e-9 * self._now_ns
        )
        self._imu_seen: tuple[int | None, int] = (None, start_ns)
        self._true_ns: dict[int, int] = {}
        self._stamps_ns: list[int] = []
        self._ahead_ns: list[int] = []
        self._listener = Listener(start_ns)
        self.record: list[Recorded] = []

    def take(self, taken: Taken) -> None:
        """Take one message, after a look at every second before it."""
        (topic, message, arrival_ns), data, reading = taken
        self._until(arrival_ns)
        if reading.stream == IMU:
            self._true_ns[reading.stamp_ns] = reading.true_ns
        self.record.append(Recorded(topic, data, arrival_ns))
        self._publish(self._session.take(topic, message, arrival_ns), arrival_ns)

    def end(self, until_ns: int) -> None:
        """End the node in order at a true time [ns]."""
        self._until(until_ns)
        self._publish(self._session.flush(), until_ns)
        names = (*self._session.sensors, topics.RX)
        message = Command(
            kind=Command.SHUTDOWN,
            taken_topics=[f'/{VEHICLE}/{name}' for name in names],
            taken_counts=[self._session.taken[name] for name in names],
        )
        message.header.stamp = to_msg(self._session.reorder.newest_imu_ns or 0)
        self.record.append(Recorded(topics.COMMAND, to_bytes(message), until_ns))

    def trace(self, until_ns: int) -> Trace:
        """What was published until a true time [ns]."""
        engine = self._session.engine
        ended = '' if engine.navigating else engine.divergence or 'no state'
        return self._listener.trace(until_ns, ended)

    def true_ns(self, stamp_ns: int) -> int:
        """True time [ns] of a stamp of the engine at any time of the run, by its estimates."""
        k = bisect_right(self._stamps_ns, stamp_ns) - 1
        return stamp_ns + (self._ahead_ns[k] if k >= 0 else 0)

    def _true_now_ns(self, stamp_ns: int) -> int:
        """True time of the engine's newest stamp, which goes on over steps of clocks [ns]."""
        own_ns = self._session.engine.clock.own_ns(stamp_ns)
        # One that is of no sample's stamp is of the engine's own time.
        return self._true_ns.get(own_ns, stamp_ns)

    def _publish(self, published: Iterable[Published], now_ns: int) -> None:
        for topic, message, data in published:
            self.record.append(Recorded(topic, data, now_ns))
            at_ns = now_ns
            if topic == topics.STATE:
                stamp = message.header.stamp
                stamp_ns = stamp.sec * NS + stamp.nanosec
                at_ns = self._true_now_ns(stamp_ns)
                self._stamps_ns.append(stamp_ns)
                self._ahead_ns.append(at_ns - stamp_ns)
            self._listener.hear(topic, message, at_ns)

    def _until(self, arrival_ns: int) -> None:
        while self._now_ns + NS <= arrival_ns:
            self._now_ns += NS
            self._look()

    def _look(self) -> None:
        """What the node's timer does once a second (`NavigationPorts.diagnose`)."""
        imu_ns = self._session.engine.last_imu_ns
        if imu_ns != self._imu_seen[0]:
            self._imu_seen = imu_ns, self._now_ns
        silent_s = (self._now_ns - self._imu_seen[1]) / NS
        self._publish(self._session.silence(silent_s), self._now_ns)
        found = self._health.diagnose({'waiting': self._session.reorder.pending})
        self._listener.word(self._now_ns, int(found.level), found.message)


class _Quiet:
    """A logger that logs nothing."""

    def info(self, message: str) -> None:
        del message

    def warning(self, message: str) -> None:
        del message

    def error(self, message: str) -> None:
        del message


def drive(
    params: FollowerParams, messages: Sequence[Taken], start_ns: int, end_ns: int
) -> LiveRun:
    """Run of a node with these parameters that receives the messages, to its end."""
    run = LiveRun(params, start_ns)
    for taken in messages:
        if taken.received.arrival_ns > end_ns:
            break
        run.take(taken)
    run.end(end_ns)
    return run
