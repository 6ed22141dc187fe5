"""Writes what a CycloneDDS subscriber hears of a vehicle, as JSON: argv: namespace, seconds.

The types are written by hand, as someone would without any ROS; only cyclonedds is imported.
"""

import json
import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Time(IdlStruct, typename='builtin_interfaces::msg::dds_::Time_'):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename='std_msgs::msg::dds_::Header_'):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename='geometry_msgs::msg::dds_::Vector3_'):
    x: float64
    y: float64
    z: float64


@dataclass
class Point(IdlStruct, typename='geometry_msgs::msg::dds_::Point_'):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename='geometry_msgs::msg::dds_::Quaternion_'):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename='geometry_msgs::msg::dds_::Pose_'):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename='geometry_msgs::msg::dds_::PoseWithCovariance_'):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename='geometry_msgs::msg::dds_::Twist_'):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename='geometry_msgs::msg::dds_::TwistWithCovariance_'):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename='nav_msgs::msg::dds_::Odometry_'):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Transform(IdlStruct, typename='geometry_msgs::msg::dds_::Transform_'):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename='geometry_msgs::msg::dds_::TransformStamped_'):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename='tf2_msgs::msg::dds_::TFMessage_'):
    transforms: sequence[TransformStamped]


CONFIG = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100))


def main(namespace: str, seconds: float) -> int:
    """Listen until both topics were heard and a second is over, at most so long."""
    os.environ.setdefault('CYCLONEDDS_URI', CONFIG)
    participant = DomainParticipant(int(os.environ.get('ROS_DOMAIN_ID', '0')))
    now = DataReader(participant, Topic(participant, f'rt{namespace}/odometry/now', Odometry), QOS)
    moved = DataReader(participant, Topic(participant, 'rt/tf', TFMessage), QOS)
    odometry, frames, count = None, set(), 0
    end = time.monotonic() + seconds
    while time.monotonic() < end and not (count > 50 and len(frames) > 1):
        for message in now.take(100):
            odometry, count = message, count + 1
        for message in moved.take(100):
            frames |= {(t.header.frame_id, t.child_frame_id) for t in message.transforms}
        time.sleep(0.05)
    found = {'odometry': count, 'frames': sorted(frames)}
    if odometry is not None:
        p = odometry.pose.pose.position
        found |= {
            'frame': odometry.header.frame_id,
            'child': odometry.child_frame_id,
            'position': [p.x, p.y, p.z],
            'variance': odometry.pose.covariance[0],
        }
    sys.stdout.write(json.dumps(found))
    return 0 if count and frames else 1


if __name__ == '__main__':
    sys.exit(main(sys.argv[1], float(sys.argv[2])))
