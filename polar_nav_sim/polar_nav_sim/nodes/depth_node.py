"""depth_node: ``truth`` -> ``depth/pressure`` and ``depth/data``, one measurement in two units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import FluidPressure

from polar_nav_core.depth import pressure_from_depth
from polar_nav_msgs.msg import Depth
from polar_nav_ros import topics
from polar_nav_ros.process import run

from ..convert import depth_to_msg, frame_id, pressure_to_msg
from ..params import DepthParams
from ..randomness import stream
from ..schedule import Schedule
from ..sensors.depth import DepthSensor
from ..truth_cdr import TruthSample
from .truth_listener import TruthListener, stream_name


class DepthNode(TruthListener[DepthParams]):
    """One pressure sensor."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('depth_node', DepthParams, **kwargs)
        p = self.params
        self._stream = stream_name(self, 'depth')
        self._frame = frame_id(self.vehicle, 'depth')
        self._schedule = Schedule(p.rate_hz)
        self._sensor = DepthSensor(p, stream(p.seed, self._stream), self._schedule.period_s)
        self._pressure = self.advertise(FluidPressure, topics.PRESSURE)
        self._depth = self.advertise(Depth, topics.DEPTH)
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Return the number of the due sample, or None."""
        return self._schedule.due(since_start_ns)

    def measure(self, k: int, sample: TruthSample) -> None:
        """Publish one measurement."""
        depth = self._sensor.measure(k, sample.number('depth'), sample.C_b_G)
        lat, air = sample.number('latitude'), self.params.atmospheric_pressure_pa
        # The variance of the pressure follows from its local slope, over one metre.
        depths = np.array([depth - 0.5, depth, depth + 0.5])
        shallower, pressure, deeper = pressure_from_depth(depths, lat, air).tolist()
        slope = deeper - shallower
        stamp_ns, variance = sample.stamp_ns, self._sensor.variance
        self._pressure.publish(
            pressure_to_msg(pressure, variance * slope**2, stamp_ns, self._frame)
        )
        self._depth.publish(depth_to_msg(depth, variance, stamp_ns, self._frame))

    def facts(self) -> dict[str, object]:
        """Name of the random stream."""
        return {'random_stream': self._stream}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(DepthNode, args)
