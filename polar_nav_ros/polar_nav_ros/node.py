"""Base class of all nodes.

Parameters, counted publishers, drained subscriptions, acknowledgements and diagnostics; its
process is in `process`.
"""

from __future__ import annotations

import copy
import json
import os
import sys
import time
from collections.abc import Callable
from importlib import metadata
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import String

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import NodeParams, to_mapping
from polar_nav_msgs.msg import LockstepAck

from . import topics
from .backlog import Backlog, Drain, informed
from .blame import BlamedNode
from .counted import CountedPublisher, DrainedSubscription, Input
from .diagnostics import Diagnosis
from .parameters import load
from .qos import (
    BEST_EFFORT,
    DATA_QOS,
    LATCHED_QOS,
    RECORD_QOS,
    check_overrides,
    overridden,
    overriding,
    unused_overrides,
)

P = TypeVar('P', bound=NodeParams)

ACK_TOPIC = '/lockstep/ack'
SUPERVISED = 'POLAR_NAV_SUPERVISED'
"""Set in the environment by who reads lines for machines from stdout: ready, progress, counts."""
ACKNOWLEDGED_S = 5.0
"""For readers to have the last messages [s].

The middleware tells a reader of what it missed with its next heartbeat, up to 3 s later: a
recorder that a busy computer held up for a moment needs one.
"""
_TURN = 500
"""Messages of one subscription that are taken at a time; then timers and signals have a turn."""
_HEARTBEAT_S = 0.2
"""Between looks at what publishers offer, and between counts that are told in any case [s]."""
_BEATS = 5
"""Heartbeats of one diagnosis."""
_GONE_BEATS = 150
"""For as long, 30 s, the middleware may show a node that was killed beside its successor."""
_NO_TIME = 'use_sim_time is true and no /clock has come: this node has no time'
_NO_TIME_BEATS = 25
"""After which a missing /clock is in the log, too: 5 s."""
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)


class PolarNode(BlamedNode, Generic[P]):
    """A node with parameters from one dataclass and, as an option, the lockstep pace.

    Subclasses name their dataclass: ``class MyNode(PolarNode[MyParams])``.

    Parameters
    ----------
    name : str
        Node name.
    params_cls : type
        Parameter dataclass; the values stand in ``self.params``.

    Raises
    ------
    ConfigError
        For an unknown parameter or a value out of range.
    """

    def __init__(self, name: str, params_cls: type[P], **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        try:
            super().__init__(name, **kwargs)
        except InvalidParameterTypeException as error:  # before any of ours is declared
            raise ConfigError(f'{error}: true or false') from error
        check_overrides(self)
        self.params: P = self.settled(load(self, params_cls, self.stated()))
        self.vehicle: str = self.get_namespace().strip('/')
        self._outputs: list[CountedPublisher] = []
        self._inputs: list[Input] = []
        self._drains: list[Callable[[], None]] = []
        self._strict: list[Callable[[], None]] = []
        self.relaxed: set[str] = set()
        """Full names of the topics that a publisher offers best effort only."""
        self.ended: int | None = None
        """Exit status of a node whose work is done."""
        self.backlog = Backlog()
        self._ack_sequence = 0
        self._acks: Publisher | None = None
        if self.params.lockstep or self.params.presence:
            self._acks = self.create_publisher(LockstepAck, ACK_TOPIC, DATA_QOS)
        self._diagnostics = CountedPublisher(
            self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, 10)
        )
        self._run_info = self.create_publisher(String, topics.RUN_INFO, LATCHED_QOS)
        self._run_info.publish(String(data=self._describe()))
        self._beats = 0
        self._doubled: dict[str, int] = {}
        # One timer for all: an executor looks through all timers of its nodes when one is due.
        self.create_timer(_HEARTBEAT_S, self._beat, clock=_STEADY)

    def create_publisher(self, *args: Any, **kwargs: Any) -> Publisher:  # noqa: ANN401 - as rclpy's
        """Publisher without rclpy's handlers of events, unless some are stated.

        Those are two for each publisher, and the executor waits for each in every turn: more than
        half of its time. All they do is to warn of a subscription with an incompatible quality
        of service, of which the subscriber warns, too.
        """
        kwargs.setdefault('event_callbacks', PublisherEventCallbacks(use_default_callbacks=False))
        return super().create_publisher(*args, **kwargs)

    def stated(self) -> dict[str, Any]:
        """Values in place of the defaults of parameters, before those are declared; overridden."""
        return {}

    def settled(self, params: P) -> P:
        """Parameters as they are used and recorded; overridden by nodes that settle a choice."""
        return params

    def given(self) -> frozenset[str]:
        """Names of the parameters that the node was started with."""
        return frozenset(self._parameter_overrides)

    def about(self) -> dict[str, Any]:
        """What the node's description on /run_info says besides its parameters; overridden."""
        return {}

    def advertise(self, msg_type: type[Any], topic: str) -> CountedPublisher:
        """Counted publisher on ``topic``; of what it keeps, a recorder that finds it late gets."""
        qos = RECORD_QOS if topic in topics.KEPT else DATA_QOS
        output = CountedPublisher(self.create_publisher(msg_type, topic, qos))
        self._outputs.append(output)
        return output

    def subscribe(
        self,
        msg_type: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        *,
        raw: bool = False,
        qos: QoSProfile = DATA_QOS,
        after_others: bool = False,
        then: Callable[[], None] | None = None,
    ) -> Subscription:
        """Subscription that drains all waiting messages in one turn of the executor.

        The executor's turn costs several times what taking a message costs, so the first message
        of a burst brings the rest with it, some hundred at most. With `after_others` one that had
        to wait comes after what waits on all other subscriptions, also within a long burst: a node
        that was held up then finds its inputs side by side, and not one of them seconds ahead of
        the others. `then` is called after each burst.

        Where a publisher offers best effort only, another subscription that asks for no more takes
        its place, unless ``qos_overrides`` state the reliability, or in the lockstep pace.
        """
        waiting = Drain(_TURN, self.backlog, lambda: entry.matched <= 1)

        def drain() -> None:
            with handle:
                waiting.take(handle, msg_type, callback, raw=raw, between=others)

        def drain_others() -> None:
            for other in self._drains:
                if other is not drain:
                    other()

        others = drain_others if after_others else None

        # The first one is a message of msg_type, or its bytes.
        @informed
        def drained(first: Any, about: dict[str, Any]) -> None:  # noqa: ANN401
            if others is not None and not waiting.is_fresh(about):
                others()
            callback(first)
            waiting.note(about)
            drain()
            if then is not None:
                then()
            self.acknowledge()

        def relax() -> None:
            if not self._is_offered_less(entry):
                return
            name = entry.topic
            self.get_logger().info(f'{name} is offered best effort only: taken as that')
            self.relaxed.add(name)
            drain()
            self._drains.remove(drain)
            self._strict.remove(relax)
            self.destroy_subscription(subscription)
            self.subscribe(
                msg_type,
                topic,
                callback,
                raw=raw,
                qos=BEST_EFFORT,
                after_others=after_others,
                then=then,
            )
            newest = self._inputs[-1]
            if isinstance(newest, DrainedSubscription):
                newest.drain.count += entry.count

        self._drains.append(drain)
        reliable = qos.reliability == ReliabilityPolicy.RELIABLE
        events = None
        full_name = self.resolve_topic_name(topic)
        if reliable and not (self.params.lockstep or overridden(self, full_name)):
            self._strict.append(relax)
            events = SubscriptionEventCallbacks(use_default_callbacks=False)
        subscription = self.create_subscription(
            msg_type,
            topic,
            drained,
            copy.copy(qos),  # rclpy writes overrides into it
            raw=raw,
            event_callbacks=events,
            qos_overriding_options=overriding(self, topic, reliable=reliable),
        )
        handle = subscription.handle
        entry = DrainedSubscription(subscription, waiting)
        self.count_input(entry)
        return subscription

    def _is_offered_less(self, entry: Input) -> bool:
        """Whether a publisher that a reliable subscription has not found offers best effort.

        Asked, not told: the middleware's event of it is lost where it comes before an executor
        listens.
        """
        if entry.matched >= self.count_publishers(entry.topic):
            return False
        offered = self.get_publishers_info_by_topic(entry.topic)
        return any(i.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for i in offered)

    def _ask_no_more_than_is_offered(self) -> None:
        for relax in list(self._strict):
            relax()

    def count_input(self, entry: Input) -> None:
        """Add a subscription to the acknowledgements, in place of an older one of its topic."""
        self._inputs = [i for i in self._inputs if i.topic != entry.topic]
        self._inputs.append(entry)

    def acknowledge(self) -> None:
        """Publish the counts of received and published messages (lockstep pace only)."""
        if self.params.lockstep:
            self._tell_counts()

    def _tell_counts(self) -> None:
        if self._acks is None:
            return
        self._ack_sequence += 1
        self._acks.publish(
            LockstepAck(
                node=self.get_fully_qualified_name(),
                sequence=self._ack_sequence,
                published_topics=[o.topic for o in self._outputs],
                published_counts=[o.count for o in self._outputs],
                published_matched=[o.matched for o in self._outputs],
                taken_topics=[i.topic for i in self._inputs],
                taken_counts=[i.count for i in self._inputs],
                taken_matched=[i.matched for i in self._inputs],
            )
        )

    def taken_counts(self) -> dict[str, int]:
        """Number of messages received so far per fully qualified topic."""
        return {i.topic: i.count for i in self._inputs}

    def publishers_of(self, topic: str) -> int:
        """Publishers that the subscription to a topic, by its full name, has found."""
        return next(i.matched for i in self._inputs if i.topic == topic)

    def doubled(self, topic: str) -> str:
        """Sentence on a topic, by its full name, that several publish; empty for one of one."""
        several = self.publishers_of(topic) > 1
        offered = self.get_publishers_info_by_topic(topic) if several else []
        if len(offered) < 2:
            self._doubled.pop(topic, None)
            return ''
        found = {f'{i.node_namespace.rstrip("/")}/{i.node_name}' for i in offered}
        names = sorted(name for name in found if 'UNKNOWN' not in name)
        since = self._doubled.setdefault(topic, self._beats)
        if len(names) < 2 and self._beats - since < _GONE_BEATS:
            return ''
        return (
            f'{topic} has {len(offered)} publishers ({", ".join(names)}): what they send is taken '
            'as of one sensor'
        )

    def lost_counts(self) -> dict[str, int]:
        """Messages dropped before they were taken, per fully qualified topic that lost any."""
        drained = [i for i in self._inputs if isinstance(i, DrainedSubscription)]
        return {i.topic: i.drain.lost for i in drained if i.drain.lost}

    def published_counts(self) -> dict[str, int]:
        """Number of messages published so far per fully qualified topic."""
        return {o.topic: o.count for o in self._outputs}

    def diagnose(self) -> Diagnosis:
        """Health of the node; overridden by nodes with health of their own."""
        return Diagnosis(values={**self.taken_counts(), **self.published_counts()})

    def close(self) -> None:
        """Publish last messages before the end of the node; overridden."""

    def flush(self, timeout_s: float = ACKNOWLEDGED_S) -> list[str]:
        """Topics with readers that have not acknowledged all messages within ``timeout_s``."""
        deadline = time.monotonic() + timeout_s
        late = [
            output.topic
            for output in (*self._outputs, self._diagnostics)
            if not output.flush(max(0.0, deadline - time.monotonic()))
        ]
        if late:
            text = f'not all readers have the last messages of {", ".join(late)}'
            self.get_logger().warning(f'{text}: not acknowledged within {timeout_s:g} s')
        return late

    def tell_supervisor(self, what: str, text: str) -> None:
        """Print one machine-readable line for a supervisor that asked for it (SUPERVISED)."""
        if SUPERVISED in os.environ:
            print(f'{what} {text}', flush=True)  # noqa: T201

    def tell_counts(self) -> None:
        """Print the counts of published and received messages for a supervisor."""
        counts = {'published': self.published_counts(), 'taken': self.taken_counts()}
        self.tell_supervisor('counts', f'{self.get_fully_qualified_name()} {json.dumps(counts)}')

    def _beat(self) -> None:
        self._beats += 1
        self._ask_no_more_than_is_offered()
        self._tell_counts()
        if self._beats % _BEATS == 0:
            self._publish_diagnosis()

    def _publish_diagnosis(self) -> None:
        self.tell_supervisor('alive', self.get_fully_qualified_name())
        if self._beats == _NO_TIME_BEATS and not self._has_time:
            self.get_logger().warning(_NO_TIME)
        if self._inputs and self._beats <= _BEATS:
            for name in unused_overrides(self, self.taken_counts()):
                self.get_logger().warning(f'parameter {name}: there is no such subscription')
        diagnosis = self.diagnose().beside('' if self._has_time else _NO_TIME)
        message = diagnosis.to_msg(self.get_fully_qualified_name(), self.vehicle)
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    @property
    def _has_time(self) -> bool:
        clock = self.get_clock()
        return not clock.ros_time_is_active or clock.now().nanoseconds > 0

    def _describe(self) -> str:
        package = _package_of(type(self).__module__)
        try:
            version = metadata.version(package)
        except metadata.PackageNotFoundError:
            version = 'unknown'
        return json.dumps(
            {
                'node': self.get_fully_qualified_name(),
                'package': package,
                'version': version,
                'engine_version': ENGINE_VERSION,
                'params': to_mapping(self.params),
                **self.about(),
            },
            sort_keys=True,
        )


def _package_of(module: str) -> str:
    """Return the package of a node's module, also where that is what was started (`-m`)."""
    spec = getattr(sys.modules[module], '__spec__', None)
    return (module if spec is None else str(spec.name)).split('.')[0]
