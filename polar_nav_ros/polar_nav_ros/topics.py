"""Names and message types of all topics; names without a leading slash are per vehicle.

A vehicle's topics stand in its namespace: ``/follower/nav/state``.
"""

from __future__ import annotations

from collections.abc import Iterable

IMU = 'imu/data_raw'
"""IMU data without an attitude; `AHRS` is with one."""
AHRS = 'imu/data'
COMPASS = 'ahrs/imu'
"""Orientation of a simulated AHRS with a magnetometer, against its own north."""
MAGNETIC = 'ahrs/mag'
DVL = 'dvl/data'
DVL_TWIST = 'dvl/twist'
PRESSURE = 'depth/pressure'
DEPTH = 'depth/data'
HEADING = 'heading/data'
"""Only of a mapping file: it names the topic of an AHRS or compass, of any type."""
CONTROL = 'control/thrust'
USBL = 'usbl/fix'
STATION = 'station/fix'
ABSOLUTE = 'absolute/fix'
TRUTH = 'truth'
TRUE_MODEL = 'truth/model'

TX = 'acomms/tx'
RX = 'acomms/rx'
BROADCAST = 'broadcast'
"""Content of the packets that a leader sent, for people."""
DECODED = 'acomms/decoded'
"""Content of the packets that a follower received of a leader, for people."""
STATION_DECODED = 'acomms/station_decoded'
"""Content of the packets that a follower received of a station, for people."""

STATE = 'nav/state'
RECEIPT = 'nav/receipt'
COMMAND = 'nav/command'
RESTORE = 'nav/restore'
"""The saved state that a restarted node goes on from."""
CURRENT = 'nav/current'
MODEL = 'nav/model'
IDENTIFICATION = 'nav/identification'
CLOCK_STEP = 'nav/clock'
"""Steps of the clocks of a vehicle's topics, each with the message from which on it holds."""
HEALTH = 'nav/health'
START = 'nav/start'
"""State of a node's start: what it waits for, and where its state is from; latched."""
INPUTS = 'nav/inputs'
"""Which messages of mapped sources a follower used, in blocks."""
KEPT = (COMMAND, RESTORE, CLOCK_STEP, INPUTS)
"""What a replay cannot do without: a publisher keeps it for a recorder that finds it late, or is
started again and then hears it once more."""
FIX = 'nav/fix'
ODOMETRY = 'odometry'
ODOMETRY_NOW = 'odometry/now'
"""State at the newest IMU sample, in the map frame; no part of a replay, as those below."""
ODOMETRY_LOCAL = 'odometry/local'
ODOMETRY_DEPTH = 'odometry/depth'
RESET_COUNTER = 'odometry/reset_counter'
"""How often the pose of `ODOMETRY_NOW` has jumped."""
ORIGIN = 'nav/origin'
"""Origin and axes of the map frame, as YAML."""

CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'
RUN_INFO = '/run_info'
TF = '/tf'
TF_STATIC = '/tf_static'

TYPES = {
    IMU: 'sensor_msgs/msg/Imu',
    AHRS: 'sensor_msgs/msg/Imu',
    COMPASS: 'sensor_msgs/msg/Imu',
    MAGNETIC: 'sensor_msgs/msg/MagneticField',
    DVL: 'polar_nav_msgs/msg/Dvl',
    DVL_TWIST: 'geometry_msgs/msg/TwistWithCovarianceStamped',
    PRESSURE: 'sensor_msgs/msg/FluidPressure',
    DEPTH: 'polar_nav_msgs/msg/Depth',
    HEADING: 'sensor_msgs/msg/Imu',
    CONTROL: 'geometry_msgs/msg/WrenchStamped',
    USBL: 'polar_nav_msgs/msg/UsblFix',
    STATION: 'polar_nav_msgs/msg/StationFix',
    ABSOLUTE: 'sensor_msgs/msg/NavSatFix',
    TRUTH: 'polar_nav_msgs/msg/VehicleTruth',
    TRUE_MODEL: 'polar_nav_msgs/msg/VehicleModel',
    TX: 'polar_nav_msgs/msg/AcousticPacket',
    RX: 'polar_nav_msgs/msg/AcousticPacket',
    BROADCAST: 'polar_nav_msgs/msg/LeaderBroadcast',
    DECODED: 'polar_nav_msgs/msg/LeaderBroadcast',
    STATION_DECODED: 'polar_nav_msgs/msg/StationFix',
    STATE: 'polar_nav_msgs/msg/NavState',
    RECEIPT: 'polar_nav_msgs/msg/FixReceipt',
    COMMAND: 'polar_nav_msgs/msg/Command',
    RESTORE: 'polar_nav_msgs/msg/Restore',
    CURRENT: 'polar_nav_msgs/msg/WaterCurrent',
    MODEL: 'polar_nav_msgs/msg/VehicleModel',
    IDENTIFICATION: 'polar_nav_msgs/msg/Identification',
    CLOCK_STEP: 'sensor_msgs/msg/TimeReference',
    HEALTH: 'polar_nav_msgs/msg/NavHealth',
    START: 'diagnostic_msgs/msg/DiagnosticArray',
    INPUTS: 'polar_nav_msgs/msg/Inputs',
    FIX: 'sensor_msgs/msg/NavSatFix',
    ODOMETRY: 'nav_msgs/msg/Odometry',
    ODOMETRY_NOW: 'nav_msgs/msg/Odometry',
    ODOMETRY_LOCAL: 'nav_msgs/msg/Odometry',
    ODOMETRY_DEPTH: 'polar_nav_msgs/msg/Depth',
    RESET_COUNTER: 'std_msgs/msg/UInt32',
    ORIGIN: 'std_msgs/msg/String',
    CLOCK: 'rosgraph_msgs/msg/Clock',
    DIAGNOSTICS: 'diagnostic_msgs/msg/DiagnosticArray',
    RUN_INFO: 'std_msgs/msg/String',
    TF: 'tf2_msgs/msg/TFMessage',
    TF_STATIC: 'tf2_msgs/msg/TFMessage',
}
"""Message type of every topic."""


def of_vehicle(vehicle: str, names: Iterable[str]) -> dict[str, str]:
    """Full names of a vehicle's topics, each with its message type."""
    return {f'/{vehicle}/{name}': TYPES[name] for name in names}


_ESTIMATES = (STATE, FIX, ODOMETRY, ODOMETRY_NOW, ODOMETRY_LOCAL, ODOMETRY_DEPTH)


def estimates_beside(states: Iterable[str]) -> set[str]:
    """Full names of what navigations made, by those of their nav/state: no measurements."""
    prefixes = [name.removesuffix(STATE) for name in states if name.endswith(f'/{STATE}')]
    return {prefix + name for prefix in prefixes for name in _ESTIMATES}
