"""Drivers of a cheap vehicle as one process: argv: seed, seconds, listeners to wait for (1).

Publishes its readings in real time, best effort, on the drivers' own types, once so many listen to
each of them; stamps are the host's. Of this project it uses the vehicle alone.
"""

import sys
import threading
import time

import rclpy
from dvl_msgs.msg import DVL
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import FluidPressure, Imu, NavSatFix

from polar_nav_tools.experiments.cheap import recording

TYPES = {
    recording.IMU: Imu,
    recording.DVL: DVL,
    recording.PRESSURE: FluidPressure,
    recording.FIX: NavSatFix,
}


def main(seed: int, seconds: float, listeners: int = 1) -> None:
    """Wait for listeners, then publish."""
    rclpy.init()
    node = rclpy.create_node('drivers')
    qos = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    out = {topic: node.create_publisher(kind, topic, qos) for topic, kind in TYPES.items()}
    run = recording.readings(seed, seconds)
    while any(p.get_subscription_count() < listeners for p in out.values()):
        time.sleep(0.1)
    node.get_logger().info('publishing')
    time.sleep(1.0)
    for topic, log_ns, message in recording.messages(run, time.time_ns() + 1_000_000_000):
        time.sleep(max(0.0, (log_ns - time.time_ns()) * 1e-9))
        out[topic].publish(message)
    # What a publisher sent right before it leaves is lost to a listener that is held up meanwhile:
    # nobody sends it again. So it stays until it is killed, as a driver on a vehicle does.
    node.get_logger().info('published all')
    threading.Event().wait()


if __name__ == '__main__':
    main(int(sys.argv[1]), float(sys.argv[2]), *map(int, sys.argv[3:]))
