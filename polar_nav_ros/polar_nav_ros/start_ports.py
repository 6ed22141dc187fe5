"""Start of a navigating node: its alignment, poses from a map, and the topic nav/start.

What the filter starts from is, in this order: ``~/set_initial_state`` or a pose, a saved state
that is young enough, stated parameters, an alignment. An alignment's state, like a service's,
becomes a command on nav/command, so that a replay starts from the same one.

| topic | type | stamp |
| --- | --- | --- |
| in set_pose, initialpose | geometry_msgs/PoseWithCovarianceStamped | not used: it holds at once |
| out nav/start | diagnostic_msgs/DiagnosticArray, latched | newest IMU sample |
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.subscription import Subscription

from polar_nav_core.engine.events import Event, InitialState
from polar_nav_core.engine.start.machine import Start
from polar_nav_core.engine.start.model import Aligned, Phase, Stated
from polar_nav_core.errors import ConfigError
from polar_nav_core.local_frame import LocalFrame

from .adapters.pose import Pose, PoseError, pose_in_earth
from .adapters.start_topic import StartTopic
from .diagnostics import Diagnosis, Level, without_numbers
from .health_message import status_of
from .navigation_session import NavigationSession
from .node import PolarNode
from .qos import BEST_EFFORT, LATCHED_QOS
from .stamps import to_msg
from .topics import AHRS, DEPTH, DVL, START

POSE_TOPICS = ('set_pose', 'initialpose')
_QUEUE = 10
_ORIGINS = {
    'parameters': 'as stated by parameters',
    'alignment': 'aligned',
    'service': 'set by ~/set_initial_state',
    'pose': 'set by a pose',
    'saved state': 'restored from the saved state',
}


class StartPorts:
    """Finds or takes the state that a session starts from, and publishes how far it is.

    Parameters
    ----------
    node : PolarNode
    session : NavigationSession
    stated : Stated
        What the user stated of the initial state.
    inputs : frozenset of str
        What there are sources of: ``fix``, ``dvl``, ``depth``, ``heading``.
    send : callable
        Sends a state as a command; returns an error sentence or nothing.
    local : callable
        The map frame with its name; None of a frame that has no origin yet.
    topic : StartTopic and its message class, optional
        Its newest message states the start while it is aligned.
    """

    def __init__(
        self,
        node: PolarNode[Any],
        session: NavigationSession[Any],
        stated: Stated,
        inputs: frozenset[str],
        send: Callable[[InitialState], str],
        local: Callable[[], tuple[str, LocalFrame | None]],
        topic: tuple[StartTopic, type[Any]] | None = None,
    ) -> None:
        self._node, self._session = node, session
        self._stated, self._inputs = stated, inputs
        self._send, self._local = send, local
        self._position = topic
        self._listening: Subscription[Any] | None = None
        if topic is not None:
            self._inputs = inputs | {'position'}
        self._found: Aligned | None = None
        self._start: Start | None = None
        self._how = ''
        self._refused = ''
        self._origin = ''
        self._published: tuple[str, str, str] | None = None
        self._logged = ''
        # Not counted: in lockstep nobody waits for readers of what is latched.
        self._topic = node.create_publisher(DiagnosticArray, START, LATCHED_QOS)
        for name in POSE_TOPICS:
            node.create_subscription(PoseWithCovarianceStamped, name, self._on_pose, _QUEUE)
        self.again()

    def again(self) -> None:
        """Start as at first: after a reset."""
        kind = self._session.params.initialize
        self._found, self._how = None, ''
        self._start = self._machine(self._stated) if kind == 'alignment' else None
        self._origin = 'parameters' if kind in ('auto', 'parameters') else ''
        self._session.hear = self._hear if self._start is not None else None
        if self._start is not None and self._position is not None and self._listening is None:
            start, kind = self._position
            # Best effort hears every publisher, reliable ones too.
            self._listening = self._node.create_subscription(
                kind, start.stream.topic, self._on_position, BEST_EFFORT
            )

    def _on_position(self, message: Any) -> None:  # noqa: ANN401 - of the mapping's type
        """State the start as the newest message of the topic has it."""
        if self._start is None or self._position is None:
            return
        arrival_ns = self._node.get_clock().now().nanoseconds
        try:
            found = self._position[0].stated(message, arrival_ns, self._stated)
        except ConfigError as error:
            self._refused = str(error)
            return
        if found is not None:
            self._start.restate(found)

    def _machine(self, stated: Stated) -> Start:
        return Start(self._session.params, stated, self._inputs)

    def over(self, origin: str, how: str = '') -> None:
        """Note where the state comes from, and end an alignment."""
        self._start = self._session.hear = None
        if self._listening is not None:
            self._node.destroy_subscription(self._listening)
            self._listening = None
        self._origin, self._how = origin, how
        self._node.get_logger().info(f'start: {_ORIGINS[origin]}{": " if how else ""}{how}')
        self.publish()

    def _hear(self, event: Event) -> None:
        if self._start is not None and self._found is None:
            self._found = self._start.take(event)

    def follow(self) -> None:
        """Send the state that the last message completed, if it did."""
        found, self._found = self._found, None
        if found is None or self._start is None:
            return
        origin = 'alignment' if self._origin != 'pose' else 'pose'
        problem = self._send(found.state)
        if problem:
            self._refused = problem
        else:
            self.over(origin, found.sentence)

    @property
    def waits_for(self) -> str:
        """Sentence on what a node without a state waits for; empty with a state."""
        if self._session.engine.navigating:
            return ''
        if self._start is not None:
            return self._start.progress.sentence
        if self._origin and self._session.reorder.newest_imu_ns is not None:
            return 'the state holds with the next IMU sample'
        if self._origin:
            return 'waiting for: IMU samples'
        return 'waiting for: ~/set_initial_state, or a pose on set_pose or initialpose'

    def publish(self) -> None:
        """Publish state and origin on nav/start, if they changed."""
        engine = self._session.engine
        state, level = self._state()
        sentence = self.waits_for or f'{_ORIGINS[self._origin or "service"]}'
        if self._how and engine.navigating:
            sentence = f'{sentence}: {self._how}'
        if self._refused:
            sentence = f'{sentence}; refused: {self._refused}'
        new = (state, self._origin, sentence)
        if new == self._published:
            return
        self._published = new
        shape = without_numbers(self.waits_for)
        if shape and shape != self._logged:
            self._node.get_logger().info(self.waits_for)
        self._logged = shape
        values = {'state': state, 'origin': self._origin or 'none'}
        message = Diagnosis(level, sentence, values).to_msg(
            f'{self._node.get_fully_qualified_name()}: start', self._session.vehicle
        )
        message.header.stamp = to_msg(self._session.reorder.newest_imu_ns or 0)
        self._topic.publish(message)

    def _state(self) -> tuple[str, Level]:
        """Name of the state, and its level: waiting, aligning, navigating, degraded, lost."""
        engine = self._session.engine
        if engine.navigating or engine.divergence:
            return status_of(engine, self._session.beside)
        aligning = self._start is not None and self._start.progress.phase is not Phase.WAITING
        return 'aligning' if aligning else 'waiting', Level.WARN

    # -- poses ------------------------------------------------------------------------------------

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        """Start from a pose, or move to it: what its covariance leaves open stays or is found."""
        try:
            pose = pose_in_earth(message, *self._local())
        except PoseError as error:
            self._refused = f'pose in {message.header.frame_id!r}: {error}'
            self._node.get_logger().warning(self._refused)
            self.publish()
            return
        self._refused = ''
        now = self._session.engine.state()
        if now is None:
            self._origin = 'pose'
            self._start = self._machine(_with_pose(self._stated, pose))
            self._session.hear = self._hear
            return
        problem = self._send(_moved(now, pose))
        if problem:
            self._refused = problem
        else:
            self.over('pose', 'as it navigated')


def _with_pose(stated: Stated, pose: Pose) -> Stated:
    """What is stated, with a pose in place of it."""
    found = replace(
        stated,
        latitude=pose.latitude,
        longitude=pose.longitude,
        heading=pose.grid_heading,
        heading_reference='grid',
        sigma_position=pose.sigma_position,
        sigma_heading=pose.sigma_heading,
    )
    if pose.sigma_height is not None:
        found = replace(found, height=pose.height, sigma_height=pose.sigma_height)
    if pose.sigma_tilt is not None:
        found = replace(found, roll=pose.roll, pitch=pose.pitch, sigma_tilt=pose.sigma_tilt)
    return found


def _moved(now: InitialState, pose: Pose) -> InitialState:
    """A state moved to a pose; its velocity turns with the heading."""
    turn = now.grid_heading - pose.grid_heading
    c, s = math.cos(turn), math.sin(turn)
    x, y, z = now.v_G
    height = (now.height, now.sigma_position_vertical)
    if pose.sigma_height is not None:
        height = (pose.height, pose.sigma_height)
    tilt = (now.roll, now.pitch, now.sigma_tilt)
    if pose.sigma_tilt is not None:
        tilt = (pose.roll, pose.pitch, pose.sigma_tilt)
    speed = math.hypot(x, y)
    return InitialState(
        latitude=pose.latitude,
        longitude=pose.longitude,
        height=height[0],
        v_G=(c * x - s * y, s * x + c * y, z),
        roll=tilt[0],
        pitch=tilt[1],
        grid_heading=pose.grid_heading,
        sigma_position_horizontal=pose.sigma_position,
        sigma_position_vertical=height[1],
        sigma_velocity=math.hypot(now.sigma_velocity, speed * pose.sigma_heading),
        sigma_tilt=tilt[2],
        sigma_heading=pose.sigma_heading,
    )


def inputs_of(session: NavigationSession[Any], *, fixes: bool, headings: bool) -> frozenset[str]:
    """What a session has sources of, for a start.

    Parameters
    ----------
    session : NavigationSession
    fixes : bool
        Whether positions come, not ranges and bearings of a station.
    headings : bool
        Whether a source measures the heading.
    """
    station = AHRS in session.sensors
    there = {
        'dvl': DVL in session.sensors,
        'depth': DEPTH in session.sensors,
        'fix': fixes and not station,
        'heading': headings or station,
    }
    return frozenset(name for name, is_there in there.items() if is_there)
