"""Where the quantities stand in the messages that are known, as field paths.

A quantity of several numbers is a list of paths, one per number, or the path of a row. The paths
of another type, or of another use of a known one, come from ``fields`` in the mapping.
"""

from __future__ import annotations

from collections.abc import Mapping

Paths = tuple[str, ...]
Layout = Mapping[str, Paths]


def _xyz(path: str) -> Paths:
    return tuple(f'{path}.{axis}' for axis in 'xyz')


def _xyzw(path: str) -> Paths:
    return tuple(f'{path}.{axis}' for axis in 'xyzw')


_DVL: Layout = {
    'velocity': _xyz('velocity'),
    'covariance': ('velocity_covar',),
    'mode': ('velocity_mode',),
    'beams': ('num_good_beams',),
    'type': ('dvl_type',),
    'sound_speed': ('sound_speed',),
}
_NAVSATFIX: Layout = {
    'geodetic': ('latitude', 'longitude', 'altitude'),
    'covariance': ('position_covariance',),
    'covariance_type': ('position_covariance_type',),
    'status': ('status.status',),
}

IMU: dict[str, Layout] = {
    'sensor_msgs/msg/Imu': {
        'rate': _xyz('angular_velocity'),
        'force': _xyz('linear_acceleration'),
    }
}
VELOCITY: dict[str, Layout] = {
    'polar_nav_msgs/msg/Dvl': _DVL,
    'marine_acoustic_msgs/msg/Dvl': _DVL,
    'dvl_msgs/msg/DVL': {
        'velocity': _xyz('velocity'),
        'sigma': ('fom',),
        'valid': ('velocity_valid',),
    },
    'geometry_msgs/msg/TwistStamped': {'velocity': _xyz('twist.linear')},
    'geometry_msgs/msg/TwistWithCovarianceStamped': {
        'velocity': _xyz('twist.twist.linear'),
        'covariance': ('twist.covariance',),
    },
    'nav_msgs/msg/Odometry': {
        'velocity': _xyz('twist.twist.linear'),
        'covariance': ('twist.covariance',),
    },
}
DEPTH: dict[str, Layout] = {
    'polar_nav_msgs/msg/Depth': {'depth': ('depth',), 'variance': ('variance',)},
    'sensor_msgs/msg/FluidPressure': {'pressure': ('fluid_pressure',), 'variance': ('variance',)},
    'geometry_msgs/msg/PointStamped': {'depth': ('point.z',)},
    'sensor_msgs/msg/Range': {
        'depth': ('range',),
        'least': ('min_range',),
        'most': ('max_range',),
    },
    'std_msgs/msg/Float32': {'depth': ('data',)},
    'std_msgs/msg/Float64': {'depth': ('data',)},
}
_ORIENTATION: Layout = {
    'attitude': _xyzw('orientation'),
    'covariance': ('orientation_covariance',),
}
HEADING: dict[str, Layout] = {
    'sensor_msgs/msg/Imu': _ORIENTATION,
    'geometry_msgs/msg/QuaternionStamped': {'attitude': _xyzw('quaternion')},
    'geometry_msgs/msg/PoseStamped': {'attitude': _xyzw('pose.orientation')},
    'geometry_msgs/msg/PoseWithCovarianceStamped': {'attitude': _xyzw('pose.pose.orientation')},
    'nav_msgs/msg/Odometry': {'attitude': _xyzw('pose.pose.orientation')},
    'std_msgs/msg/Float32': {'heading': ('data',)},
    'std_msgs/msg/Float64': {'heading': ('data',)},
}
POSITION: dict[str, Layout] = {
    'sensor_msgs/msg/NavSatFix': _NAVSATFIX,
    'nav_msgs/msg/Odometry': {
        'position': _xyz('pose.pose.position'),
        'attitude': _xyzw('pose.pose.orientation'),
        'covariance': ('pose.covariance',),
        'velocity_body': _xyz('twist.twist.linear'),
        'frame_id': ('header.frame_id',),
    },
    'geometry_msgs/msg/PoseWithCovarianceStamped': {
        'position': _xyz('pose.pose.position'),
        'attitude': _xyzw('pose.pose.orientation'),
        'covariance': ('pose.covariance',),
        'frame_id': ('header.frame_id',),
    },
    'geometry_msgs/msg/PoseStamped': {
        'position': _xyz('pose.position'),
        'attitude': _xyzw('pose.orientation'),
        'frame_id': ('header.frame_id',),
    },
    'geometry_msgs/msg/PointStamped': {
        'position': _xyz('point'),
        'frame_id': ('header.frame_id',),
    },
    'dvl_msgs/msg/DVLDR': {'position': _xyz('position'), 'sigma': ('pos_std',)},
    'polar_nav_msgs/msg/VehicleTruth': {
        'position': ('r_e',),
        'velocity_grid': ('v_g',),
        'attitude_grid': ('c_b_g',),
        'frame_id': ('header.frame_id',),
    },
    'polar_nav_msgs/msg/NavState': {
        'position': ('r_e',),
        'velocity_grid': ('v_g',),
        'attitude_grid_xyzw': _xyzw('orientation'),
        'covariance_grid': ('position_covariance_g',),
        'frame_id': ('header.frame_id',),
    },
}
PACKETS: dict[str, Layout] = {
    'polar_nav_msgs/msg/AcousticPacket': {
        'payload': ('data',),
        'receive_time': ('receive_time',),
        'transmit_time': ('transmit_time',),
        'source': ('source',),
        'sequence': ('sequence',),
    },
    'ros_acomms_msgs/msg/ReceivedPacket': {'payload': ('packet.dataframe_bytes',)},
    'acomms_msgs/msg/AcommsRxByteArray': {'payload': ('msg.data',)},
    'seatrac_interfaces/msg/ModemRec': {'payload': ('packet_data',), 'length': ('packet_len',)},
    'seatrac_driver/msg/DataReceiveStatus': {
        'payload': ('packet_data',),
        'length': ('packet_length',),
    },
    'std_msgs/msg/UInt8MultiArray': {'payload': ('data',)},
    'std_msgs/msg/ByteMultiArray': {'payload': ('data',)},
}
"""Of acoustic packets: `receive_time` is that of the stamp where it is left out."""
TRANSMIT: dict[str, Layout] = {
    'acomms_msgs/msg/AcommsTxByteArray': {'payload': ('msg.data',)},
    'seatrac_interfaces/msg/ModemSend': {'payload': ('packet_data',), 'length': ('packet_len',)},
    'seatrac_driver/msg/DataSendCommand': {'payload': ('packet_data',)},
    'std_msgs/msg/UInt8MultiArray': {'payload': ('data',)},
    'std_msgs/msg/ByteMultiArray': {'payload': ('data',)},
}
"""Of messages that a modem sends."""
PAYLOAD_LIMITS = {
    'seatrac_interfaces/msg/ModemRec': 30,
    'seatrac_interfaces/msg/ModemSend': 30,
    'seatrac_driver/msg/DataReceiveStatus': 31,
    'seatrac_driver/msg/DataSendCommand': 31,
}
"""Most bytes that a message of the type carries."""
REQUIRED: dict[str, tuple[tuple[str, ...], ...]] = {
    'imu': (('rate', 'force'),),
    'velocity': (('velocity',),),
    'depth': (('depth',), ('pressure',)),
    'position': (('position',), ('geodetic',)),
    'packet': (('payload',),),
    'transmit': (('payload',),),
    'heading': (('attitude',), ('heading',)),
}
"""Quantities without which a role cannot be filled: one of the groups."""
LAYOUTS = {
    'imu': IMU,
    'velocity': VELOCITY,
    'depth': DEPTH,
    'position': POSITION,
    'heading': HEADING,
    'packet': PACKETS,
    'transmit': TRANSMIT,
}
FILTERED = (
    'nav_msgs/msg/Odometry',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'geometry_msgs/msg/PoseStamped',
    'dvl_msgs/msg/DVLDR',
)
"""Types of positions that mostly come out of a filter: their errors are no new ones each time."""
PACKET = 'polar_nav_msgs/msg/AcousticPacket'
USBL = 'polar_nav_msgs/msg/UsblFix'
