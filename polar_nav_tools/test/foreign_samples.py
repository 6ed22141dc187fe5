"""The reference bag as someone else would have recorded it: other topics, types, axes and units.

The IMU is a type of a package that exists nowhere, forward-right-down, in degrees and g; the DVL
is marine_acoustic_msgs/Dvl, turned by 45 degrees and tilted; depth is a height in a PointStamped;
fixes are poses in a north-east-down frame; the reference is an Odometry in east-north-up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from polar_nav_core.attitude import quaternion_from_matrix
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.engine.events import DepthSample, DvlPing, Fix, ImuSample
from polar_nav_core.grid import ecef_to_grid
from polar_nav_follower.session import Session
from polar_nav_ros.adapters import rotations
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import load_truth
from polar_nav_tools.foreign.definitions import BUNDLED
from polar_nav_tools.replay.by_message import parameters
from polar_nav_tools.replay.recorded import RecordedInputs, load_inputs
from polar_nav_tools.series.vehicle import TruthSeries

REFERENCE = Path(__file__).resolve().parents[2] / 'bags' / 'reference'
ORIGIN = (79.99, 120.1, -50.0)
DVL_RPY_DEG = (175.0, 3.0, 45.0)
"""Not a half turn: those are their own inverse, and a transposed matrix would not be seen."""
IMU, DVL, DEPTH = '/acme/inertial', '/sensors/dvl', '/altimetry/height'
FIXES, TRUTH = '/acoustics/position', '/reference/odometry'
INERTIAL = """std_msgs/Header header
float32 temperature
acme_msgs/Triple turn_rate_deg
acme_msgs/Triple specific_force_g
"""
TRIPLE = """float64 forward
float64 right
float64 down
"""
MAPPING = f"""
vehicle: follower
imu:
  topic: {IMU}
  fields:
    rate: [turn_rate_deg.forward, turn_rate_deg.right, turn_rate_deg.down]
    force: [specific_force_g.forward, specific_force_g.right, specific_force_g.down]
  rotation: frd
  gyro_unit: deg/s
  accel_unit: g
dvl:
  topic: {DVL}
  rotation: {{rpy_deg: {list(DVL_RPY_DEG)}}}
depth: {{topic: {DEPTH}, positive: up, sigma: 0.05}}
fixes:
  - topic: {FIXES}
    source: leader
    frame: ned
    origin: {{latitude_deg: {ORIGIN[0]}, longitude_deg: {ORIGIN[1]}, height: {ORIGIN[2]}}}
truth:
  topic: {TRUTH}
  frame: enu
  origin: {{latitude_deg: {ORIGIN[0]}, longitude_deg: {ORIGIN[1]}, height: {ORIGIN[2]}}}
"""


@dataclass(frozen=True)
class Recording:
    """What the follower of the reference bag took."""

    inputs: RecordedInputs
    imu: tuple[ImuSample, ...]
    dvl: tuple[DvlPing, ...]
    depth: tuple[DepthSample, ...]
    fixes: tuple[Fix, ...]
    truth: TruthSeries


@lru_cache(maxsize=1)
def recording() -> Recording:
    """Load the reference bag once."""
    inputs = load_inputs(REFERENCE)
    run = Session(parameters(inputs.params, None, {}), inputs.vehicle)
    events = list(inputs.events(run, inputs.lives[0]))
    bag = open_bag(REFERENCE)
    return Recording(
        inputs,
        tuple(e for e in events if isinstance(e, ImuSample)),
        tuple(e for e in events if isinstance(e, DvlPing)),
        tuple(e for e in events if isinstance(e, DepthSample)),
        tuple(e for e in events if isinstance(e, Fix)),
        load_truth(bag, 'follower'),
    )


def engine_parameters() -> dict[str, Any]:
    """Parameters of the engine that the reference ran with, without those of its node."""
    from dataclasses import fields

    from polar_nav_core.engine.params import EngineParams

    names = {f.name for f in fields(EngineParams)}
    return {k: v for k, v in recording().inputs.params.items() if k in names}


def store_for(ros1: bool) -> Any:
    """Types of ROS and of the foreign packages."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    types = get_types_from_msg(TRIPLE, 'acme_msgs/msg/Triple')
    types |= get_types_from_msg(INERTIAL, 'acme_msgs/msg/Inertial')
    own = BUNDLED['marine_acoustic_msgs/msg/Dvl'].partition('=' * 80)[0]
    types |= get_types_from_msg(own, 'marine_acoustic_msgs/msg/Dvl')
    store.register(types)
    return store


Message = tuple[str, str, int, Any]
"""Topic, type, log time [ns], message."""
Change = Callable[[Message], Message | None]


class Maker:
    """Makes the foreign messages with the classes of a store."""

    def __init__(self, ros1: bool) -> None:
        self.store = store_for(ros1)
        self._ros1 = ros1

    def make(self, kind: str, **values: Any) -> Any:
        """Message of a type."""
        return self.store.types[kind](**values)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Header; ROS 1 counts in it."""
        stamp = self.make(
            'builtin_interfaces/msg/Time', sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
        )
        more = {'seq': 7} if self._ros1 else {}
        return self.make('std_msgs/msg/Header', stamp=stamp, frame_id=frame_id, **more)

    def xyz(self, kind: str, values: Any) -> Any:
        """Vector3 or Point."""
        x, y, z = (float(v) for v in values)
        return self.make(f'geometry_msgs/msg/{kind}', x=x, y=y, z=z)

    def messages(self) -> Iterator[Message]:
        """Everything, topic by topic."""
        r = recording()
        frd = rotations.named('frd')
        for e in r.imu:
            w, f = np.degrees(frd.T @ e.omega_ib_b), frd.T @ e.f_b / 9.80665
            kind = 'acme_msgs/msg/Inertial'
            m = self.make(
                kind,
                header=self.header(e.stamp_ns, 'imu'),
                temperature=1.5,
                turn_rate_deg=self.triple(w),
                specific_force_g=self.triple(f),
            )
            yield IMU, kind, e.stamp_ns, m
        C_m_b = rotations.from_rpy_deg(DVL_RPY_DEG)
        for d in r.dvl:
            yield DVL, 'marine_acoustic_msgs/msg/Dvl', d.stamp_ns, self.dvl(d, C_m_b)
        for h in r.depth:
            kind = 'geometry_msgs/msg/PointStamped'
            point = self.xyz('Point', (0.0, 0.0, -h.depth))
            m = self.make(kind, header=self.header(h.stamp_ns, 'sea'), point=point)
            yield DEPTH, kind, h.stamp_ns, m
        axes, origin = local_axes()
        ned = np.column_stack([axes[:, 1], axes[:, 0], -axes[:, 2]])
        for fix in r.fixes:
            yield FIXES, *self.pose(fix, ned, origin)
        for k in range(0, len(r.truth), 10):
            yield TRUTH, *self.odometry(k, axes, origin)

    def triple(self, values: Any) -> Any:
        """Three numbers of the package that exists nowhere."""
        x, y, z = (float(v) for v in values)
        return self.make('acme_msgs/msg/Triple', forward=x, right=y, down=z)

    def dvl(self, d: DvlPing, C_m_b: Any) -> Any:
        """marine_acoustic_msgs/Dvl in the axes of an instrument that looks down, turned."""
        zero = self.xyz('Vector3', (0.0, 0.0, 1.0))
        return self.make(
            'marine_acoustic_msgs/msg/Dvl',
            header=self.header(d.stamp_ns, 'dvl'),
            velocity_mode=1,
            dvl_type=0,
            velocity=self.xyz('Vector3', C_m_b.T @ d.v_m),
            velocity_covar=(C_m_b.T @ d.covariance_m @ C_m_b).ravel(),
            altitude=100.0,
            course_gnd=0.0,
            speed_gnd=0.0,
            num_good_beams=4 if d.valid else 0,
            sound_speed=1450.0,
            beam_ranges_valid=False,
            beam_velocities_valid=False,
            beam_unit_vec=[zero] * 4,
            range=np.zeros(4),
            range_covar=np.zeros(4, dtype=np.float32),
            beam_quality=np.zeros(4, dtype=np.float32),
            beam_velocity=np.zeros(4, dtype=np.float32),
            beam_velocity_covar=np.zeros(4, dtype=np.float32),
        )

    def pose(self, fix: Fix, ned: Any, origin: Any) -> tuple[str, int, Any]:
        """PoseWithCovarianceStamped in north, east, down; recorded when it was received."""
        P = np.zeros((6, 6))
        P[:3, :3] = ned.T @ fix.covariance_e @ ned
        kind = 'geometry_msgs/msg/PoseWithCovarianceStamped'
        inner = self.make(
            'geometry_msgs/msg/PoseWithCovariance',
            pose=self.make(
                'geometry_msgs/msg/Pose',
                position=self.xyz('Point', ned.T @ (fix.r_e - origin)),
                orientation=self.quaternion(np.eye(3)),
            ),
            covariance=P.ravel(),
        )
        message = self.make(kind, header=self.header(fix.validity_ns, 'usbl_ned'), pose=inner)
        return kind, fix.receive_ns, message

    def odometry(self, k: int, axes: Any, origin: Any) -> tuple[str, int, Any]:
        """Truth number k as Odometry in east, north, up."""
        t = recording().truth
        C_b_e = ecef_to_grid(t.r_e[k]).T @ t.C_b_G[k]
        kind = 'nav_msgs/msg/Odometry'
        pose = self.make(
            'geometry_msgs/msg/Pose',
            position=self.xyz('Point', axes.T @ (t.r_e[k] - origin)),
            orientation=self.quaternion(axes.T @ C_b_e),
        )
        twist = self.make(
            'geometry_msgs/msg/Twist',
            linear=self.xyz('Vector3', t.C_b_G[k].T @ t.v_G[k]),
            angular=self.xyz('Vector3', (0.0, 0.0, 0.0)),
        )
        message = self.make(
            kind,
            header=self.header(int(t.stamp_ns[k]), 'map'),
            child_frame_id='base_link',
            pose=self.make(
                'geometry_msgs/msg/PoseWithCovariance', pose=pose, covariance=np.zeros(36)
            ),
            twist=self.make(
                'geometry_msgs/msg/TwistWithCovariance', twist=twist, covariance=np.zeros(36)
            ),
        )
        return kind, int(t.stamp_ns[k]), message

    def quaternion(self, C: Any) -> Any:
        """Quaternion of a matrix."""
        x, y, z, w = (float(v) for v in quaternion_from_matrix(C))
        return self.make('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)


def local_axes() -> tuple[Any, Any]:
    """East, north, up at ORIGIN as columns, by the textbook; and the origin, ECEF."""
    lat, lon = np.radians(ORIGIN[:2])
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    axes = np.array([[-sl, -s * cl, c * cl], [cl, -s * sl, c * sl], [0.0, c, s]])
    return axes, np.asarray(ecef_from_geodetic(lat, lon, ORIGIN[2]))


def write(path: Path, kind: str = 'mcap', change: Change | None = None) -> Path:
    """Write the foreign bag as ``mcap``, ``sqlite3`` or ``ros1``.

    Parameters
    ----------
    path : Path
    kind : str
    change : callable, optional
        Gets every message, gives it back changed, or None for none.
    """
    maker = Maker(kind == 'ros1')
    found = [m if change is None else change(m) for m in maker.messages()]
    rows = sorted((m for m in found if m is not None), key=lambda m: m[2])
    types = {topic: kind_ for topic, kind_, _, _ in rows}
    if kind == 'ros1':
        with Ros1Writer(path) as writer1:
            links1 = {
                t: writer1.add_connection(t, k, typestore=maker.store) for t, k in types.items()
            }
            for topic, type_, log_ns, m in rows:
                writer1.write(links1[topic], log_ns, maker.store.serialize_ros1(m, type_))
        return path
    plugin = StoragePlugin.MCAP if kind == 'mcap' else StoragePlugin.SQLITE3
    with Ros2Writer(path, version=9, storage_plugin=plugin) as writer2:
        links2 = {t: writer2.add_connection(t, k, typestore=maker.store) for t, k in types.items()}
        for topic, type_, log_ns, m in rows:
            writer2.write(links2[topic], log_ns, maker.store.serialize_cdr(m, type_))
    return path


def restamped(message: Message, stamp_ns: int) -> Message:
    """Return a message with another stamp."""
    topic, kind, log_ns, m = message
    stamp = replace(m.header.stamp, sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return topic, kind, log_ns, replace(m, header=replace(m.header, stamp=stamp))
