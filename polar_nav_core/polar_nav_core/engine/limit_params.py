"""Parameters of what a sensor and its stream can say: beyond, a message is refused or a gap."""

from __future__ import annotations

from dataclasses import dataclass

from ..params import NodeParams, param


@dataclass(frozen=True)
class LimitParams(NodeParams):
    """Limits of the vehicle, of its sensors and of their stamps."""

    max_speed: float = param(
        20.0,
        'm/s',
        0.1,
        1e4,
        'Fastest that the vehicle can be; beyond is an error, and a DVL velocity per axis refused',
    )
    max_depth: float = param(
        12000.0,
        'm',
        1.0,
        12000.0,
        'Deepest that the vehicle can be; beyond is an error, and a depth refused',
    )
    max_rate: float = param(
        6.0,
        'rad/s',
        0.1,
        1e300,
        'Largest rate per axis of an IMU sample that is used: about the range of small gyroscopes '
        '(350 deg/s)',
    )
    max_specific_force: float = param(
        60.0,
        'm/s^2',
        11.0,
        1e300,
        'Largest specific force per axis of an IMU sample that is used: 6 g, above the slam of a '
        'vehicle at the surface',
    )
    max_imu_gap_s: float = param(
        0.5, 's', 0.01, 60.0, 'A longer gap between IMU samples is reported'
    )
