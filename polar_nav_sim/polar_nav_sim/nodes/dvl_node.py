"""dvl_node: ``truth`` -> ``dvl/data``, invalid pings marked; ``dvl/twist``, only valid ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped

from polar_nav_core.grid import earth_rate
from polar_nav_msgs.msg import Dvl
from polar_nav_ros import topics
from polar_nav_ros.node import run

from ..convert import dvl_to_msg, frame_id, twist_to_msg
from ..params import DvlParams
from ..randomness import stream
from ..schedule import Schedule
from ..sensors.dvl import DvlSensor
from ..truth_cdr import TruthSample
from ..warm import warm_up
from .truth_listener import TruthListener, stream_name


class DvlNode(TruthListener[DvlParams]):
    """One DVL."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('dvl_node', DvlParams, **kwargs)
        warm_up()
        p = self.params
        self._stream = stream_name(self, 'dvl')
        self._frame = frame_id(self.vehicle, 'dvl')
        self._schedule = Schedule(p.rate_hz)
        self._sensor = DvlSensor(p, self._schedule.period_s, stream(p.seed, self._stream))
        self._data = self.advertise(Dvl, topics.DVL)
        self._twist = self.advertise(TwistWithCovarianceStamped, topics.DVL_TWIST)
        self._invalid = 0
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Return the ping that is due."""
        return self._schedule.due(since_start_ns)

    def measure(self, k: int, sample: TruthSample) -> None:
        """Ping."""
        C_b_G = sample.C_b_G
        omega_eb_b = sample.vector('omega_ib_b') - C_b_G.T @ earth_rate(sample.vector('r_e'))
        v_b = C_b_G.T @ sample.vector('v_g')
        ping = self._sensor.measure(k, v_b, omega_eb_b, sample.number('altitude'), C_b_G)
        stamp_ns = sample.stamp_ns
        self._data.publish(dvl_to_msg(ping, stamp_ns, self._frame, self.params.sound_speed))
        if ping.valid:
            self._twist.publish(twist_to_msg(ping, stamp_ns, self._frame))
        else:
            self._invalid += 1

    def facts(self) -> dict[str, object]:
        """Invalid pings, name of the random stream."""
        return {'invalid_pings': self._invalid, 'random_stream': self._stream}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(DvlNode, args)
