"""Latency of odometry/now and processor time of a live follower, fed at the pace of its sensors.

The follower is a process of its own. This one publishes IMU samples, pings and depths of a vehicle
at rest, and hears odometry/now: a latency has both ways through the middleware in it, and this
process's own turn.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Imu

from polar_nav_core.errors import PolarNavError
from polar_nav_msgs.msg import Depth, Dvl
from polar_nav_ros import topics
from polar_nav_ros.qos import DATA_QOS
from polar_nav_ros.stamps import NS, to_msg, to_ns

from ..live.domain import graph_environment
from ..scoring import Column, Table
from . import processes

RATES = (100, 200, 400)
_VEHICLE = 'bench'
_START_NS = 1_772_323_200 * NS
_WARM_S, _LAST_S, _START_S = 3.0, 1.0, 300.0
_DEPTH = 100.0
"""That of the default initial state [m]."""


@dataclass(frozen=True)
class LiveRate:
    """Figures of one rate of the IMU.

    Attributes
    ----------
    rate : int
        IMU samples per second.
    median_ms, percentile_99_ms, most_ms : float
        Time from before an IMU sample is published to odometry/now of it.
    answered : float
        Share of samples with an odometry/now of their own.
    cpu : float
        Processor time of the follower per time.
    memory_mb : float
        Its resident memory at the end.
    """

    rate: int
    median_ms: float
    percentile_99_ms: float
    most_ms: float
    answered: float
    cpu: float
    memory_mb: float


def run(
    rates: Sequence[int] = RATES, seconds: float = 20.0, report: Callable[[str], None] = print
) -> list[LiveRate]:
    """Figures for each rate, one follower after the other.

    Raises
    ------
    PolarNavError
        When a follower does not start, or publishes nothing.
    """
    found = []
    for rate in rates:
        report(f'follower at {rate} Hz, {seconds:g} s')
        found.append(_measure(rate, seconds))
    return found


def table(found: Sequence[LiveRate]) -> Table:
    """Table of the figures."""
    columns = (
        Column('rate', 'IMU', 'Hz', 4),
        Column('median_ms', 'median', 'ms', 3),
        Column('percentile_99_ms', '99 %', 'ms', 3),
        Column('most_ms', 'most', 'ms', 3),
        Column('answered', 'answered', '', 3),
        Column('cpu', 'of a core', '', 3),
        Column('memory_mb', 'memory', 'MB', 3),
    )
    return Table('odometry/now of a live follower', columns, tuple(asdict(f) for f in found))


class _Sensors:
    """Publishes a vehicle at rest, and stores when each sample was answered.

    Parameters
    ----------
    rate : int
        Of the IMU [Hz]; pings come at 5 Hz, depths at 10 Hz.
    """

    def __init__(self, rate: int) -> None:
        self.rate, self.sent = rate, 0
        self._period_ns = NS // rate
        self.node = rclpy.create_node('sensors', namespace=_VEHICLE)
        kinds = {topics.IMU: Imu, topics.DVL: Dvl, topics.DEPTH: Depth}
        self._out = {t: self.node.create_publisher(k, t, DATA_QOS) for t, k in kinds.items()}
        self._heard = self.node.create_subscription(
            Odometry, topics.ODOMETRY_NOW, self._on_odometry, DATA_QOS
        )
        self._rng = np.random.default_rng(1)
        self.sent_at: dict[int, float] = {}
        self.latency_s: dict[int, float] = {}
        self._imu, self._dvl, self._depth = Imu(), Dvl(), Depth(depth=_DEPTH, variance=0.01)
        self._dvl.velocity_mode = Dvl.DVL_MODE_BOTTOM
        self._dvl.num_good_beams = 4
        self._dvl.velocity_covar = np.diag([1e-4] * 3).reshape(9)

    @property
    def ready(self) -> bool:
        """Whether the follower has found all topics."""
        matched = all(p.get_subscription_count() for p in self._out.values())
        return matched and bool(self._heard.get_publisher_count())

    def _on_odometry(self, message: Odometry) -> None:
        stamp_ns = to_ns(message.header.stamp)
        if stamp_ns in self.sent_at:
            self.latency_s[stamp_ns] = time.perf_counter() - self.sent_at[stamp_ns]

    def send(self) -> None:
        """Publish the next sample, and what is due of the others before it."""
        self.sent += 1
        stamp_ns = _START_NS + self.sent * self._period_ns
        stamp = to_msg(stamp_ns)
        for topic, message, every in (
            (topics.DVL, self._dvl, self.rate // 5),
            (topics.DEPTH, self._depth, self.rate // 10),
        ):
            if self.sent % every == 0:
                message.header.stamp = stamp
                self._out[topic].publish(message)
        a, w = self._imu.linear_acceleration, self._imu.angular_velocity
        a.x, a.y, a.z, w.x, w.y, w.z = self._rng.normal((0.0, 0.0, 9.833, 0.0, 0.0, 0.0), 1e-6)
        self._imu.header.stamp = stamp
        self.sent_at[stamp_ns] = time.perf_counter()
        self._out[topics.IMU].publish(self._imu)


def _measure(rate: int, seconds: float) -> LiveRate:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'logs').mkdir()
        env = graph_environment(Path(folder))
        os.environ |= {k: v for k, v in env.items() if k.startswith(('ROS_', 'RMW_', 'FASTRTPS'))}
        command = [sys.executable, '-P', '-m', 'polar_nav_follower.follower_node', '--ros-args']
        with subprocess.Popen(
            [*command, '-r', f'__ns:=/{_VEHICLE}', '-p', 'initialize:=parameters'],
            env=env,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ) as follower:
            rclpy.init(domain_id=int(env['ROS_DOMAIN_ID']))
            try:
                return _feed(_Sensors(rate), follower, seconds)
            finally:
                follower.terminate()
                rclpy.shutdown()


def _feed(sensors: _Sensors, follower: subprocess.Popen[Any], seconds: float) -> LiveRate:
    executor = SingleThreadedExecutor()
    executor.add_node(sensors.node)
    end = time.perf_counter() + _START_S
    while not sensors.ready:
        executor.spin_once(timeout_sec=0.1)
        if follower.poll() is not None or time.perf_counter() > end:
            raise PolarNavError('the follower did not start')
    _pace(sensors, executor, _WARM_S)
    cpu_s, begin = processes.cpu_s(follower.pid), time.perf_counter()
    sensors.latency_s.clear()
    sensors.sent_at.clear()
    _pace(sensors, executor, seconds)
    cpu_s, wall_s = processes.cpu_s(follower.pid) - cpu_s, time.perf_counter() - begin
    end = time.perf_counter() + _LAST_S
    while time.perf_counter() < end:
        executor.spin_once(timeout_sec=0.1)
    latencies_ms = 1e3 * np.array(list(sensors.latency_s.values()))
    if not len(latencies_ms):
        raise PolarNavError('the follower published no odometry/now')
    return LiveRate(
        rate=sensors.rate,
        median_ms=statistics.median(latencies_ms.tolist()),
        percentile_99_ms=float(np.percentile(latencies_ms, 99.0)),
        most_ms=float(latencies_ms.max()),
        answered=len(latencies_ms) / len(sensors.sent_at),
        cpu=cpu_s / wall_s,
        memory_mb=processes.resident_mb(follower.pid),
    )


def _pace(sensors: _Sensors, executor: SingleThreadedExecutor, seconds: float) -> None:
    """Publish at the rate of the IMU for so long; what is heard meanwhile is taken."""
    begin = time.perf_counter()
    for k in range(round(seconds * sensors.rate)):
        due = begin + k / sensors.rate
        while (left := due - time.perf_counter()) > 0.0:
            executor.spin_once(timeout_sec=left)
        sensors.send()
