"""Navigation of one vehicle without a node: messages of its topics in, messages out.

Driven by a node (:meth:`take` as messages come) or by a replay, which collects :meth:`event_of` of
a whole bag, sorts, and calls :meth:`process`. Both use the same engine, so that they publish the
same bytes. A vehicle adds its own kind of position fix by a reader of its topic.

Where the vehicle's model takes part, the first estimate of each second is followed by what is
estimated of the model and of the water.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ClockStep, Event, number_of, shifted
from polar_nav_core.engine.health.conditions import Condition
from polar_nav_core.engine.health.radius import radius_95
from polar_nav_core.engine.outputs import Estimate, Output, Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.identification.result import Identification
from polar_nav_msgs.msg import Depth, Dvl, NavState, VehicleModel, WaterCurrent
from polar_nav_msgs.msg import Identification as IdentificationMsg

from . import model_outputs
from . import navigation_outputs as outputs
from .adapters.live import Taken
from .cdr import to_bytes
from .health_message import SILENT_S, health_to_msg
from .readers import (
    ImuRow,
    ahrs_from_msg,
    command_from_msg,
    control_from_msg,
    depth_from_msg,
    dvl_from_msg,
    imu_from_msg,
    restore_from_msg,
)
from .stamps import NS, to_msg, to_ns
from .standard_outputs import odometry_of
from .topics import (
    AHRS,
    CLOCK_STEP,
    COMMAND,
    CONTROL,
    CURRENT,
    DEPTH,
    DVL,
    HEALTH,
    IDENTIFICATION,
    IMU,
    MODEL,
    RECEIPT,
    RESTORE,
    STATE,
)

SENSORS: dict[str, type[Any]] = {
    IMU: Imu,
    AHRS: Imu,
    CONTROL: WrenchStamped,
    DEPTH: Depth,
    DVL: Dvl,
}
"""Topics of a vehicle's own sensors and actuators; each session subscribes to some of them."""
MODEL_OUTPUTS: dict[str, type[Any]] = {
    CURRENT: WaterCurrent,
    MODEL: VehicleModel,
    IDENTIFICATION: IdentificationMsg,
}
"""Topics published in addition where the vehicle's model is used."""

P = TypeVar('P', bound=EngineParams)
Reader: TypeAlias = Callable[[Any, int], Event | None]
"""Converts a message and its number on its topic to an event; None where it holds nothing."""


class Published(NamedTuple):
    """A message to publish: topic, message, and bytes that depend on its content only."""

    topic: str
    message: Any
    data: bytes

    @classmethod
    def of(cls, topic: str, message: Any) -> Published:  # noqa: ANN401 - the topic's message type
        """Serialize a message for a topic."""
        return cls(topic, message, to_bytes(message))


class NavigationSession(Generic[P]):
    """An engine with readers for its input topics and messages for its outputs.

    Parameters
    ----------
    params : EngineParams
        Everything that can be chosen.
    vehicle : str
        Name of the vehicle, for frame ids.
    readers : mapping of str to callable
        Topics of the vehicle's own, beside `SENSORS` and commands.
    engine : Engine, optional
        One made already.
    imu_lever_b : sequence of float
        IMU from base_link, body axes [m]; not with ``engine``.
    frame_id : str
        Of positions.
    sensors : sequence of str
        Those of `SENSORS` that it takes; the first one is the IMU.

    Attributes
    ----------
    marks_starts : bool
        Publish on nav/clock the first message that is taken of each topic: a node that may be
        started again in the middle of a recording, so that a replay begins with the same ones.
    hear : callable or None
        Gets each event of a live message: an alignment listens. No replay has one.
    beside : tuple of Condition
        What its node knows of the sources, for nav/health. No replay has any.
    """

    def __init__(
        self,
        params: P,
        vehicle: str,
        readers: Mapping[str, Reader],
        *,
        engine: Engine | None = None,
        imu_lever_b: Sequence[float] = (0.0, 0.0, 0.0),
        frame_id: str = 'earth',
        sensors: Sequence[str] = (IMU, DVL, DEPTH),
    ) -> None:
        self.params = params
        self.vehicle = vehicle
        self.engine = engine or Engine(params, imu_lever_b=imu_lever_b)
        self.reorder = Reorder(self.engine, params.reorder_window_s, params.max_stamp_leap_s)
        self.taken: Counter[str] = Counter()
        self.marks_starts = False
        self.hear: Callable[[Event], None] | None = None
        self.beside: tuple[Condition, ...] = ()
        self._starts: list[Published] = []
        self.sensors = tuple(sensors)
        self._frame_id = frame_id
        self._model_second = -1
        self._health_second = -1
        self._readers: dict[str, Reader] = {
            IMU: imu_from_msg,
            AHRS: ahrs_from_msg,
            CONTROL: control_from_msg,
            DVL: lambda m, n: dvl_from_msg(m, n, params.dvl_sigma, params.water_sound_speed),
            DEPTH: lambda m, n: depth_from_msg(m, n, params.depth_sigma),
            COMMAND: command_from_msg,
            RESTORE: restore_from_msg,
            **readers,
        }

    @property
    def with_model(self) -> bool:
        """Whether the vehicle's model is used, which needs the thrust."""
        return CONTROL in self.sensors

    def event_of(self, topic: str, message: Any) -> Event | None:  # noqa: ANN401 - of the topic
        """Event of a message, numbered on its topic; None where it holds nothing."""
        number = self.taken[topic]
        self.taken[topic] += 1
        return self._readers[topic](message, number)

    def take(
        self,
        topic: str,
        message: Any,  # noqa: ANN401 - the topic's message type
        arrival_ns: int | None = None,
    ) -> Iterator[Published]:
        """Process one live message; yields the messages to publish.

        ``arrival_ns`` is when it came by a steady clock; None where that means nothing.
        """
        if self.marks_starts and not self.taken[topic] and topic not in (COMMAND, RESTORE):
            yield from self._start_of(topic, message)
        event = self.event_of(topic, message)
        yield from self._before_event()
        if event is not None:
            if self.hear is not None:
                self.hear(event)
            yield from self._to_messages(self.reorder.add(event, arrival_ns))

    def _start_of(self, topic: str, message: Any) -> Iterator[Published]:  # noqa: ANN401
        """Record of the first message of a topic; those of all topics follow the IMU's."""
        stamped = isinstance(message, Taken | ImuRow)
        stamp_ns = message.stamp_ns if stamped else to_ns(message.header.stamp)
        step = outputs.clock_step_to_msg(ClockStep(topic, 0, stamp_ns, stamp_ns))
        self._starts.append(Published.of(CLOCK_STEP, step))
        if topic == self.sensors[0]:
            self._starts.insert(0, self._starts.pop())
        elif not self.taken[self.sensors[0]]:
            return
        yield from self._starts
        self._starts.clear()

    def recorded_event_of(self, topic: str, message: Any) -> Event | None:  # noqa: ANN401
        """Event of a message in the engine's time, by the steps of its topic's clock (replay)."""
        event = self.event_of(topic, message)
        if event is None:
            return None
        return shifted(event, self.engine.clock.offset_ns(topic, number_of(event)))

    def process(self, event: Event) -> Iterator[Published]:
        """Process the next event of the total order (replay); yields the messages to publish."""
        yield from self._to_messages(self.engine.process(event))

    def advance(self, stamp_ns: int) -> Iterator[Published]:
        """Yield the messages due before a stamp [ns]: no earlier event may follow (replay)."""
        yield from self._to_messages(self.engine.advance(stamp_ns))

    def refuse(self, receipt: Receipt) -> Published:
        """Receipt of a message that a live run refused, published again (replay)."""
        self.engine.verdicts[receipt.verdict] += 1
        return Published.of(RECEIPT, outputs.receipt_to_msg(receipt))

    def flush(self) -> Iterator[Published]:
        """Process all waiting events at the end of a run; yields the messages to publish."""
        yield from self._to_messages(self.reorder.flush())

    def odometry(self, state: NavState) -> Odometry:
        """nav_msgs/Odometry of the newest state, stamped by the vehicle's clock."""
        return odometry_of(self.in_vehicle_time(state))

    def in_vehicle_time(self, state: NavState) -> NavState:
        """A state with the stamp of the IMU's clock, which the rest of the vehicle has."""
        stamp_ns = to_ns(state.header.stamp)
        own_ns = self.engine.clock.own_ns(stamp_ns)
        if own_ns == stamp_ns:
            return state
        moved = copy.copy(state)
        moved.header = Header(stamp=to_msg(own_ns), frame_id=state.header.frame_id)
        return moved

    def _before_event(self) -> Iterator[Published]:
        """Messages of a vehicle's own readers that precede the results of the event."""
        yield from ()

    def _to_messages(self, results: Iterable[Output | ClockStep]) -> Iterator[Published]:
        for result in results:
            if isinstance(result, Receipt):
                yield Published.of(RECEIPT, outputs.receipt_to_msg(result))
            elif isinstance(result, Estimate):
                message = outputs.nav_to_msg(result, self.params, self.vehicle, self._frame_id)
                yield Published.of(STATE, message)
                yield from self._health(result.stamp_ns, message)
                yield from self._model(result)
            elif isinstance(result, Identification):
                message = model_outputs.identification_to_msg(result)
                yield Published.of(IDENTIFICATION, message)
            elif isinstance(result, ClockStep):
                yield Published.of(CLOCK_STEP, outputs.clock_step_to_msg(result))

    def _health(self, stamp_ns: int, state: NavState) -> Iterator[Published]:
        """Message with the health, once per second of stamp time; covariance as published."""
        if stamp_ns // NS == self._health_second:
            return
        self._health_second = stamp_ns // NS
        radius = radius_95(np.reshape(state.position_covariance_g, (3, 3))[:2, :2])
        message = health_to_msg(self.engine, stamp_ns, radius, stamp_ns, beside=self.beside)
        yield Published.of(HEALTH, message)

    def silence(self, silent_s: float, waits_for: str = '') -> Iterator[Published]:
        """Message with the health at a time without estimates, once there was an IMU sample.

        Parameters
        ----------
        silent_s : float
            Since the newest IMU sample came, by the computer's clock [s]: clocks need not agree.
        waits_for : str
            What a start that is not complete waits for.
        """
        imu_ns = self.engine.last_imu_ns
        if imu_ns is not None and (silent_s > SILENT_S or not self.engine.navigating):
            now_ns = imu_ns + round(silent_s * NS)
            message = health_to_msg(self.engine, now_ns, math.nan, imu_ns, waits_for, self.beside)
            yield Published.of(HEALTH, message)

    def _model(self, e: Estimate) -> Iterator[Published]:
        """Messages with model and current, once per second of stamp time."""
        if e.model is None or e.stamp_ns // NS == self._model_second:
            return
        self._model_second = e.stamp_ns // NS
        yield Published.of(CURRENT, model_outputs.current_to_msg(e.model, e.stamp_ns))
        yield Published.of(MODEL, model_outputs.model_to_msg(e.model, e.stamp_ns))
