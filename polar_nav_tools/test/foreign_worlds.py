"""Simulated vehicles as someone else would have recorded them, with types of ROS alone.

The motion is this project's exact truth, sharp turns and a rolling, pitching hull; what the
sensors say is made here from it, so that lever arms, axes and delays are known to the last digit.
The IMU is forward-right-down, the DVL a twist of an instrument that looks down, depth a pressure,
fixes are NavSatFix of a transponder, recorded 8 s after they were valid; the reference is an
Odometry in east-north-up.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from polar_nav_core.attitude import quaternion_from_matrix
from polar_nav_core.depth import pressure_from_depth
from polar_nav_core.earth import ecef_from_geodetic, geodetic_from_ecef, gravity, up
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE
from polar_nav_ros.adapters import rotations
from polar_nav_sim.mission import load_mission
from polar_nav_sim.trajectory import Truth, TruthState
from polar_nav_tools.bags.layout import layout_of

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

S = 1_000_000_000
RATE_HZ = 100
DELAY_NS = 8 * S
DVL_LEVER_B, DEPTH_LEVER_B = (-0.4, 0.1, -0.3), (0.2, 0.0, 0.4)
TRANSPONDER_LEVER_B = (0.6, 0.0, 0.5)
ORIGIN = (84.99, -29.9, 0.0)
"""Of the reference's axes: latitude, longitude [deg], height [m]."""
ROOT = '/auv'
IMU, DVL, DEPTH = f'{ROOT}/imu/data_raw', f'{ROOT}/dvl/twist', f'{ROOT}/pressure'
FIXES, TRUTH = f'{ROOT}/usbl/position', f'{ROOT}/ground_truth/odom'
GYRO_NOISE, ACCEL_NOISE = 2.9e-5, 8.3e-4
GYRO_BIAS, ACCEL_BIAS = (4.0e-6, -3.0e-6, 5.0e-6), (0.008, -0.006, 0.01)
DVL_SIGMA, DEPTH_SIGMA, FIX_SIGMA = 0.01, 0.05, (2.0, 1.0)
PARAMETERS: dict[str, Any] = {
    **NO_COMMON_ERRORS,
    **NO_RESERVE,
    'gyro_bias_sigma': 5.0e-6,
    'gyro_noise_density': GYRO_NOISE,
    'accel_bias_sigma': 0.01,
    'accel_noise_density': ACCEL_NOISE,
    'dvl_scale_sigma': 1.0e-6,
    'dvl_markov_sigma': 1.0e-6,
    'initial_sigma_position': 2.0,
    'initial_sigma_height': 0.1,
    'initial_sigma_velocity': 0.02,
    'initial_sigma_tilt_deg': 0.05,
    'initial_sigma_heading_deg': 0.5,
}
SHARP = {
    'path.leg_m': 60.0,
    'path.spacing_m': 60.0,
    'path.turn_radius_m': 15.0,
    'oscillation.pitch.amplitude_deg': 4.0,
    'oscillation.roll.amplitude_deg': 5.0,
    'oscillation.yaw.amplitude_deg': 3.0,
}
"""Turns of 15 m at 2 m/s, and a hull that turns by up to 0.1 rad/s on every axis."""


@lru_cache(maxsize=2)
def truth_of(duration_s: float) -> Truth:
    """The motion."""
    return (
        load_mission('racetrack')
        .with_overrides({'duration_s': duration_s} | SHARP)
        .truth('follower')
    )


def stamps_of(truth: Truth, first_s: float, last_s: float, period_s: float) -> Stamps:
    """Stamps after the first second, up to and with the last [ns]."""
    k = np.arange(round(first_s / period_s) + 1, round(last_s / period_s) + 1, dtype=np.int64)
    return truth.start_ns + k * round(period_s * S)


def imu_means(truth: Truth, stamps_ns: Stamps, lever_b: Floats) -> tuple[Floats, Floats]:
    """Mean rates and specific forces at a point of the body over the 10 ms before each stamp.

    ``f = f_base + omega' x l + omega x (omega x l)``, and gravity at the one point less that at
    the other. The first term integrates to the difference of exact rates, the others are
    quadrature.
    """
    period_ns = S // RATE_HZ
    x, w = np.polynomial.legendre.leggauss(3)
    nodes = stamps_ns[:, None] + np.round(0.5 * period_ns * (x - 1.0)).astype(np.int64)
    s = truth.state(nodes)
    ends = truth.state(np.stack([stamps_ns - period_ns, stamps_ns]))
    turning = (ends.omega_ib_b[1] - ends.omega_ib_b[0]) * RATE_HZ
    C_b_e = np.swapaxes(s.C_e_G, -1, -2) @ s.C_b_G
    there = s.r_e + C_b_e @ lever_b
    weight_e = gravity(there)[..., None] * up(there) - gravity(s.r_e)[..., None] * up(s.r_e)
    f = s.f_b + np.cross(s.omega_ib_b, np.cross(s.omega_ib_b, lever_b))
    f += np.einsum('...ji,...j->...i', C_b_e, weight_e)
    mean = 0.5 * w
    return (
        np.einsum('j,njc->nc', mean, s.omega_ib_b),
        np.einsum('j,njc->nc', mean, f) + np.cross(turning, lever_b),
    )


def point(s: TruthState, lever_b: Any) -> tuple[Floats, Floats]:
    """Position [m, ECEF] and velocity over ground [m/s, grid axes] of a point of the body."""
    lever = np.asarray(lever_b, dtype=float)
    spin_b = np.einsum('nji,nj->ni', s.C_b_G, s.C_e_G[:, :, 2]) * 7.292115e-5
    r_e = s.r_e + np.einsum('nji,nj->ni', s.C_e_G, s.C_b_G @ lever)
    v_G = s.v_G + np.einsum('nij,nj->ni', s.C_b_G, np.cross(s.omega_ib_b - spin_b, lever))
    return r_e, v_G


@dataclass(frozen=True)
class Column:
    """Messages of one topic: what all have in common, and what differs, by field path."""

    topic: str
    kind: str
    log_ns: Stamps
    template: Any
    values: Mapping[str, NDArray[Any]]


class Recorder:
    """Makes the messages with the types of ROS 2."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)

    def make(self, kind: str, **values: Any) -> Any:
        """Message of a type."""
        return self.store.types[kind](**values)

    def header(self, frame_id: str) -> Any:
        """Header without a stamp."""
        return self.make(
            'std_msgs/msg/Header',
            stamp=self.make('builtin_interfaces/msg/Time', sec=0, nanosec=0),
            frame_id=frame_id,
        )

    def vector(self, kind: str = 'Vector3') -> Any:
        """Vector3 or Point of zeros."""
        return self.make(f'geometry_msgs/msg/{kind}', x=0.0, y=0.0, z=0.0)

    def level(self) -> Any:
        """Quaternion of no turn."""
        return self.make('geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0)

    def serialize(self, c: Column) -> list[bytes]:
        """All messages of a topic: the template with other numbers in their places."""
        data = bytes(self.store.serialize_cdr(c.template, c.kind))
        layout = layout_of(self.store, c.kind, data)
        out = np.tile(np.frombuffer(data, np.uint8), (len(c.log_ns), 1))
        for path, values in c.values.items():
            leaf = layout.leaves[path]
            raw = np.ascontiguousarray(values, dtype=layout.order + leaf.format)
            flat = raw.view(np.uint8).reshape(len(raw), -1)
            out[:, leaf.offset : leaf.offset + flat.shape[1]] = flat
        return [row.tobytes() for row in out]


def stamped(stamps_ns: Stamps) -> dict[str, NDArray[Any]]:
    """Columns of a header's stamp."""
    return {'header.stamp.sec': stamps_ns // S, 'header.stamp.nanosec': stamps_ns % S}


def xyz(path: str, values: Floats, names: str = 'xyz') -> dict[str, NDArray[Any]]:
    """Columns of a vector or quaternion."""
    return {f'{path}.{n}': values[:, i] for i, n in enumerate(names)}


def imu_column(
    make: Recorder,
    truth: Truth,
    stamps_ns: Stamps,
    *,
    topic: str = IMU,
    lever_b: Any = (0.0, 0.0, 0.0),
    noise: int | None = 1,
) -> Column:
    """sensor_msgs/Imu, forward-right-down, with biases and, with a seed, noise."""
    omega, f = imu_means(truth, stamps_ns, np.asarray(lever_b, dtype=float))
    if noise is not None:
        rng = np.random.default_rng([noise, int(stamps_ns[0] // S)])
        omega = omega + GYRO_BIAS + rng.normal(0.0, GYRO_NOISE * RATE_HZ**0.5, omega.shape)
        f = f + ACCEL_BIAS + rng.normal(0.0, ACCEL_NOISE * RATE_HZ**0.5, f.shape)
    frd = rotations.named('frd')
    unknown = np.array([-1.0, *[0.0] * 8])
    template = make.make(
        'sensor_msgs/msg/Imu',
        header=make.header('imu_frd'),
        orientation=make.level(),
        orientation_covariance=unknown,
        angular_velocity=make.vector(),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=make.vector(),
        linear_acceleration_covariance=np.zeros(9),
    )
    values = stamped(stamps_ns)
    values |= xyz('angular_velocity', omega @ frd) | xyz('linear_acceleration', f @ frd)
    return Column(topic, 'sensor_msgs/msg/Imu', stamps_ns, template, values)


def aiding_columns(
    make: Recorder, truth: Truth, first_s: float, last_s: float, seed: int = 2
) -> list[Column]:
    """DVL 5 Hz, pressure 1 Hz, a fix every 20 s, reference 1 Hz."""
    rng = np.random.default_rng([seed, int(first_s)])
    columns = [_dvl(make, truth, stamps_of(truth, first_s, last_s, 0.2), rng)]
    columns.append(_pressure(make, truth, stamps_of(truth, first_s, last_s, 1.0), rng))
    fixes = stamps_of(truth, first_s, last_s, 20.0)
    if len(fixes):
        columns.append(_fixes(make, truth, fixes, rng))
    since_s = first_s if first_s > 0.0 else -1.0  # the start, too
    columns.append(_reference(make, truth, stamps_of(truth, since_s, last_s, 1.0)))
    return columns


def _dvl(make: Recorder, truth: Truth, t: Stamps, rng: np.random.Generator) -> Column:
    s = truth.state(t)
    _, v_G = point(s, DVL_LEVER_B)
    v = np.einsum('nji,nj->ni', s.C_b_G, v_G) + rng.normal(0.0, DVL_SIGMA, (len(t), 3))
    P = np.zeros((6, 6))
    P[:3, :3] = np.eye(3) * DVL_SIGMA**2
    kind = 'geometry_msgs/msg/TwistWithCovarianceStamped'
    twist = make.make('geometry_msgs/msg/Twist', linear=make.vector(), angular=make.vector())
    inner = make.make('geometry_msgs/msg/TwistWithCovariance', twist=twist, covariance=P.ravel())
    template = make.make(kind, header=make.header('dvl_frd'), twist=inner)
    values = stamped(t) | xyz('twist.twist.linear', v @ rotations.named('frd'))
    return Column(DVL, kind, t, template, values)


def _pressure(make: Recorder, truth: Truth, t: Stamps, rng: np.random.Generator) -> Column:
    s = truth.state(t)
    lat, _, height = geodetic_from_ecef(point(s, DEPTH_LEVER_B)[0])
    depth = -np.asarray(height) + rng.normal(0.0, DEPTH_SIGMA, len(t))
    kind = 'sensor_msgs/msg/FluidPressure'
    template = make.make(
        kind,
        header=make.header('pressure'),
        fluid_pressure=0.0,
        variance=(DEPTH_SIGMA * 1e4) ** 2,
    )
    pressure = np.asarray(pressure_from_depth(depth, lat))
    return Column(DEPTH, kind, t, template, stamped(t) | {'fluid_pressure': pressure})


def _fixes(make: Recorder, truth: Truth, t: Stamps, rng: np.random.Generator) -> Column:
    r_e, _ = point(truth.state(t), TRANSPONDER_LEVER_B)
    lat, lon, height = geodetic_from_ecef(r_e)
    error = rng.normal(0.0, 1.0, (len(t), 3)) * (FIX_SIGMA[0], FIX_SIGMA[0], FIX_SIGMA[1])
    radius = 6.39e6
    values = {
        'latitude': np.degrees(lat + error[:, 1] / radius),
        'longitude': np.degrees(lon + error[:, 0] / (radius * np.cos(lat))),
        'altitude': height + error[:, 2],
    }
    kind = 'sensor_msgs/msg/NavSatFix'
    template = make.make(
        kind,
        header=make.header('transponder'),
        status=make.make('sensor_msgs/msg/NavSatStatus', status=0, service=1),
        latitude=0.0,
        longitude=0.0,
        altitude=0.0,
        position_covariance=np.diag(np.square([FIX_SIGMA[0], *FIX_SIGMA])).ravel(),
        position_covariance_type=2,
    )
    return Column(FIXES, kind, t + DELAY_NS, template, stamped(t) | values)


def _reference(make: Recorder, truth: Truth, t: Stamps) -> Column:
    s = truth.state(t)
    lat, lon = np.radians(ORIGIN[:2])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    origin = np.asarray(ecef_from_geodetic(lat, lon, ORIGIN[2]))
    zenith = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    axes = np.column_stack([np.cross(north, zenith), north, zenith])
    C_b_p = axes.T @ np.swapaxes(s.C_e_G, 1, 2) @ s.C_b_G
    kind = 'nav_msgs/msg/Odometry'
    pose = make.make(
        'geometry_msgs/msg/Pose', position=make.vector('Point'), orientation=make.level()
    )
    twist = make.make('geometry_msgs/msg/Twist', linear=make.vector(), angular=make.vector())
    template = make.make(
        kind,
        header=make.header('map'),
        child_frame_id='base_link',
        pose=make.make('geometry_msgs/msg/PoseWithCovariance', pose=pose, covariance=np.zeros(36)),
        twist=make.make(
            'geometry_msgs/msg/TwistWithCovariance', twist=twist, covariance=np.zeros(36)
        ),
    )
    values = stamped(t)
    values |= xyz('pose.pose.position', (s.r_e - origin) @ axes)
    values |= xyz('pose.pose.orientation', quaternion_from_matrix(C_b_p), 'xyzw')
    values |= xyz('twist.twist.linear', np.einsum('nji,nj->ni', s.C_b_G, s.v_G))
    return Column(TRUTH, kind, t, template, values)


def rows_of(make: Recorder, columns: list[Column]) -> Iterator[tuple[str, int, bytes]]:
    """Topic, log time and bytes of everything, by log time."""
    log_ns = np.concatenate([c.log_ns for c in columns])
    topics = [c.topic for c in columns for _ in c.log_ns]
    data = [message for c in columns for message in make.serialize(c)]
    for k in np.argsort(log_ns, kind='stable'):
        yield topics[k], int(log_ns[k]), data[k]


def write_columns(
    path: Path, make: Recorder, columns: list[Column], storage: str = 'mcap'
) -> Path:
    """Write a bag as ``mcap`` or ``sqlite3``."""
    plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        links = {
            topic: writer.add_connection(topic, kind, typestore=make.store)
            for topic, kind in {c.topic: c.kind for c in columns}.items()
        }
        for topic, log_ns, data in rows_of(make, columns):
            writer.write(links[topic], log_ns, data)
    return path


def mapping(imu: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What a person who knows the vehicle would write."""
    frame = {
        'frame': 'enu',
        'origin': {'latitude_deg': ORIGIN[0], 'longitude_deg': ORIGIN[1], 'height': ORIGIN[2]},
    }
    return {
        'vehicle': 'auv',
        'imu': {'topic': IMU, 'rotation': 'frd'} | dict(imu or {}),
        'dvl': {'topic': DVL, 'rotation': 'frd', 'lever_b': list(DVL_LEVER_B)},
        'depth': {'topic': DEPTH, 'lever_b': list(DEPTH_LEVER_B)},
        'fixes': [
            {
                'topic': FIXES,
                'source': 'usbl',
                'transponder_lever_b': list(TRANSPONDER_LEVER_B),
            }
        ],
        'initial': {'from': 'topic', 'topic': TRUTH} | frame,
        'truth': {'topic': TRUTH} | frame,
        'parameters': dict(PARAMETERS),
    }
