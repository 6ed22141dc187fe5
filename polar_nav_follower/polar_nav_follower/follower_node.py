"""Follower: takes sensors and packets, publishes the estimate and what became of every fix.

| topic | type | stamp |
| --- | --- | --- |
| in imu/data_raw, dvl/data, depth/data | sensor_msgs/Imu, polar_nav_msgs/Dvl, Depth | validity |
| in acomms/rx | polar_nav_msgs/AcousticPacket | transmission; the engine orders by receive_time |
| out nav/state | polar_nav_msgs/NavState | estimate |
| out odometry, nav/fix | nav_msgs/Odometry, sensor_msgs/NavSatFix | estimate |
| out nav/receipt | polar_nav_msgs/FixReceipt | decision |
| out nav/command | polar_nav_msgs/Command | place in the order of events |
| out acomms/decoded | polar_nav_msgs/LeaderBroadcast | validity |
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, NavSatFix
from std_srvs.srv import Trigger

from polar_nav_core.engine.events import CommandKind, Verdict
from polar_nav_core.kernels.warm import warm_up
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl, FixReceipt, LeaderBroadcast, NavState
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_msgs.msg import InitialState as InitialStateMsg
from polar_nav_msgs.srv import SetInitialState
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode, run
from polar_nav_ros.stamps import to_msg, to_ns

from . import convert, session
from .params import FollowerParams
from .standard_outputs import fix_of, odometry_of


class FollowerNode(PolarNode[FollowerParams]):
    """Thin: every callback is one call of the session, whose results are published."""

    def __init__(self) -> None:
        super().__init__('follower_node', FollowerParams)
        # Before anything is subscribed to: a cold compile takes long, and sensors do not wait.
        warm_up()
        self._session = session.Session(self.params, self.vehicle)
        self._outputs_by_topic = {
            session.STATE: self.advertise(NavState, session.STATE),
            session.RECEIPT: self.advertise(FixReceipt, session.RECEIPT),
            session.DECODED: self.advertise(LeaderBroadcast, session.DECODED),
        }
        self._commands = self.advertise(CommandMsg, session.COMMAND)
        self._odometry = self.advertise(Odometry, 'odometry')
        self._fix = self.advertise(NavSatFix, 'nav/fix')
        self._command_count = 0
        self._fix_second = -1
        self.subscribe(Imu, session.IMU, self._taker(session.IMU))
        self.subscribe(Dvl, session.DVL, self._taker(session.DVL))
        self.subscribe(Depth, session.DEPTH, self._taker(session.DEPTH))
        self.subscribe(AcousticPacket, session.PACKET, self._taker(session.PACKET))
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetInitialState, '~/set_initial_state', self._on_set_initial_state)
        self.get_logger().info(
            f'configuration {self.params.configuration}, {self._session.engine.configuration.doc}'
        )

    def diagnose(self) -> Diagnosis:
        """Verdict counters, ages and what waits."""
        engine = self._session.engine
        values: dict[str, object] = {
            v.name: engine.verdicts[v] for v in Verdict if engine.verdicts[v]
        }
        values |= {f'fused_{k}': v for k, v in engine.fused.items()}
        values |= {f'gated_{k}': v for k, v in engine.gated.items()}
        values |= {
            'imu_gaps': engine.imu_gaps,
            'waiting': self._session.reorder.pending,
            **self.taken_counts(),
        }
        if engine.divergence:
            return Diagnosis(Level.ERROR, engine.divergence, values)
        if not engine.navigating:
            return Diagnosis(
                Level.WARN, 'no state yet: waits for IMU data or ~/set_initial_state', values
            )
        if engine.verdicts[Verdict.TOO_LATE]:
            count = engine.verdicts[Verdict.TOO_LATE]
            return Diagnosis(Level.WARN, f'{count} messages came after reorder_window_s', values)
        return Diagnosis(Level.OK, 'navigating', values)

    def close(self) -> None:
        """Process what waits, and say in a command where the run ended."""
        self._publish(self._session.flush())
        stamp_ns = self._session.reorder.newest_imu_ns
        if stamp_ns is not None:
            taken = self.taken_counts()
            message = CommandMsg(
                kind=CommandMsg.SHUTDOWN,
                taken_topics=list(taken),
                taken_counts=list(taken.values()),
            )
            self._send(message, stamp_ns)

    def _taker(self, topic: str) -> Callable[[Any], None]:
        return lambda message: self._publish(self._session.take(topic, message))

    def _publish(self, published: Iterable[session.Published]) -> None:
        for topic, message, data in published:
            self._outputs_by_topic[topic].publish(data)
            if topic == session.STATE:
                self._publish_standard(message)

    def _publish_standard(self, state: NavState) -> None:
        """Give the same estimate in standard messages, for other people's tools."""
        self._odometry.publish(odometry_of(state))
        if state.header.stamp.sec != self._fix_second:
            self._fix_second = state.header.stamp.sec
            self._fix.publish(fix_of(state))

    def _send(self, message: CommandMsg, stamp_ns: int) -> None:
        message.header.stamp = to_msg(stamp_ns)
        message.sequence = self._command_count
        self._command_count += 1
        self._commands.publish(message)

    def _command(self, kind: CommandKind, initial: InitialStateMsg) -> str:
        """Put a service call into the order of events; why not, in a sentence, or empty."""
        stamp_ns = self._session.reorder.newest_imu_ns
        if stamp_ns is None:
            return (
                'there was no IMU sample yet, so the command has no place in the order of events'
            )
        message = CommandMsg(kind=int(kind), initial_state=initial)
        self._send(message, stamp_ns)
        self._publish(self._session.take(session.COMMAND, message))
        return ''

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        initial = self.params.initial_state()
        message = InitialStateMsg() if initial is None else convert.initial_to_msg(initial)
        response.message = self._command(CommandKind.RESET, message)
        response.success = not response.message
        return response

    def _on_set_initial_state(
        self, request: SetInitialState.Request, response: SetInitialState.Response
    ) -> SetInitialState.Response:
        initial = convert.initial_from_msg(request.initial_state)
        if initial is None:
            sigma = request.initial_state.sigma_position_horizontal
            response.message = f'sigma_position_horizontal is {sigma}: it must be positive'
        elif to_ns(request.initial_state.header.stamp):
            response.message = (
                'header.stamp must be zero: the state is taken to hold with the next IMU sample'
            )
        else:
            response.message = convert.initial_problem(initial) or self._command(
                CommandKind.SET_INITIAL_STATE, request.initial_state
            )
        response.success = not response.message
        return response


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(FollowerNode, args)


if __name__ == '__main__':
    sys.exit(main())
