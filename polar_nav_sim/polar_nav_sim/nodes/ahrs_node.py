"""ahrs_node: ``truth`` -> ``ahrs/imu`` and ``ahrs/mag``, an orientation and the field it is by.

The orientation is base_link in the east and north of its reference (magnetic north by default, no
declination applied), up; rates and forces are those of ``imu_node``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sensor_msgs.msg import Imu, MagneticField

from polar_nav_ros import topics
from polar_nav_ros.process import run

from ..convert import compass_to_msg, frame_id, magnetic_to_msg
from ..params import AhrsParams
from ..randomness import stream
from ..schedule import Schedule
from ..sensors.compass import CompassSensor
from ..truth_cdr import TruthSample
from .truth_listener import TruthListener, stream_name


class AhrsNode(TruthListener[AhrsParams]):
    """One AHRS with a magnetometer, at base_link."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('ahrs_node', AhrsParams, **kwargs)
        p = self.params
        self._stream = stream_name(self, 'compass')
        self._frame = frame_id(self.vehicle, 'ahrs')
        self._schedule = Schedule(p.rate_hz)
        rng = stream(p.seed, self._stream)
        self._sensor = CompassSensor(p, p.reference, self._schedule.period_s, rng)
        self._orientation = self.advertise(Imu, topics.COMPASS)
        # What is measured along another reference is no field.
        magnetic = p.reference == 'magnetic'
        self._field = self.advertise(MagneticField, topics.MAGNETIC) if magnetic else None
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Return the number of the due sample, or None."""
        return self._schedule.due(since_start_ns)

    def measure(self, k: int, sample: TruthSample) -> None:
        """Publish one measurement."""
        stamp_ns = sample.stamp_ns
        reading = self._sensor.measure(
            k, stamp_ns, sample.vector('r_e'), sample.C_b_G, sample.vector('v_g')
        )
        self._orientation.publish(compass_to_msg(reading, self.params, stamp_ns, self._frame))
        if self._field is not None:
            self._field.publish(magnetic_to_msg(reading, self.params, stamp_ns, self._frame))

    def facts(self) -> dict[str, object]:
        """Name of the random stream."""
        return {'random_stream': self._stream}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(AhrsNode, args)
