"""Follower: subscribes to sensors and packets, publishes the estimate and a receipt per fix.

| topic | type | stamp |
| --- | --- | --- |
| in imu/data_raw, dvl/data, depth/data | sensor_msgs/Imu, polar_nav_msgs/Dvl, Depth | validity |
| in imu/data, control/thrust | sensor_msgs/Imu, geometry_msgs/WrenchStamped | validity |
| in acomms/rx | polar_nav_msgs/AcousticPacket | transmission; the engine orders by receive_time |
| out nav/state | polar_nav_msgs/NavState | estimate |
| out odometry, nav/fix | nav_msgs/Odometry, sensor_msgs/NavSatFix | estimate |
| out nav/receipt | polar_nav_msgs/FixReceipt | decision |
| out nav/health | polar_nav_msgs/NavHealth | estimate, 1 Hz |
| out nav/clock | sensor_msgs/TimeReference | a clock stepped; a topic began |
| out nav/command | polar_nav_msgs/Command | place in the order of events |
| out nav/restore | polar_nav_msgs/Restore | the same; with a `state_file` |
| out acomms/decoded | polar_nav_msgs/LeaderBroadcast | validity |
| out acomms/station_decoded | polar_nav_msgs/StationFix | validity |
| in set_pose, initialpose | geometry_msgs/PoseWithCovarianceStamped | not used |
| out nav/start | diagnostic_msgs/DiagnosticArray | newest IMU sample; latched |
| out nav/inputs | polar_nav_msgs/Inputs | newest arrival; with `sources` |
| out nav/current, nav/model | polar_nav_msgs/WaterCurrent, VehicleModel | estimate, 1 Hz |
| out nav/identification | polar_nav_msgs/Identification | place in the order of events |
| out odometry/now, odometry/local | nav_msgs/Odometry | newest IMU sample (`LiveOutputs`) |

A managed node (`ManagedNode`): inactive, it navigates and is silent on odometry, nav/fix and /tf.

With a SINS (`mode` sins) it takes imu/data_raw and dvl/data and hears a leader; in `mode` station
imu/data, which has the attitude of an AHRS, and control/thrust, and it hears a station. With
`sources` sensors and fixes are those of a mapping file, of any type it has an adapter for.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from polar_nav_core.warm import forgo_blas, telling, warm_node, warm_others
from polar_nav_msgs.msg import AcousticPacket, LeaderBroadcast, StationFix
from polar_nav_ros import topics
from polar_nav_ros.adapters.live import Sources
from polar_nav_ros.adapters.start_topic import start_topic_of
from polar_nav_ros.adapters.stated import SourceFile, settled, stated_of
from polar_nav_ros.diagnostics import Diagnosis, Level
from polar_nav_ros.live_outputs import LiveOutputs
from polar_nav_ros.managed import ManagedNode
from polar_nav_ros.navigation_ports import NavigationPorts
from polar_nav_ros.process import run
from polar_nav_ros.source_ports import SourcePorts
from polar_nav_ros.state_store import StateStore

from . import session
from .params import FollowerParams


class FollowerNode(ManagedNode[FollowerParams]):
    """Node around a `Session`, which navigates, and `NavigationPorts`, which publish."""

    _file: SourceFile

    def __init__(self) -> None:
        super().__init__('follower_node', FollowerParams)
        self._ports: NavigationPorts | None = None
        self.start(active=self.params.autostart)

    def begin(self) -> None:
        """Subscribe and navigate, with outputs silent."""
        # Before anything is subscribed to: a cold compile takes long, and sensors do not wait.
        station = session.in_station_mode(self.params)
        decoded: dict[str, type[Any]] = (
            {topics.STATION_DECODED: StationFix} if station else {topics.DECODED: LeaderBroadcast}
        )
        mapping = self._file.mapping
        sources = None if mapping is None else Sources(mapping, self.params)
        ports = None
        if mapping is not None and sources is not None:
            ports = SourcePorts(self, sources, start_topic_of(mapping))
        with telling(lambda text: self.get_logger().info(f'first start: {text}')):
            if station:
                warm_others()
            else:
                warm_node(self.params.resolved().delay_handling)
        if not (self.params.state_file or self.params.lockstep):
            self.get_logger().info('no state_file: a restart begins anew, without what was known')
        navigation = session.Session(self.params, self.vehicle, sources)
        self._ports = NavigationPorts(
            self,
            navigation,
            {topics.RX: AcousticPacket},
            decoded,
            self._store() if self.params.state_file else None,
            ports,
            self._live(navigation),
            stated_of(self.params, self._stated_names(), mapping),
        )
        self._ports.silence(True)

    def silence(self, silent: bool) -> None:
        """Silence the outputs that others steer by, or let them be heard."""
        if self._ports is not None:
            self._ports.silence(silent)

    def stated(self) -> dict[str, Any]:
        """Parameters that the mapping file states, before the node's own are declared."""
        given = {name: p.value for name, p in self._parameter_overrides.items()}
        self._file = SourceFile.given(given)
        return self._file.parameters

    def settled(self, params: FollowerParams) -> FollowerParams:
        """Parameters with the origin of the initial state settled by what is stated of it."""
        return settled(params, self._stated_names(), self._file.mapping)

    def _stated_names(self) -> frozenset[str]:
        """Parameters that the user stated, in the mapping file or at the start."""
        mapping = self._file.mapping
        return self.given() if mapping is None else self.given() | set(mapping.params)

    def about(self) -> dict[str, Any]:
        """The mapping file as it stands, which a replay needs."""
        return self._file.about()

    def _live(self, navigation: session.Session) -> LiveOutputs | None:
        """Outputs at each IMU sample: not in lockstep, whose time is no present time."""
        p = self.params
        if p.now_every == 0 or p.lockstep or session.in_station_mode(p):
            return None
        return LiveOutputs(self, navigation, p)

    def _store(self) -> StateStore:
        p = self.params
        path = Path(p.state_file).expanduser()
        return StateStore(
            path, p.state_period_s, p.state_max_age_s, self.get_logger(), self.vehicle
        )

    def diagnose(self) -> Diagnosis:
        """Health with verdict counts, ages and the number of waiting events."""
        if self._ports is None:
            return Diagnosis(Level.WARN, f'{self.lifecycle}: not navigating', {})
        found = self._ports.diagnose()
        values = {**found.values, 'lifecycle': self.lifecycle}
        if self.lifecycle == 'active':
            return replace(found, values=values)
        return replace(found, message=f'{found.message}; outputs are silent', values=values)

    def close(self) -> None:
        """Process waiting events, and publish the end of the run as a SHUTDOWN command."""
        if self._ports is not None:
            self._ports.close()


def main(args: Sequence[str] | None = None) -> int:
    """Exit status of the node."""
    forgo_blas()
    return run(FollowerNode, args)


if __name__ == '__main__':
    sys.exit(main())
