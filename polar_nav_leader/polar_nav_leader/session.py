"""Sessions of the leader: messages in, messages to publish out.

The leader's position comes from another node's odometry (:class:`OdometrySession`) or its own
navigation (:class:`OwnSession`); broadcasts are made in the same way from either.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from nav_msgs.msg import Odometry

from polar_nav_core.engine.events import ClockStep
from polar_nav_core.engine.outputs import Estimate, Output
from polar_nav_msgs.msg import NavState
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Sources
from polar_nav_ros.broadcasts import broadcast_to_msg
from polar_nav_ros.navigation_session import NavigationSession, Published, Reader
from polar_nav_ros.stamps import to_ns
from polar_nav_ros.standard_outputs import odometry_of

from . import convert
from .broadcast import ArrayMeasurement
from .leader import Leader
from .navigation import LeaderEngine, state_of
from .params import LeaderParams
from .states import LeaderState


class _Sender:
    """Packets of a leader as messages, numbered by the modem."""

    def __init__(self, leader: Leader, params: LeaderParams, vehicle: str) -> None:
        self._leader = leader
        self._p = params
        self._vehicle = vehicle
        self._sequence = 0

    def due(self, now_ns: int | None = None) -> Iterator[Published]:
        target = self._p.follower
        for packet in self._leader.due(now_ns):
            content = broadcast_to_msg(packet.broadcast, self._vehicle, target)
            yield Published.of(topics.BROADCAST, content)
            message = convert.packet_to_msg(
                packet.data,
                self._vehicle,
                target,
                self._sequence,
                packet.transmit_ns,
                self._p.bit_rate,
            )
            self._sequence += 1
            yield Published.of(topics.TX, message)


class OdometrySession:
    """Session of a leader with the odometry of another node.

    Parameters
    ----------
    params : LeaderParams
        Parameters of leader_node.
    vehicle : str
        Name of the vehicle.
    """

    def __init__(self, params: LeaderParams, vehicle: str) -> None:
        self.leader = Leader(params)
        self._params = params
        self._sender = _Sender(self.leader, params, vehicle)

    def take(self, topic: str, message: Any) -> Iterator[Published]:  # noqa: ANN401 - the topic's message type
        """Process a message of ODOMETRY or USBL; yields messages to publish."""
        if topic == topics.USBL:
            self.leader.add_measurement(convert.measurement_from_msg(message))
        else:
            self.leader.add_state(convert.state_from_msg(message, self._params))
        yield from self._sender.due()


class OwnSession(NavigationSession[LeaderParams]):
    """Session of a leader that navigates with its own sensors and absolute fixes, if any.

    Parameters
    ----------
    params : LeaderParams
        Parameters of leader_node.
    vehicle : str
        Name of the vehicle.
    sources : Sources, optional
        Those of a mapping file, in place of this project's own topics; bound to their types.
    """

    def __init__(self, params: LeaderParams, vehicle: str, sources: Sources | None = None) -> None:
        lever_b = sources.imu_lever_b if sources else (0.0, 0.0, 0.0)
        self._rates = LeaderEngine(params, lever_b)
        readers: dict[str, Reader] = {topics.ABSOLUTE: convert.absolute_fix_from_msg}
        sensors: tuple[str, ...] = (topics.IMU, topics.DVL, topics.DEPTH)
        if sources is not None:
            readers |= {source.topic: source.event for source in sources}
            sensors = sources.sensors(sensors)
        super().__init__(params, vehicle, readers, engine=self._rates, sensors=sensors)
        self.leader = Leader(params)
        self._sender = _Sender(self.leader, params, vehicle)
        self._state: LeaderState | None = None
        self._restarts = 0

    def take(
        self,
        topic: str,
        message: Any,  # noqa: ANN401 - the topic's message type
        arrival_ns: int | None = None,
    ) -> Iterator[Published]:
        """Process one message; yields estimates, receipts and packets to publish."""
        if topic == topics.USBL:
            measurement = convert.measurement_from_msg(message)
            self.leader.add_measurement(self._in_engine_time(measurement))
        else:
            yield from super().take(topic, message, arrival_ns)
        yield from self._sender.due(self.reorder.newest_imu_ns)

    def flush(self) -> Iterator[Published]:
        """Process the waiting messages at the end of the run."""
        yield from super().flush()
        yield from self._sender.due(self.reorder.newest_imu_ns)

    def _in_engine_time(self, measurement: ArrayMeasurement) -> ArrayMeasurement:
        """A measurement with stamps of the engine's time, after the vehicle's clock stepped."""
        now_ns = self.reorder.newest_imu_ns
        offset_ns = self.engine.clock.nearest_offset_ns(measurement.return_ns, now_ns)
        if not offset_ns:
            return measurement
        return replace(
            measurement,
            ping_ns=measurement.ping_ns + offset_ns,
            validity_ns=measurement.validity_ns + offset_ns,
            return_ns=measurement.return_ns + offset_ns,
        )

    def odometry(self, state: NavState) -> Odometry:
        """nav_msgs/Odometry of the newest state, with its rate, by the vehicle's clock."""
        newest = self._state
        current = newest is not None and newest.stamp_ns == to_ns(state.header.stamp)
        state = self.in_vehicle_time(state)
        return odometry_of(state, newest.omega_eb_b if newest is not None and current else None)

    def _to_messages(self, results: Iterable[Output | ClockStep]) -> Iterator[Published]:
        for result in results:
            if isinstance(result, Estimate):
                self._keep(result)
            yield from super()._to_messages((result,))

    def _keep(self, estimate: Estimate) -> None:
        if self._rates.restarts != self._restarts:
            self._restarts = self._rates.restarts
            self.leader.restart()
        self._state = state_of(estimate, self._rates.omega_ib_b())
        self.leader.add_state(self._state)
