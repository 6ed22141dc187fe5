"""Error models of classes of instruments and of the papers' own, each with its source.

``config/`` holds the same numbers as parameter files for ``ros2 run``; a test compares them.
Models of commercial instruments are in :mod:`polar_nav_sim.sensors.instruments`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

from .dvl import DvlErrors
from .imu import MICRO_G, ImuErrors
from .usbl import UsblErrors

T = TypeVar('T')

_DEG_PER_ROOT_HOUR = math.radians(1.0) / 60.0
"""One degree per square root of an hour [rad/s/sqrt(Hz)]."""
_PER_ROOT_HOUR = 1.0 / 60.0
"""One metre per second per square root of an hour [m/s^2/sqrt(Hz)]."""
_ROOT_TENTH = math.sqrt(0.1)
_PAPER = 'Polar cooperative navigation (Sensors 2018, 18, 1044), section '


@dataclass(frozen=True)
class Preset(Generic[T]):
    """An error model, the source of its numbers, and its usual rate [Hz] or None."""

    errors: T
    source: str
    rate_hz: float | None = None


IMU: dict[str, Preset[ImuErrors]] = {
    'paper_6_1': Preset(
        ImuErrors(),
        _PAPER + '6.1; random parts read as white noise per filter period of 0.1 s',
    ),
    # Its axes are right-forward-up: its y is our x, its x our -y.
    'paper_6_2': Preset(
        ImuErrors(
            gyro_noise_density=tuple(s * 1e-6 * _ROOT_TENTH for s in (4.308, 4.094, 2.386)),
            accel_noise_density=tuple(s * 1e-3 * _ROOT_TENTH for s in (1.747, 1.56, 0.4063)),
        ),
        _PAPER + '6.2 (measured); random parts read as white noise per filter period of 0.1 s',
    ),
    'navigation': Preset(
        ImuErrors(
            gyro_bias_dph=(0.0, 0.0, 0.0),
            gyro_turn_on_sigma_dph=0.01,
            gyro_noise_density=(0.002 * _DEG_PER_ROOT_HOUR,) * 3,
            accel_bias_ug=(0.0, 0.0, 0.0),
            accel_turn_on_sigma_ug=100.0,
            accel_noise_density=(1e-4,) * 3,
        ),
        'upper end of the class in El-Sheimy and Youssef, Inertial sensors technologies for'
        ' navigation applications, Satellite Navigation 1:2 (2020), table 1;'
        ' 10 ug/sqrt(Hz) is ours',
    ),
    'leader': Preset(
        ImuErrors(
            gyro_bias_dph=(0.0, 0.0, 0.0),
            gyro_turn_on_sigma_dph=0.003,
            gyro_noise_density=(0.001 * _DEG_PER_ROOT_HOUR,) * 3,
            accel_bias_ug=(0.0, 0.0, 0.0),
            accel_turn_on_sigma_ug=30.0,
            accel_noise_density=(5.0 * MICRO_G,) * 3,
        ),
        'ours: a fibre-optic gyrocompass of 0.01 deg times the secant of latitude',
    ),
    'tactical': Preset(
        ImuErrors(
            gyro_bias_dph=(0.0, 0.0, 0.0),
            gyro_turn_on_sigma_dph=5.0,
            gyro_noise_density=(0.15 * _DEG_PER_ROOT_HOUR,) * 3,
            gyro_instability_sigma_dph=0.5,
            gyro_instability_tau_s=1000.0,
            gyro_scale=(5e-4, 5e-4, 5e-4),
            gyro_misalignment=(1e-3, -1e-3, 1e-3),
            gyro_range=math.radians(400.0),
            accel_bias_ug=(0.0, 0.0, 0.0),
            accel_turn_on_sigma_ug=750.0,
            accel_noise_density=(0.06 * _PER_ROOT_HOUR,) * 3,
            accel_instability_sigma_ug=50.0,
            accel_instability_tau_s=1000.0,
            accel_scale=(3e-4, 3e-4, 3e-4),
            accel_misalignment=(1e-3, -1e-3, 1e-3),
            accel_range=98.0665,
        ),
        'data sheet of the Sensonor STIM300, 10 g range; correlation times are ours',
    ),
}

DVL: dict[str, Preset[DvlErrors]] = {
    'paper': Preset(DvlErrors(), _PAPER + '6.1; white noise per ping is ours'),
    'small': Preset(
        DvlErrors(
            scale=(1e-3, 1e-3, 1e-3),
            markov_sigma=0.001,
            noise_sigma=0.005,
            min_altitude_m=0.05,
            max_altitude_m=50.0,
        ),
        'Water Linked DVL A50, performance model: 0.1 %, 0.1 cm/s long term, 0.05 to 50 m;'
        ' noise per ping is ours',
    ),
    'leader': Preset(
        DvlErrors(scale=(0.0, 0.0, 0.0), scale_sigma=5e-4, markov_sigma=0.002, noise_sigma=0.003),
        'ours: 0.05 %, 0.2 cm/s slowly varying: a survey DVL calibrated against GNSS',
    ),
}

USBL: dict[str, Preset[UsblErrors]] = {
    'default': Preset(UsblErrors(), 'ours: a good array, 0.6 m across at 600 m'),
    'small': Preset(
        UsblErrors(cosine_sigma=math.radians(1.0), range_sigma_m=0.1),
        'ours: the order of what small USBL beacons state, 1 degree and a decimetre',
    ),
}
