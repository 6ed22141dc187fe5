"""dvl_node: ``truth`` -> ``dvl/data``, invalid pings marked; ``dvl/twist``, only valid ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped

from polar_nav_core.grid import earth_rate
from polar_nav_core.warm import forgo_blas, warm_places
from polar_nav_msgs.msg import Dvl
from polar_nav_ros import topics
from polar_nav_ros.process import run

from ..convert import dvl_to_msg, frame_id, twist_to_msg
from ..params import DvlParams
from ..randomness import stream
from ..schedule import Late, Schedule
from ..sensors.dvl import DvlSensor, Ping
from ..sound_speed import SoundSpeed
from ..truth_cdr import TruthSample
from .truth_listener import TruthListener, stream_name


class DvlNode(TruthListener[DvlParams]):
    """One DVL."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('dvl_node', DvlParams, **kwargs)
        warm_places()
        p = self.params
        self._stream = stream_name(self, 'dvl')
        self._frame = frame_id(self.vehicle, 'dvl')
        self._schedule = Schedule(p.rate_hz)
        self._sensor = DvlSensor(
            p, self._schedule.period_s, stream(p.seed, self._stream), SoundSpeed.from_spec(p)
        )
        self._late: Late[tuple[Ping, int, float]] = Late(p.latency_s)
        self._data = self.advertise(Dvl, topics.DVL)
        self._twist = self.advertise(TwistWithCovarianceStamped, topics.DVL_TWIST)
        self._invalid = 0
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Publish the delayed pings, and return the number of the due ping, or None."""
        for ping in self._late.due(since_start_ns):
            self._publish(*ping)
        return self._schedule.due(since_start_ns)

    def measure(self, k: int, sample: TruthSample) -> None:
        """Publish one ping, or delay it by its latency."""
        C_b_G = sample.C_b_G
        omega_eb_b = sample.vector('omega_ib_b') - C_b_G.T @ earth_rate(sample.vector('r_e'))
        v_b = C_b_G.T @ sample.vector('v_g')
        depth = sample.number('depth')
        ping = self._sensor.measure(k, v_b, omega_eb_b, sample.number('altitude'), C_b_G, depth)
        stated = (ping, sample.stamp_ns + self._late.latency_ns, self._sensor.sound_speed(depth))
        if self._late.latency_ns > 0:
            self._late.put(sample.since_start_ns, stated)
        else:
            self._publish(*stated)

    def _publish(self, ping: Ping, stamp_ns: int, sound_speed: float) -> None:
        phased = self.params.phased_array
        self._data.publish(dvl_to_msg(ping, stamp_ns, self._frame, sound_speed, phased=phased))
        if ping.valid:
            self._twist.publish(twist_to_msg(ping, stamp_ns, self._frame))
        else:
            self._invalid += 1

    def facts(self) -> dict[str, object]:
        """Invalid pings, name of the random stream."""
        return {'invalid_pings': self._invalid, 'random_stream': self._stream}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    forgo_blas()
    return run(DvlNode, args)
