"""truth_node: a mission -> ``<v>/truth`` of every vehicle, and ``/clock``.

At the pace ``realtime`` it follows the wall clock: before the first sample it waits, for a limited
time, until the expected nodes have found one another, and after the last one until they have
received everything. On the way it waits for nodes that are behind, if it is told to. At
``lockstep`` it publishes a window of truth only when all messages that follow from the windows
before have been received by all nodes (polar_nav_ros.flow).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rosgraph_msgs.msg import Clock

from polar_nav_msgs.msg import LockstepAck, VehicleTruth
from polar_nav_ros import topics
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.flow import Flow
from polar_nav_ros.node import ACK_TOPIC, PolarNode
from polar_nav_ros.process import run
from polar_nav_ros.stamps import to_msg

from ..mission import Mission, load_mission
from ..mission_overrides import overrides_from
from ..params import TruthParams
from ..trajectory import NS
from ..truth_stream import BLOCK_S, TruthStream
from .vehicle_ports import VehiclePorts

_TURN_S = 0.005
_COMMAND_S = 0.05
"""Length of truth made at a time if vehicles accept commands [s]."""
_LOOK_S = 0.5
_BURST_S = 0.5
"""Most truth at once at the pace realtime, so that a slow moment is made up for in steps."""
_DRAIN_S = 5.0
"""Longest wait at the pace realtime for the last messages to be received [s]."""


class TruthNode(PolarNode[TruthParams]):
    """The one source of time and motion."""

    def __init__(
        self,
        name: str = 'truth_node',
        params_cls: type[TruthParams] = TruthParams,
        **kwargs: Any,  # noqa: ANN401 - passed on to rclpy
    ) -> None:
        super().__init__(name, params_cls, **kwargs)
        p = self.params
        self._mission = _mission(p)
        # Commands act from the next block on, so blocks are as short as a command may wait.
        self._stream = TruthStream(self._mission, _COMMAND_S if p.commands else BLOCK_S)
        self._stream.sample(0)
        self._vehicles = VehiclePorts(self, self._mission) if self._mission.dynamic else None
        self._truth = {
            v: self.advertise(VehicleTruth, f'{v}/truth') for v in self._mission.vehicles
        }
        self._time = self.advertise(Clock, topics.CLOCK)
        self._next = 0
        self._wall = RosClock(clock_type=ClockType.STEADY_TIME)
        self._moved_ns = self._wall.now().nanoseconds
        self._complaint = ''
        self.create_timer(1.0, self._tell_progress, clock=self._wall)
        m = self._mission
        self.get_logger().info(
            f'mission {m.name}: {m.duration_s:.0f} s, vehicles {", ".join(m.vehicles)}, {p.pace}'
        )
        self._flow = Flow(p.expected_nodes)
        self._ready = False
        if p.pace == 'lockstep':
            self._window = max(1, round(p.window_s * NS / m.imu_period_ns))
            self.subscribe(LockstepAck, ACK_TOPIC, self._on_ack)
            self.create_timer(_LOOK_S, self._look, clock=self._wall)
            self.create_timer(_TURN_S, self._lockstep, clock=self._wall)
        elif p.expected_nodes:
            self.subscribe(LockstepAck, ACK_TOPIC, self._on_presence)
            self._gathering = self.create_timer(_LOOK_S, self._gather, clock=self._wall)
        else:
            self._run_by_the_clock()

    @property
    def mission(self) -> Mission:
        """The simulated mission."""
        return self._mission

    def diagnose(self) -> Diagnosis:
        """Health with the progress of the mission and the nodes it waits for."""
        values: dict[str, object] = {
            **self.published_counts(),
            'mission': self._mission.name,
            'sample': self._next,
            'of': self._stream.count,
        }
        if self._complaint:
            return Diagnosis(Level.WARN, self._complaint, values)
        return Diagnosis(values=values)

    def _publish_until(self, k1: int) -> None:
        """Publish samples up to k1 - 1, each followed by its time on /clock."""
        for k in range(self._next, k1):
            if self._vehicles is not None:
                self._vehicles.before(k)
            for vehicle, message in self._stream.sample(k).items():
                self._truth[vehicle].publish(message)
            if self._vehicles is not None:
                self._vehicles.publish(k, self._stream.stamp_ns(k))
            self._time.publish(Clock(clock=to_msg(self._stream.stamp_ns(k))))
        self._next = k1
        self._moved_ns = self._wall.now().nanoseconds
        self._complaint = ''

    def _gather(self) -> None:
        """Wait until the graph is complete, but not for ever; then start the clock."""
        missing = self._missing()
        if missing and not self._waited(self.params.gather_s):
            return
        if missing:
            self.get_logger().warning(
                f'starting without the whole graph after {self.params.gather_s:.0f} s: '
                + '; '.join(missing)
            )
        else:
            self.get_logger().info('the graph is complete')
        self._gathering.cancel()
        self._run_by_the_clock()

    def _run_by_the_clock(self) -> None:
        self._moved_ns = self._wall.now().nanoseconds
        self._turned_ns = self._moved_ns
        self._began_ns = self._moved_ns + round(self.params.start_delay_s * NS)
        self.create_timer(_TURN_S, self._realtime, clock=self._wall)

    def _missing(self) -> list[str]:
        outputs = [*self._truth.values(), self._time]
        if self._vehicles is not None:
            outputs += self._vehicles.outputs
        self._flow.own(self.published_counts(), {o.topic: o.matched for o in outputs})
        return self._flow.missing()

    def _waited(self, limit_s: float) -> bool:
        return bool(self._wall.now().nanoseconds - self._moved_ns > limit_s * NS)

    def _on_presence(self, ack: LockstepAck) -> None:
        self._flow.update(ack)

    def _realtime(self) -> None:
        period_ns = self._mission.imu_period_ns
        now_ns = self._wall.now().nanoseconds
        if self._some_node_is_behind():
            # Time that the graph was waited for has not passed: no burst makes up for it.
            self._began_ns += now_ns - self._turned_ns
            self._turned_ns = now_ns
            self._complain(self._behind)
            return
        self._turned_ns = now_ns
        passed_ns = (now_ns - self._began_ns) * self.params.realtime_factor
        due = int(passed_ns // period_ns) + 1
        burst = max(1, round(_BURST_S * NS / period_ns))
        k1 = min(due, self._next + burst, self._stream.count)
        if k1 > self._next:
            self._publish_until(k1)
            self._prepare()
        elif self._next == self._stream.count and self._all_taken():
            self._end()

    def _some_node_is_behind(self) -> bool:
        limit_s = self.params.max_behind_s * max(1.0, self.params.realtime_factor)
        if limit_s == 0.0:
            return False
        self._flow.own(self.published_counts())
        return self._flow.lag_s(self._next * self._mission.imu_period_ns / NS) > limit_s

    def _all_taken(self) -> bool:
        """Whether all nodes have acknowledged everything, or the time for it is over."""
        self._flow.own(self.published_counts())
        return not self._flow.heard or self._flow.settled() or self._waited(_DRAIN_S)

    def _on_ack(self, ack: LockstepAck) -> None:
        self._flow.update(ack)
        self._lockstep()

    def _lockstep(self) -> None:
        if not self._ready or not self._settled():
            return
        if self._next == self._stream.count:
            self._end()
            return
        self._publish_until(min(self._next + self._window, self._stream.count))
        self._flow.own(self.published_counts())
        # While the others work on this window.
        self._prepare()

    def _prepare(self) -> None:
        """Make truth ahead, unless commands may still change it."""
        if not self.params.commands:
            self._stream.prepare(self._next - 1)

    def _look(self) -> None:
        """Check whether the graph is complete, and log the missing nodes."""
        if not self._ready:
            self._ready = not self._missing()
            if self._ready:
                self.get_logger().info('the graph is complete')
                self._moved_ns = self._wall.now().nanoseconds
                return
        if not (self._next == self._stream.count and self._settled()):
            self._complain(self._behind if self._ready else self._absent)

    def _complain(self, of: Callable[[], str]) -> None:
        """Log what the truth waits for, once it has waited for long."""
        waited_s = (self._wall.now().nanoseconds - self._moved_ns) / NS
        if waited_s >= self.params.stall_s:
            self._complaint = f'waiting for {waited_s:.0f} s: {of()}'
            self.get_logger().warning(self._complaint, throttle_duration_sec=self.params.stall_s)

    def _tell_progress(self) -> None:
        period_s = self._mission.imu_period_ns / NS
        done_s, total_s = self._next * period_s, self._stream.count * period_s
        self.tell_supervisor('progress', f'{done_s:.1f} {total_s:.1f}')

    def _settled(self) -> bool:
        """Whether all messages are received, also the resulting commands by this node."""
        return self._flow.settled() and (
            self._vehicles is None or self._vehicles.taken(self._flow.published())
        )

    def _absent(self) -> str:
        return '; '.join(self._flow.missing())

    def _behind(self) -> str:
        return '; '.join(
            f'{node} has received {taken} of {sent} of {topic}'
            for node, topics in self._flow.laggards().items()
            for topic, (taken, sent) in topics.items()
        )

    def _end(self) -> None:
        if self.params.exit_at_end and self.ended is None:
            self._tell_progress()
            self.get_logger().info('the mission is over')
            self.ended = 0


def _mission(p: TruthParams) -> Mission:
    mission = load_mission(p.mission)
    if p.overrides:
        mission = mission.with_overrides(overrides_from(p.overrides))
    if p.duration_s > 0.0:
        mission = mission.with_duration(p.duration_s)
    return mission


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(TruthNode, args)
