"""imu_node: ``truth`` -> ``imu/data_raw``, means over the intervals, stamped at their ends.

With the parameter ``ahrs`` also ``imu/data``: the same with errors of the rates, and the attitude
of base_link in the local grid axes at the stamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Imu

from polar_nav_ros import topics
from polar_nav_ros.process import run

from ..convert import AhrsMessage, ImuMessage, frame_id
from ..params import ImuParams
from ..randomness import stream
from ..sensors.ahrs import AhrsSensor
from ..sensors.imu import ImuSensor
from ..truth_cdr import TruthSample
from .truth_listener import TruthListener, stream_name

Floats = NDArray[np.float64]


class ImuNode(TruthListener[ImuParams]):
    """One IMU at base_link, as fast as the truth."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - passed on to rclpy
        super().__init__('imu_node', ImuParams, **kwargs)
        self._stream = stream_name(self, 'imu')
        self._pub = self.advertise(Imu, topics.IMU)
        self._sensor: ImuSensor | None = None
        self._ahrs: _Ahrs | None = None
        self._with_attitude = self.advertise(Imu, topics.AHRS) if self.params.ahrs else None
        self._message: ImuMessage | None = None
        self.listen()

    def wanted(self, since_start_ns: int) -> int | None:
        """Return the number of the interval that ends at the sample; None for sample 0."""
        return since_start_ns if since_start_ns > 0 else None

    def measure(self, _k: int, sample: TruthSample) -> None:
        """Publish the measurement of the interval that ends at the sample."""
        if self._sensor is None or self._message is None:
            self._sensor, self._message = self._start(sample.number('interval'))
        omega, f = self._sensor.measure(
            sample.sequence,
            sample.vector('delta_theta_b')[None, :],
            sample.vector('delta_v_b')[None, :],
        )
        self._pub.publish(self._message.fill(sample.stamp_ns, omega[0], f[0]))
        if self._ahrs is not None and self._with_attitude is not None:
            self._with_attitude.publish(self._ahrs.message(sample, omega, f))

    def facts(self) -> dict[str, object]:
        """Name of the random stream."""
        return {'random_stream': self._stream}

    def _start(self, period_s: float) -> tuple[ImuSensor, ImuMessage]:
        p = self.params
        sensor = ImuSensor(p, period_s, stream(p.seed, self._stream))
        message = ImuMessage(
            frame_id(self.vehicle, 'imu'),
            np.square(p.gyro_noise_density) / period_s,
            np.square(p.accel_noise_density) / period_s,
        )
        if p.ahrs:
            self._ahrs = _Ahrs(p, self.vehicle, stream_name(self, 'ahrs'), period_s)
        return sensor, message


class _Ahrs:
    """Attitude beside the IMU's own sample."""

    def __init__(self, p: ImuParams, vehicle: str, name: str, period_s: float) -> None:
        self._sensor = AhrsSensor(p, stream(p.seed, name))
        self._message = AhrsMessage(
            frame_id(vehicle, 'imu'),
            np.square(p.gyro_noise_density) / period_s + p.rate_variance,
            np.square(p.accel_noise_density) / period_s,
            p.angle_variance,
        )

    def message(self, sample: TruthSample, omega_b: Floats, f_b: Floats) -> Imu:
        rates, C_b_G = self._sensor.measure(sample.sequence, omega_b, sample.C_b_G[None])
        return self._message.fill_with(sample.stamp_ns, rates[0], f_b[0], C_b_G[0])


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(ImuNode, args)
