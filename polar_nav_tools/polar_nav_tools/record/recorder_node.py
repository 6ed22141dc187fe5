"""Node that records topics to a bag: serialized bytes as they arrive, not decoded.

Subscribes to the topics it is given or to all it finds, and takes part in the lockstep pace. Every
turn of the executor empties all subscriptions at once (a turn costs more than taking a message),
then files the burst and acknowledges it once. What it does with messages stands in `recording`.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from polar_nav_core.errors import ConfigError
from polar_nav_ros.backlog import informed
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.node import PolarNode
from polar_nav_ros.process import run
from polar_nav_ros.qos import DATA_QOS, QUEUE_DEPTH
from polar_nav_ros.topics import DIAGNOSTICS, KEPT, RUN_INFO, START

from ..bags.errors import BagError
from ..bags.qos import Qos, request_for
from ..bags.resuming import require_own
from ..bags.writer import BagWriter
from .params import RecorderParams, parse_run_info, parse_topics
from .recording import Recording, Rotation

# Published by every node beside what it counts, so a count of them would never be met.
UNCOUNTED = (DIAGNOSTICS, RUN_INFO, '/rosout', '/parameter_events')
_OWN = {DIAGNOSTICS, RUN_INFO}
"""What is found where nobody else publishes."""
_PATIENCE = 5
"""Diagnoses, one a second, in which nothing is found, before it is said."""
_LATCHED = (
    RUN_INFO,
    '/tf_static',
    '/robot_description',
    *(f'/{topic}' for topic in (*KEPT, START)),
)
"""Ends of topics whose publishers keep what they said. A node that is started again says at once
what a replay cannot do without, and a busy recorder finds it seconds later."""
_LOOK_PERIOD_S = 0.1
_ADAPT_PERIOD_S = 0.5
_TICK_PERIOD_S = 0.1
_PAUSE_S = 0.01


@dataclass
class _Source:
    """One subscription; in PolarNode's list it counts for the lockstep pace too."""

    topic: str
    msg_type: type[Any]
    subscription: Subscription
    reliable: bool
    latched: bool
    count: int = 0

    @property
    def matched(self) -> int:
        """Number of publishers matched with this subscription."""
        return int(self.subscription.get_publisher_count())


class RecorderNode(PolarNode[RecorderParams]):
    """Node around one `Recording`."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('recorder_node', RecorderParams, **kwargs)
        wanted = parse_topics(self.params.topics)
        types = {name: _message_class(type_name) for name, type_name in wanted.items()}
        self._sources: dict[str, _Source] = {}
        self._skipped: dict[str, str] = {}
        self._started = self._rated_at = time.monotonic()
        self._rated_count = 0
        self._alone = 0
        self._recording = self._open()
        for name, type_name in wanted.items():
            self._record(name, type_name, types[name], [])
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if not self.params.topics:
            self.create_timer(_LOOK_PERIOD_S, self._look_around, clock=steady)
        self.create_timer(_ADAPT_PERIOD_S, self._adapt, clock=steady)
        self.create_timer(_TICK_PERIOD_S, self._tick, clock=steady)

    @property
    def bag_path(self) -> Path:
        """Directory of the bag."""
        return self._path

    @property
    def skipped(self) -> dict[str, str]:
        """Topics that are not recorded though nobody excluded them, each with the reason."""
        return {name: why for name, why in self._skipped.items() if why != 'excluded'}

    def _open(self) -> Recording:
        p = self.params
        now = datetime.now(UTC)
        self._path = Path(p.output or f'bags/{now:%Y%m%d_%H%M%S}')
        simulated = p.log_time == 'simulation' or (
            p.log_time == 'auto' and (p.lockstep or bool(self.get_parameter('use_sim_time').value))
        )
        info = parse_run_info(p.run_info)
        info['recorder'] = {
            'node': self.get_fully_qualified_name(),
            'started_utc': now.isoformat(timespec='seconds'),
            'log_time': 'simulation' if simulated else 'reception',
            'lockstep': p.lockstep,
        }

        def opened(resume: bool) -> BagWriter:
            writer = BagWriter(
                self._path,
                info,
                compression=p.compression,
                chunk_bytes=p.chunk_bytes,
                flush_s=p.flush_period,
                sync=p.sync,
                resume=resume,
            )
            self.get_logger().info(f'recording to {writer.path}')
            return writer

        rotation = Rotation(
            lambda: opened(resume=True), p.max_bag_size, round(p.max_bag_duration * 1e9)
        )
        if p.resume:
            require_own(self._path)
        writer = opened(p.resume)
        return Recording(writer, simulated=simulated, offered=self._offered, rotation=rotation)

    # -- subscriptions

    def _record(
        self, topic: str, type_name: str, msg_type: type[Any], offered: Sequence[Qos]
    ) -> None:
        reliable, latched = request_for(offered) if offered else (True, topic.endswith(_LATCHED))
        self._recording.add_topic(topic, type_name, kept=latched)

        @informed
        def on_first(data: bytes, about: dict[str, Any]) -> None:
            self._take(source, data, about, single=source.matched <= 1)
            self._drain()

        subscription = self.create_subscription(
            msg_type, topic, on_first, _profile(reliable, latched), raw=True
        )
        previous = self._sources.get(topic)
        source = _Source(topic, msg_type, subscription, reliable, latched)
        self._sources[topic] = source
        if previous is not None:
            source.count = previous.count
            self.destroy_subscription(previous.subscription)
        if topic not in UNCOUNTED and not topic.endswith(f'/{START}'):  # nor is what is latched
            self.count_input(source)

    def _look_around(self) -> None:
        """Subscribe to new topics."""
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._sources and topic not in self._skipped:
                self._discover(topic, types)

    def _adapt(self) -> None:
        """Subscribe again with the QoS that the publishers offer, where they have come since."""
        for source in list(self._sources.values()):
            offered = self._offered(source.topic)
            if offered and self._must_ask_less(source, offered):
                self.get_logger().info(f'{source.topic}: subscribing again as it is offered')
                type_name = self._recording.topics[source.topic].type
                self._record(source.topic, type_name, source.msg_type, offered)

    def _must_ask_less(self, source: _Source, offered: Sequence[Qos]) -> bool:
        """Whether a publisher's QoS is too weak for the subscription, which is then relaxed."""
        reliable, latched = request_for(offered)
        return (source.reliable and not reliable) or (source.latched and not latched)

    def _discover(self, topic: str, types: Sequence[str]) -> None:
        if topic in self.params.exclude or '/_' in topic:
            self._skipped[topic] = 'excluded'
            return
        offered = self._offered(topic)
        if not offered:
            return  # only subscribers so far
        try:
            if len(types) != 1:
                raise ConfigError(f'topic {topic} has several types: {", ".join(types)}')
            self._record(topic, types[0], _message_class(types[0]), offered)
        except (BagError, ConfigError) as error:
            self._skipped[topic] = str(error)
            self.get_logger().warning(f'{topic} is not recorded: {error}')

    def _offered(self, topic: str) -> list[Qos]:
        return [_qos(info.qos_profile) for info in self.get_publishers_info_by_topic(topic)]

    # -- messages

    def _take(self, source: _Source, data: bytes, about: dict[str, Any], single: bool) -> None:
        source.count += 1
        number = about['publication_sequence_number'] if single else None
        received = about['received_timestamp'] or time.time_ns()
        self._recording.take(source.topic, data, received, number)

    def _drain(self) -> int:
        """Number of messages drained from all subscriptions, written and acknowledged."""
        before = self._recording.message_count
        for source in self._sources.values():
            handle, msg_type = source.subscription.handle, source.msg_type
            with handle:
                single: bool | None = None
                for _ in range(QUEUE_DEPTH):  # then others want their turn
                    taken = handle.take_message(msg_type, True)
                    if taken is None:
                        break
                    single = source.matched <= 1 if single is None else single
                    self._take(source, taken[0], taken[1], single=single)
        self._commit()
        self.acknowledge()
        return self._recording.message_count - before

    def _commit(self) -> None:
        try:
            self._recording.commit()
        except BagError:
            self._recording.abandon()
            raise

    def _tick(self) -> None:
        self._commit()

    def diagnose(self) -> Diagnosis:
        """Health with numbers, rate and losses of recorded messages."""
        now, recording = time.monotonic(), self._recording
        elapsed = max(now - self._rated_at, 1e-9)
        rate = (recording.message_count - self._rated_count) / elapsed
        self._rated_at, self._rated_count = now, recording.message_count
        values: dict[str, object] = {
            'messages': recording.message_count,
            'messages_per_s': round(rate, 1),
            'bytes': recording.byte_count,
            'file_bytes': recording.file_bytes,
            'lost': recording.lost,
            'waiting': recording.waiting,
            **{name: t.count for name, t in sorted(recording.topics.items())},
        }
        values |= {f'skipped {name}': why for name, why in self._skipped.items()}
        alone = self._is_alone()
        if alone:
            return Diagnosis(Level.WARN, alone, values)
        if recording.lost:
            message = f'{recording.lost} messages were lost on the way to the recorder'
            return Diagnosis(Level.WARN, message, values)
        return Diagnosis(Level.OK, f'recording to {self._path}', values)

    def _is_alone(self) -> str:
        """Sentence on a graph where nobody publishes, logged once; empty where somebody does."""
        if self._sources.keys() - _OWN or _OWN & set(self.params.exclude):
            self._alone = 0
            return ''
        self._alone += 1
        if self._alone < _PATIENCE:
            return ''
        domain = os.environ.get('ROS_DOMAIN_ID', '0')
        said = (
            f'no other node publishes anything in ROS domain {domain}: there is nothing to record'
        )
        if self._alone == _PATIENCE:
            self.get_logger().warning(said)
        return said

    def close(self) -> None:
        """Record the last messages of other nodes until none come, then finish the bag."""
        start = quiet_since = time.monotonic()
        while True:
            if self._drain():
                quiet_since = time.monotonic()
            now = time.monotonic()
            if (
                now - quiet_since >= self.params.quiet_time
                or now - start >= self.params.drain_time
            ):
                break
            time.sleep(_PAUSE_S)
        try:
            path = self._recording.finish(wall_s=round(time.monotonic() - self._started, 3))
        except BagError:
            self._recording.abandon()
            raise
        count, lost = self._recording.message_count, self._recording.lost
        self.get_logger().info(f'{path}: {count} messages, {lost} lost')


def _message_class(type_name: str) -> type[Any]:
    package, _, name = type_name.split('/') if type_name.count('/') == 2 else ('', '', '')
    try:
        return getattr(import_module(f'{package}.msg'), name)  # type: ignore[no-any-return]
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f'message type {type_name} is not installed here ({error})') from error


def _profile(reliable: bool, latched: bool) -> QoSProfile:
    return QoSProfile(
        history=DATA_QOS.history,
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
    )


def _qos(profile: QoSProfile) -> Qos:
    """QoS profile of an endpoint; its history, unknown to discovery, is the default one."""
    return Qos(
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        liveliness=profile.liveliness.name.lower(),
    )


def main(args: Sequence[str] | None = None) -> int:
    """Exit status of the node."""
    return run(RecorderNode, args)


if __name__ == '__main__':
    sys.exit(main())
