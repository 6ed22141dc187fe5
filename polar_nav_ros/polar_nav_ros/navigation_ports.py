"""Topics and services of a navigating node: publishes the results of its session.

| topic | type | stamp |
| --- | --- | --- |
| in imu/data_raw, dvl/data, depth/data | sensor_msgs/Imu, polar_nav_msgs/Dvl, Depth | validity |
| in imu/data, control/thrust | sensor_msgs/Imu, geometry_msgs/WrenchStamped | validity |
| out nav/state | polar_nav_msgs/NavState | estimate |
| out odometry, nav/fix | nav_msgs/Odometry, sensor_msgs/NavSatFix | estimate |
| out nav/receipt | polar_nav_msgs/FixReceipt | decision |
| out nav/health | polar_nav_msgs/NavHealth | estimate, 1 Hz |
| out nav/clock | sensor_msgs/TimeReference | a clock stepped; a topic began |
| out nav/command | polar_nav_msgs/Command | place in the order of events |
| out nav/restore | polar_nav_msgs/Restore | the same; with a `state_file` |
| out nav/start | diagnostic_msgs/DiagnosticArray | newest IMU sample; latched |
| out nav/inputs | polar_nav_msgs/Inputs | newest arrival; with `sources` |
| out nav/current, nav/model | polar_nav_msgs/WaterCurrent, VehicleModel | estimate, 1 Hz |
| out nav/identification | polar_nav_msgs/Identification | place in the order of events |

The session determines the sensors; the last three rows are there when the vehicle's model is
used. Services ``~/reset``, ``~/set_initial_state``, ``~/use/<topic>`` and, with a model,
``~/identify`` become stamped commands.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix, TimeReference
from std_srvs.srv import Trigger

from polar_nav_core.engine.events import CommandKind
from polar_nav_core.engine.plausibility import initial_problem
from polar_nav_core.engine.saved import pack
from polar_nav_core.engine.start.model import Stated
from polar_nav_msgs.msg import Command as CommandMsg
from polar_nav_msgs.msg import FixReceipt, NavHealth, NavState
from polar_nav_msgs.msg import InitialState as InitialStateMsg
from polar_nav_msgs.msg import Restore as RestoreMsg
from polar_nav_msgs.srv import SetInitialState

from .counted import CountedPublisher
from .diagnostics import Diagnosis
from .live_outputs import LiveOutputs
from .navigation_health import NavigationHealth
from .navigation_session import (
    MODEL_OUTPUTS,
    SENSORS,
    NavigationSession,
    Published,
)
from .node import PolarNode
from .readers import ImuRow, initial_from_msg, initial_to_msg
from .services import add_map_services, add_switches
from .source_ports import SourcePorts
from .stamps import to_msg, to_ns
from .standard_outputs import fix_of
from .start_ports import StartPorts, inputs_of
from .state_store import StateStore
from .topics import (
    BROADCAST,
    CLOCK_STEP,
    COMMAND,
    FIX,
    HEALTH,
    IMU,
    ODOMETRY,
    RECEIPT,
    RESTORE,
    STATE,
    TX,
)

_PACKETS = (BROADCAST, TX)
"""Of a leader: what its followers steer by."""
LISTENER_WAIT_S = 2.0
"""Longest wait of a restarted node for a recorder of its restore [s]."""


class NavigationPorts:
    """Connects a session to the topics and services of its node.

    Parameters
    ----------
    node : PolarNode
        The node; its namespace is the vehicle.
    session : NavigationSession
        What navigates.
    inputs, outputs : mapping of str to message type
        Topics of the vehicle's own.
    store : StateStore, optional
        Saves the state, and has that of before a restart.
    sources : SourcePorts, optional
        Subscriptions of a mapping file, in place of topics of the same name.
    live : LiveOutputs, optional
        Outputs at the newest IMU sample.
    stated : Stated, optional
        What the user stated of the initial state.
    """

    def __init__(
        self,
        node: PolarNode[Any],
        session: NavigationSession[Any],
        inputs: Mapping[str, type[Any]],
        outputs: Mapping[str, type[Any]],
        store: StateStore | None = None,
        sources: SourcePorts | None = None,
        live: LiveOutputs | None = None,
        stated: Stated | None = None,
    ) -> None:
        self._node = node
        self._session = session
        self._sources = sources
        self._live = live
        self._silent = False
        published = {
            STATE: NavState,
            RECEIPT: FixReceipt,
            HEALTH: NavHealth,
            CLOCK_STEP: TimeReference,
            **outputs,
        }
        if session.with_model:
            published |= MODEL_OUTPUTS
        self._outputs: dict[str, CountedPublisher] = {
            topic: node.advertise(kind, topic) for topic, kind in published.items()
        }
        self._commands = node.advertise(CommandMsg, COMMAND)
        self._store = store
        self._odometry = node.advertise(Odometry, ODOMETRY)
        self._fix = node.advertise(NavSatFix, FIX)
        # In lockstep a node that dies ends the run.
        session.marks_starts = store is not None or not session.params.lockstep
        if store is not None:
            self._restores = node.advertise(RestoreMsg, RESTORE)
        self._command_count = 0
        self._imu_seen: tuple[int | None, float] = (None, time.monotonic())
        self._fix_second = -1
        self._own_topics = [
            node.resolve_topic_name(topic)
            for topic in session.sensors
            if sources is None or not sources.has(topic)
        ]
        fixes = sources is None or sources.fixes
        headings = sources is not None and sources.headings
        self._start = StartPorts(
            node,
            session,
            stated or Stated(),
            inputs_of(session, fixes=fixes, headings=headings),
            lambda state: self._command(CommandKind.SET_INITIAL_STATE, initial_to_msg(state)),
            lambda: ('', None) if live is None else (live.map, live.frame),
            None if sources is None else sources.start,
        )
        imu, *others = session.sensors
        for topic, kind in {**{t: SENSORS[t] for t in others}, **inputs}.items():
            self._subscribe(kind, topic)
        for topic in () if sources is None else sources.beside:
            self._subscribe(None, topic)
        # IMU samples move time on: what else has come is taken before.
        self._subscribe(SENSORS[imu], imu, after_others=True, live=live)
        node.create_service(Trigger, '~/reset', self._on_reset)
        node.create_service(SetInitialState, '~/set_initial_state', self._on_set_initial_state)
        if session.with_model:
            node.create_service(Trigger, '~/identify', self._on_identify)
        add_switches(node, (*others, *inputs, *(sources.beside if sources else ())), self._switch)
        if live is not None:
            add_map_services(node, lambda: live.frame, live.map)
        node.get_logger().info(
            f'configuration {session.params.configuration}, {session.engine.configuration.doc}'
        )
        self._health = NavigationHealth(session.engine, node.get_logger())
        if store is not None and store.has_state:
            # A recorder that runs finds a restarted node within a second; without the restore
            # its bag cannot be replayed. Sensors wait in their queues meanwhile.
            self._restores.wait_for_subscription(LISTENER_WAIT_S)

    def _subscribe(
        self,
        kind: Any,  # noqa: ANN401 - a message type
        topic: str,
        *,
        after_others: bool = False,
        live: LiveOutputs | None = None,
    ) -> None:
        """Subscribe to a topic of the session, or to the source that stands for it."""
        take, then = self._taker(topic), None
        if live is not None:
            take, then = live.following(take), live.publish
        if self._sources is not None and self._sources.has(topic):
            self._sources.subscribe(topic, take, after_others=after_others, then=then)
        elif topic == IMU:

            def take_bytes(data: bytes) -> None:
                try:
                    row = ImuRow.of(data)
                except ValueError as error:  # of anybody on the network
                    self._node.get_logger().error(f'{topic}: {error}', throttle_duration_sec=10.0)
                    return
                take(row)

            self._node.subscribe(
                kind, topic, take_bytes, raw=True, after_others=after_others, then=then
            )
        else:
            self._node.subscribe(kind, topic, take, after_others=after_others, then=then)

    def silence(self, silent: bool) -> None:
        """Silence what others steer by, or let it be heard: odometry, packets, `LiveOutputs`.

        The record (nav/state, receipts, commands, health) goes on, so that it can be verified.
        """
        self._silent = silent
        if self._live is not None:
            self._live.silent = silent

    def diagnose(self) -> Diagnosis:
        """Health with verdict counts, ages and the number of waiting events."""
        waits_for = self._start.waits_for
        if self._sources is not None:
            self._sources.health.look()
            self._session.beside = self._sources.health.conditions
        self._publish(self._session.silence(self._silent_s(), waits_for))
        self._start.publish()
        waiting: dict[str, object] = {'waiting': self._session.reorder.pending}
        if self._store is not None:
            waiting['saved_state'] = self._store.status
        lost, behind_s = self._node.lost_counts(), self._node.backlog.behind_s
        values = {**waiting, **self._node.taken_counts()}
        values |= {f'lost {topic}': count for topic, count in lost.items()}
        if self._sources is not None:
            self._sources.flush()
        found = self._health.diagnose(
            values, behind_s=behind_s, lost=sum(lost.values()), waits_for=waits_for
        )
        if self._sources is not None:
            found = self._sources.health.diagnosed(found)
        beside = [] if self._store is None else [self._store.problem]
        beside += [self._node.doubled(name) for name in self._own_topics]
        return found.beside(*beside)

    def _silent_s(self) -> float:
        """Time since IMU samples that are used stopped, by the computer's clock; 0 in lockstep."""
        imu_ns, now_s = self._session.engine.last_imu_ns, time.monotonic()
        if imu_ns != self._imu_seen[0] or self._session.params.lockstep:
            self._imu_seen = imu_ns, now_s
        return now_s - self._imu_seen[1]

    def close(self) -> None:
        """Process waiting events, and publish the end of the run as a SHUTDOWN command."""
        self._publish(self._session.flush())
        if self._sources is not None:
            self._sources.flush()
        if self._store is not None:
            self._store.save(self._session.engine)
        stamp_ns = self._session.reorder.newest_imu_ns
        if stamp_ns is not None:
            taken = self._node.taken_counts()
            message = CommandMsg(
                kind=CommandMsg.SHUTDOWN,
                taken_topics=list(taken),
                taken_counts=list(taken.values()),
            )
            self._send(message, stamp_ns)

    def _taker(self, topic: str) -> Callable[[Any], None]:
        if topic != self._session.sensors[0]:
            return lambda message: self._publish(
                self._session.take(topic, message, self._arrival_ns())
            )
        store = self._store

        def take(message: Any) -> None:  # noqa: ANN401 - the topic's message type
            self._publish(self._session.take(topic, message, self._arrival_ns()))
            self._start.follow()
            if store is None:
                return
            start_ns = self._session.reorder.start_ns
            newest_ns = self._session.reorder.newest_imu_ns
            if start_ns is not None and newest_ns is not None:
                # At the first sample: nothing is published of the state that parameters name.
                self._restore(store, start_ns)
                store.save_if_due(self._session.engine, newest_ns)

        return take

    def _arrival_ns(self) -> int | None:
        """Present time by the steady clock; None in lockstep, where it says nothing of stamps."""
        return None if self._session.params.lockstep else time.monotonic_ns()

    def _restore(self, store: StateStore, stamp_ns: int) -> None:
        """Go on from the saved state, if there is one that fits, as a stamped event."""
        saved = store.take(self._session.params, stamp_ns)
        if saved is not None:
            message = RestoreMsg(data=array('B', pack(saved)))
            message.header.stamp = to_msg(stamp_ns)
            message.saved_time = to_msg(saved.stamp_ns)
            self._restores.publish(message)
            self._publish(self._session.take(RESTORE, message))
            self._start.over('saved state', f'{saved.away_s(stamp_ns):.1f} s old')

    def _publish(self, published: Iterable[Published]) -> None:
        for topic, message, data in published:
            if self._silent and topic in _PACKETS:
                continue
            if self._sources is not None:
                # What an output is made of is published before it: of a node that is killed,
                # everything that it published can be reproduced.
                self._sources.flush()
            self._outputs[topic].publish(data)
            if topic == STATE:
                self._publish_standard(message)

    def _publish_standard(self, state: NavState) -> None:
        """Publish the estimate as standard messages too: odometry, and a NavSatFix at 1 Hz."""
        if self._silent:
            return
        self._odometry.publish(self._session.odometry(state))
        if state.header.stamp.sec != self._fix_second:
            self._fix_second = state.header.stamp.sec
            self._fix.publish(fix_of(self._session.in_vehicle_time(state)))

    def _send(self, message: CommandMsg, stamp_ns: int) -> None:
        message.header.stamp = to_msg(stamp_ns)
        message.sequence = self._command_count
        self._command_count += 1
        self._commands.publish(message)

    def _switch(self, topic: str, on: bool) -> str:
        """Switch a sensor off or on as a stamped event; returns an error sentence or nothing."""
        kind = CommandKind.SENSOR_ON if on else CommandKind.SENSOR_OFF
        return self._command(kind, InitialStateMsg(), topic)

    def _command(self, kind: CommandKind, initial: InitialStateMsg, sensor: str = '') -> str:
        """Process a service call as a stamped event; returns an error sentence or nothing."""
        stamp_ns = self._session.reorder.newest_imu_ns
        if stamp_ns is None:
            return (
                'there was no IMU sample yet, so the command has no place in the order of events'
            )
        message = CommandMsg(kind=int(kind), initial_state=initial)
        if sensor:
            message.taken_topics = [sensor]
            message.taken_counts = [self._session.taken[sensor]]
        self._send(message, stamp_ns)
        self._publish(self._session.take(COMMAND, message))
        return ''

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        initial = self._session.params.initial_state()
        message = InitialStateMsg() if initial is None else initial_to_msg(initial)
        response.message = self._command(CommandKind.RESET, message)
        if not response.message:
            self._start.again()
        response.success = not response.message
        return response

    def _on_identify(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Process the request as a stamped event; nav/identification publishes the result."""
        response.message = self._command(CommandKind.IDENTIFY, InitialStateMsg())
        response.success = not response.message
        return response

    def _on_set_initial_state(
        self, request: SetInitialState.Request, response: SetInitialState.Response
    ) -> SetInitialState.Response:
        initial = initial_from_msg(request.initial_state)
        if initial is None:
            sigma = request.initial_state.sigma_position_horizontal
            response.message = f'sigma_position_horizontal is {sigma}: it must be positive'
        elif to_ns(request.initial_state.header.stamp):
            response.message = (
                'header.stamp must be zero: the state is taken to hold with the next IMU sample'
            )
        else:
            response.message = initial_problem(initial) or self._command(
                CommandKind.SET_INITIAL_STATE, request.initial_state
            )
            if not response.message:
                self._start.over('service')
        response.success = not response.message
        return response
