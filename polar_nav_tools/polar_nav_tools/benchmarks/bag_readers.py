"""Readers of MCAP bags by other libraries, and their way to the engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from polar_nav_core.engine.inputs import Inputs
from polar_nav_follower import session
from polar_nav_follower.convert import fix_from_msg
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl, VehicleTruth
from polar_nav_ros import readers, topics

from ..bags import Bag
from ..bags.reader import blocks_of
from ..experiments.received import VEHICLE

_TYPES = {
    topics.IMU: Imu,
    topics.DVL: Dvl,
    topics.DEPTH: Depth,
    topics.TRUTH: VehicleTruth,
    topics.RX: AcousticPacket,
}


def bare(bag: Bag) -> int:
    """Number of bytes of all chunks, read and decompressed only."""
    size = 0
    for file in bag.files:
        for content, _, _ in blocks_of(file, frozenset(file.channels)):
            size += len(content)
    return size


def mcap_raw(path: Path) -> int:
    """Iterator over all messages by mcap, without decoding."""
    with path.open('rb') as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(log_time_order=False))


def mcap_ros2(path: Path) -> Iterator[tuple[str, Any]]:
    """Topics and messages of a bag, decoded by mcap-ros2-support."""
    with path.open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for found in reader.iter_decoded_messages(log_time_order=False):
            yield found.channel.topic, found.decoded_message


def mcap_rclpy(path: Path) -> Iterator[tuple[str, Any]]:
    """Topics and messages of a bag, read by mcap and deserialized by rclpy."""
    types = {f'/{VEHICLE}/{topic}': one for topic, one in _TYPES.items()} | {
        topics.RUN_INFO: String
    }
    with path.open('rb') as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            yield channel.topic, deserialize_message(message.data, types[channel.topic])


def exhausted(messages: Iterator[Any]) -> int:
    """Number of messages."""
    return sum(1 for _ in messages)


def inputs_of(messages: Iterator[tuple[str, Any]], params: FollowerParams) -> Inputs:
    """Input of the engine from decoded messages: the other libraries' way to the same engine."""
    found: dict[str, list[Any]] = {topic: [] for topic in session.INPUTS}
    to_event: dict[str, Callable[[Any, int], Any]] = {
        topics.IMU: readers.imu_from_msg,
        topics.DVL: lambda m, n: readers.dvl_from_msg(
            m, n, params.dvl_sigma, params.water_sound_speed
        ),
        topics.DEPTH: lambda m, n: readers.depth_from_msg(m, n, params.depth_sigma),
        topics.RX: lambda m, n: fix_from_msg(m, n, params)[0],
    }
    for topic, message in messages:
        name = topic.removeprefix(f'/{VEHICLE}/')
        if name in to_event:
            found[name].append(to_event[name](message, len(found[name])))
    imu, dvl, depth = (found[t] for t in (topics.IMU, topics.DVL, topics.DEPTH))
    return Inputs(
        imu_stamps_ns=np.array([e.stamp_ns for e in imu]),
        omega_ib_b=np.array([e.omega_ib_b for e in imu]),
        f_b=np.array([e.f_b for e in imu]),
        dvl_stamps_ns=np.array([e.stamp_ns for e in dvl]),
        dvl_v_m=np.array([e.v_m for e in dvl]),
        dvl_covariance_m=np.array([e.covariance_m for e in dvl]),
        dvl_valid=np.array([e.valid for e in dvl]),
        depth_stamps_ns=np.array([e.stamp_ns for e in depth]),
        depth=np.array([e.depth for e in depth]),
        depth_variance=np.array([e.variance for e in depth]),
        fixes=tuple(found[topics.RX]),
    )
