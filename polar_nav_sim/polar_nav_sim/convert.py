"""Conversion of the models' results to messages; only this module and the nodes use ROS.

Messages that leave a hundred times a second are kept and filled again: publishing serializes at
once.
"""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import (
    Quaternion,
    TwistWithCovarianceStamped,
    Vector3,
    WrenchStamped,
)
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import FluidPressure, Imu, MagneticField, NavSatFix, NavSatStatus

from polar_nav_core.attitude import quaternion_from_matrix
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_msgs.msg import AcousticPacket, Depth, Dvl, StationFix, UsblFix, VehicleModel
from polar_nav_ros.stamps import to_msg, to_ns
from polar_nav_ros.station_outputs import station_fix_to_msg

from .acoustics import Packet
from .sensors.compass import CompassErrors, CompassReading
from .sensors.dvl import Ping
from .sensors.janus import BeamData
from .sensors.station import StationReading
from .sensors.usbl import Reading

Floats = NDArray[np.float64]

UNKNOWN = -1.0
"""First element of an unknown covariance."""
_TESLA = 1e-9
"""In a nanotesla."""


def frame_id(vehicle: str, part: str) -> str:
    """Name of a frame on a vehicle, e.g. follower/dvl; without namespace only the part."""
    return f'{vehicle}/{part}' if vehicle else part


class ImuMessage:
    """sensor_msgs/Imu of one instrument."""

    def __init__(self, frame: str, gyro_variance: Floats, accel_variance: Floats) -> None:
        self._msg = Imu()
        self._msg.header.frame_id = frame
        self._msg.orientation_covariance[0] = UNKNOWN
        self._msg.angular_velocity_covariance[[0, 4, 8]] = gyro_variance
        self._msg.linear_acceleration_covariance[[0, 4, 8]] = accel_variance

    def fill(self, stamp_ns: int, omega_ib_b: Floats, f_b: Floats) -> Imu:
        """Message of a sample; the same object every time."""
        msg = self._msg
        msg.header.stamp = to_msg(stamp_ns)
        w, f = msg.angular_velocity, msg.linear_acceleration
        w.x, w.y, w.z = omega_ib_b.tolist()
        f.x, f.y, f.z = f_b.tolist()
        return msg


class AhrsMessage(ImuMessage):
    """sensor_msgs/Imu of an AHRS: the orientation is base_link in the local grid axes."""

    def __init__(
        self, frame: str, gyro_variance: Floats, accel_variance: Floats, angle_variance: float
    ) -> None:
        super().__init__(frame, gyro_variance, accel_variance)
        self._msg.orientation_covariance[[0, 4, 8]] = angle_variance

    def fill_with(self, stamp_ns: int, omega_ib_b: Floats, f_b: Floats, C_b_G: Floats) -> Imu:
        """Message of a sample; the same object every time."""
        msg = self.fill(stamp_ns, omega_ib_b, f_b)
        q = msg.orientation
        q.x, q.y, q.z, q.w = quaternion_from_matrix(C_b_G).tolist()
        return msg


def compass_to_msg(
    reading: CompassReading, errors: CompassErrors, stamp_ns: int, frame: str
) -> Imu:
    """sensor_msgs/Imu with an orientation only: in east and north of its reference, up."""
    msg = Imu()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    q = msg.orientation
    q.x, q.y, q.z, q.w = quaternion_from_matrix(reading.attitude()).tolist()
    tilt, heading = math.radians(errors.tilt_deg) ** 2, np.radians(errors.heading_sigma_deg) ** 2
    msg.orientation_covariance[[0, 4, 8]] = tilt, tilt, heading
    msg.angular_velocity_covariance[0] = msg.linear_acceleration_covariance[0] = UNKNOWN
    return msg


def magnetic_to_msg(
    reading: CompassReading, errors: CompassErrors, stamp_ns: int, frame: str
) -> MagneticField:
    """sensor_msgs/MagneticField [T], body axes."""
    msg = MagneticField()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    msg.magnetic_field = _vector3(reading.field_b * _TESLA)
    msg.magnetic_field_covariance[[0, 4, 8]] = (errors.noise_nt * _TESLA) ** 2
    return msg


def dvl_to_msg(
    ping: Ping, stamp_ns: int, frame: str, sound_speed: float, *, phased: bool = False
) -> Dvl:
    """polar_nav_msgs/Dvl of a ping, invalid ones marked: NaN, covariance -1, beams under 3."""
    msg = Dvl()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    msg.velocity_mode = Dvl.DVL_MODE_BOTTOM
    msg.dvl_type = Dvl.DVL_TYPE_PHASED_ARRAY if phased else Dvl.DVL_TYPE_PISTON
    msg.velocity = _vector3(ping.velocity_m)
    if ping.valid:
        msg.velocity_covar = ping.covariance_m.ravel()
    else:
        msg.velocity_covar[0] = UNKNOWN
    msg.altitude = ping.altitude
    msg.course_gnd = msg.speed_gnd = float('nan')
    msg.num_good_beams = ping.beams
    msg.sound_speed = sound_speed
    msg.range_covar[:] = UNKNOWN
    msg.beam_velocity_covar[:] = UNKNOWN
    if ping.beam_data is not None:
        _fill_beams(msg, ping.beam_data)
    return msg


def _fill_beams(msg: Dvl, data: BeamData) -> None:
    """Beam by beam: NaN and covariance -1 where one is lost, quality 1 where it is good."""
    ranged = np.isfinite(data.range_m)
    msg.beam_unit_vec = [_vector3(b) for b in data.directions_m]
    msg.beam_velocities_valid = bool(data.good.any())
    msg.beam_velocity = data.velocity
    msg.beam_velocity_covar = np.where(data.good, data.velocity_variance, UNKNOWN)
    msg.beam_ranges_valid = bool(ranged.any())
    msg.range = data.range_m
    msg.range_covar = np.where(ranged, data.range_variance, UNKNOWN)
    msg.beam_quality = data.good.astype(np.float64)


def twist_to_msg(ping: Ping, stamp_ns: int, frame: str) -> TwistWithCovarianceStamped:
    """geometry_msgs/TwistWithCovarianceStamped of a valid ping; its rotation is unknown."""
    msg = TwistWithCovarianceStamped()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    msg.twist.twist.linear = _vector3(ping.velocity_m)
    covariance = msg.twist.covariance
    covariance.reshape(6, 6)[:3, :3] = ping.covariance_m
    covariance[[21, 28, 35]] = UNKNOWN
    return msg


def depth_to_msg(depth: float, variance: float, stamp_ns: int, frame: str) -> Depth:
    """polar_nav_msgs/Depth."""
    msg = Depth(depth=depth, variance=variance)
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    return msg


def pressure_to_msg(pressure: float, variance: float, stamp_ns: int, frame: str) -> FluidPressure:
    """sensor_msgs/FluidPressure [Pa, Pa^2]."""
    msg = FluidPressure(fluid_pressure=pressure, variance=variance)
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    return msg


def usbl_to_msg(reading: Reading, source: str, target: str, frame: str) -> UsblFix:
    """polar_nav_msgs/UsblFix; header.stamp is t3."""
    cycle = reading.cycle
    msg = UsblFix(source=source, target=target, sequence=cycle.sequence)
    msg.header.stamp = to_msg(cycle.t3_ns)
    msg.header.frame_id = frame
    msg.ping_time = to_msg(cycle.t1_ns)
    msg.return_time = to_msg(cycle.t4_ns)
    msg.turn_around = reading.turn_around_s
    msg.round_trip = reading.round_trip_s
    msg.range = reading.range_m
    msg.range_variance = reading.range_variance
    msg.direction = _vector3(reading.direction_a)
    msg.direction_cosine_covariance[[0, 3]] = reading.cosine_variance
    msg.sound_speed = reading.sound_speed
    msg.target_depth = reading.target_depth
    msg.target_depth_variance = reading.target_depth_variance
    return msg


def station_to_msg(reading: StationReading, source: str, target: str) -> StationFix:
    """polar_nav_msgs/StationFix; header.stamp is t3."""
    cycle = reading.cycle
    msg = station_fix_to_msg(reading.polar, source, target, cycle.sequence, cycle.t3_ns)
    msg.ping_time = to_msg(cycle.t1_ns)
    msg.return_time = to_msg(cycle.t4_ns)
    return msg


def packet_to_msg(packet: Packet) -> AcousticPacket:
    """polar_nav_msgs/AcousticPacket as it is sent; header.stamp is the transmit time."""
    msg = AcousticPacket(
        source=packet.source,
        destination=packet.destination,
        sequence=packet.sequence,
        bit_rate=packet.bit_rate,
        data=packet.data,
    )
    msg.header.stamp = msg.transmit_time = to_msg(packet.transmit_ns)
    return msg


def thrust_to_msg(stamp_ns: int, frame: str, tau: Floats) -> WrenchStamped:
    """geometry_msgs/WrenchStamped of a thrust, shape (6,) [N], [N m]."""
    msg = WrenchStamped()
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    msg.wrench.force = _vector3(tau[:3])
    msg.wrench.torque = _vector3(tau[3:])
    return msg


def thrust_from_msg(msg: WrenchStamped) -> Floats:
    """Thrust of a message, shape (6,) [N], [N m]."""
    f, t = msg.wrench.force, msg.wrench.torque
    return np.array([f.x, f.y, f.z, t.x, t.y, t.z])


def model_to_msg(
    stamp_ns: int, v_r_b: Floats, current_G: Floats, drag_linear: float, drag_quadratic: float
) -> VehicleModel:
    """polar_nav_msgs/VehicleModel of the true model: every sigma is 0."""
    msg = VehicleModel(drag_linear=drag_linear, drag_quadratic=drag_quadratic)
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = 'grid'
    msg.v_r_b = v_r_b
    msg.current_g = current_G
    return msg


def odometry_to_msg(
    stamp_ns: int,
    child: str,
    r_e: Floats,
    C_b_e: Floats,
    v_b: Floats,
    omega_eb_b: Floats,
    pose_covariance_e: Floats,
    twist_covariance_b: Floats,
) -> Odometry:
    """nav_msgs/Odometry: pose of base_link in ``earth``, twist against the earth in base_link.

    Parameters
    ----------
    stamp_ns : int
        Time [ns].
    child : str
        Frame of the vehicle.
    r_e, C_b_e : ndarray, shape (3,), (3, 3)
        Position, ECEF [m]; body to ECEF.
    v_b, omega_eb_b : ndarray, shape (3,)
        Velocity [m/s] and rate [rad/s] against the earth, body axes.
    pose_covariance_e, twist_covariance_b : ndarray, shape (6, 6)
        Of position and attitude error in ECEF axes, of velocity and rate in body axes.
    """
    msg = Odometry(child_frame_id=child)
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = 'earth'
    position = msg.pose.pose.position
    position.x, position.y, position.z = r_e.tolist()
    x, y, z, w = quaternion_from_matrix(C_b_e).tolist()
    msg.pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    msg.pose.covariance = pose_covariance_e.ravel()
    msg.twist.twist.linear = _vector3(v_b)
    msg.twist.twist.angular = _vector3(omega_eb_b)
    msg.twist.covariance = twist_covariance_b.ravel()
    return msg


def absolute_fix_to_msg(
    stamp_ns: int, frame: str, r_e: Floats, horizontal_sigma: float, vertical_sigma: float
) -> NavSatFix:
    """sensor_msgs/NavSatFix of a position, ECEF [m]; sigmas per horizontal axis and along up."""
    lat, lon, height = (float(x) for x in geodetic_from_ecef(r_e))
    msg = NavSatFix(latitude=math.degrees(lat), longitude=math.degrees(lon), altitude=height)
    msg.header.stamp = to_msg(stamp_ns)
    msg.header.frame_id = frame
    msg.status = NavSatStatus(status=NavSatStatus.STATUS_FIX, service=0)
    msg.position_covariance[[0, 4]] = horizontal_sigma**2
    msg.position_covariance[8] = vertical_sigma**2
    msg.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    return msg


def packet_from_msg(msg: AcousticPacket) -> Packet:
    """Packet of a message, sent at the message's transmit_time."""
    return Packet(
        msg.source,
        msg.destination,
        msg.sequence,
        to_ns(msg.transmit_time),
        msg.bit_rate,
        bytes(msg.data),
    )


def _vector3(x: Floats) -> Vector3:
    a, b, c = x.tolist()
    return Vector3(x=a, y=b, z=c)
