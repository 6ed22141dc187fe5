"""leader_node: readings of its array -> fixes for the follower, as packets for the modem.

| topic | type | stamp |
| --- | --- | --- |
| in usbl/fix | polar_nav_msgs/UsblFix | t3, when the transponder replied |
| out acomms/tx | polar_nav_msgs/AcousticPacket | t5, first bit |
| out broadcast | polar_nav_msgs/LeaderBroadcast | t3 |

With ``navigation: odometry``, for which another node publishes the leader's position:

| in odometry | nav_msgs/Odometry | validity |

With ``navigation: own`` those of polar_nav_ros.navigation_ports (IMU, DVL and depth in; odometry,
nav/state, nav/fix, nav/receipt, nav/clock and nav/command out), and

| in absolute/fix | sensor_msgs/NavSatFix | validity |

and with `sources` sensors and positions of a mapping file, of any type it has an adapter for.

A managed node (`ManagedNode`): inactive, it navigates and is silent on odometry, nav/fix,
acomms/tx and broadcast.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix

from polar_nav_core.errors import ConfigError
from polar_nav_core.warm import forgo_blas, telling, warm_node
from polar_nav_msgs.msg import AcousticPacket, LeaderBroadcast, UsblFix
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Sources
from polar_nav_ros.adapters.start_topic import start_topic_of
from polar_nav_ros.adapters.stated import SourceFile, settled, stated_of
from polar_nav_ros.counted import CountedPublisher
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.managed import ManagedNode
from polar_nav_ros.navigation_ports import NavigationPorts
from polar_nav_ros.process import run
from polar_nav_ros.source_ports import SourcePorts

from . import session
from .leader import Leader
from .params import LeaderParams

_OUTPUTS = {topics.BROADCAST: LeaderBroadcast, topics.TX: AcousticPacket}


class LeaderNode(ManagedNode[LeaderParams]):
    """Node of the leader: publishes the results of its session."""

    _file: SourceFile

    def __init__(self) -> None:
        super().__init__('leader_node', LeaderParams)
        self._ports: NavigationPorts | None = None
        self._leader: Leader | None = None
        self._silent = False
        self.start(active=self.params.autostart)

    def begin(self) -> None:
        """Subscribe, and navigate where it does, with outputs silent."""
        self.silence(True)
        if self.params.navigation == 'own':
            self._navigate()
        else:
            self._follow_odometry()

    def silence(self, silent: bool) -> None:
        """Silence odometry and packets, or let them be heard."""
        self._silent = silent
        if self._ports is not None:
            self._ports.silence(silent)

    def settled(self, params: LeaderParams) -> LeaderParams:
        """Parameters with the origin of the initial state settled by what is stated of it."""
        return settled(params, self._stated_names(), self._file.mapping)

    def _stated_names(self) -> frozenset[str]:
        """Parameters that the user stated, in the mapping file or at the start."""
        mapping = self._file.mapping
        return self.given() if mapping is None else self.given() | set(mapping.params)

    def diagnose(self) -> Diagnosis:
        """Health with the numbers of packets and readings, and of the navigation."""
        if self._leader is None:
            return Diagnosis(Level.WARN, f'{self.lifecycle}: not navigating', {})
        counts = dict(self._leader.counts)
        values = {**counts, 'waiting_fixes': self._leader.waiting, 'lifecycle': self.lifecycle}
        refused = sum(n for name, n in counts.items() if name != 'sent')
        sending = Diagnosis(Level.OK, f'{counts.get("sent", 0)} fixes sent', values)
        if refused:
            sending = Diagnosis(Level.WARN, f'{refused} fixes could not be used', values)
        own = Diagnosis(values=self.taken_counts())
        if self._ports is not None:
            own = self._navigation()
        worse = own if own.level > sending.level else sending
        silent = '; outputs are silent' if self._silent else ''
        return Diagnosis(worse.level, f'{worse.message}{silent}', {**own.values, **values})

    def close(self) -> None:
        """Process the waiting messages."""
        if self._ports is not None:
            self._ports.close()

    def stated(self) -> dict[str, Any]:
        """Parameters that the mapping file states, before the node's own are declared."""
        given = {name: p.value for name, p in self._parameter_overrides.items()}
        self._file = SourceFile.given(given)
        return self._file.parameters

    def about(self) -> dict[str, Any]:
        """The mapping file as it stands."""
        return self._file.about()

    def _navigate(self) -> None:
        mapping = self._file.mapping
        sources = None if mapping is None else Sources(mapping, self.params)
        if sources is not None and sources.of(topics.RX) is not None:
            raise ConfigError(
                f'{self.params.sources}: fixes: a leader takes positions, no packets'
            )
        ports = None
        if mapping is not None and sources is not None:
            ports = SourcePorts(self, sources, start_topic_of(mapping))
        # Before any subscription: a cold compile is slow, and sensors do not wait.
        with telling(lambda text: self.get_logger().info(f'first start: {text}')):
            warm_node(self.params.resolved().delay_handling)
        own = session.OwnSession(self.params, self.vehicle, sources)
        self._leader = own.leader
        inputs: dict[str, type[Any]] = {topics.USBL: UsblFix}
        if sources is None:
            inputs[topics.ABSOLUTE] = NavSatFix
        stated = stated_of(self.params, self._stated_names(), mapping)
        self._ports = NavigationPorts(self, own, inputs, _OUTPUTS, sources=ports, stated=stated)
        self._ports.silence(self._silent)

    def _follow_odometry(self) -> None:
        odometry = session.OdometrySession(self.params, self.vehicle)
        self._leader = odometry.leader
        outputs = {topic: self.advertise(kind, topic) for topic, kind in _OUTPUTS.items()}
        for topic, kind in {topics.ODOMETRY: Odometry, topics.USBL: UsblFix}.items():
            self.subscribe(kind, topic, self._taker(odometry, topic, outputs))

    def _taker(
        self, odometry: session.OdometrySession, topic: str, outputs: dict[str, CountedPublisher]
    ) -> Callable[[Any], None]:
        def take(message: Any) -> None:  # noqa: ANN401 - the topic's message type
            for published in odometry.take(topic, message):
                if not self._silent:
                    outputs[published.topic].publish(published.data)

        return take

    def _navigation(self) -> Diagnosis:
        """Health of the own navigation, with a warning about other publishers of odometry."""
        if self._ports is None:
            return Diagnosis()
        own = self._ports.diagnose()
        others = [
            f'{i.node_namespace.rstrip("/")}/{i.node_name}'
            for i in self.get_publishers_info_by_topic(topics.ODOMETRY)
            if i.node_name != self.get_name()
        ]
        if others and own.level < Level.ERROR:
            why = f'odometry is also published by {", ".join(sorted(others))}; end one of the two'
            return Diagnosis(Level.ERROR, why, own.values)
        return own


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    forgo_blas()
    return run(LeaderNode, args)


if __name__ == '__main__':
    sys.exit(main())
