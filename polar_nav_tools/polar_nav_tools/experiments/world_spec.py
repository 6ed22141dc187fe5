"""Specification of a world besides its fixes: the run, IMU, DVL, depth, the start."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from polar_nav_core.params import choice, flag, param, text
from polar_nav_sim.mission import Mission, load_mission, mission_from
from polar_nav_sim.section import Spec
from polar_nav_sim.sensors.imu import ImuErrors
from polar_nav_sim.sensors.instruments import IMU

VEHICLE = 'follower'
IMU_KINDS = (*IMU, 'perfect', 'recorded')


@dataclass(frozen=True)
class WorldSpec(Spec):
    """Specification of a world besides its fixes; the defaults are the paper's section 6.1."""

    duration_s: float = param(3600.0, 's', 2.0, 7 * 86400.0, 'Length of the run')
    mission: str = text('', 'Mission file or name; empty: the straight run stated here')
    latitude_deg: float = param(80.0, 'deg', -90.0, 90.0, 'Of the start')
    longitude_deg: float = param(120.0, 'deg', -180.0, 360.0, 'Of the start')
    course_deg: float = param(0.0, 'deg', -360.0, 360.0, 'Clockwise from north')
    course_north: str = choice('true', ('true', 'grid'), 'Which north')
    speed_mps: float = param(3.0, 'm/s', 0.05, 20.0, 'Constant velocity in grid axes')
    depth_m: float = param(100.0, 'm', 0.0, 11000.0, 'Depth')
    oscillating: bool = flag(True, 'Attitude sines of the paper: pitch 4, roll 5, yaw 3 deg')
    imu: str = choice('paper_6_1', IMU_KINDS, 'Error model of the IMU')
    imu_vices: bool = flag(True, 'False: of the model above only white noise and range')
    imu_rested: bool = flag(False, 'True: a rest took turn-on and g-dependent gyro bias away')
    imu_rate_hz: float = param(50.0, 'Hz', 10.0, 1000.0, 'Samples per second')
    constants: str = choice(
        'paper',
        ('paper', 'prior', 'none'),
        'Gyro, accelerometer and DVL scale constants: stated values, drawn from the prior, zero',
    )
    gyro_bias_dph: float = param(0.03, 'deg/h', 1e-9, 1e4, 'Constant of each axis, and its prior')
    accel_bias_g: float = param(1e-6, 'g0', 1e-12, 1.0, 'Constant of each axis, and its prior')
    dvl_scale: float = param(1e-4, '', 1e-9, 0.5, 'Constant of each axis, and its prior')
    dvl_rate_hz: float = param(10.0, 'Hz', 0.0, 50.0, 'Pings per second; 0: no DVL')
    dvl_markov_sigma: float = param(0.005, 'm/s', 1e-9, 1.0, 'Slowly varying error, 1-sigma')
    dvl_markov_tau_s: float = param(300.0, 's', 0.1, 1e6, 'Its correlation time')
    dvl_sigma: float = param(0.005, 'm/s', 1e-6, 1.0, 'White noise per ping and axis')
    depth_rate_hz: float = param(10.0, 'Hz', 0.0, 100.0, 'Depth samples per second; 0: none')
    depth_sigma: float = param(0.05, 'm', 1e-6, 100.0, 'White noise per sample')
    noisy: bool = flag(True, 'False: sensors and fixes without white and Markov noise')
    initial_errors: str = choice(
        'prior', ('prior', 'none'), 'Start drawn from the sigmas below, or at the truth'
    )
    initial_sigma_position: float = param(5.0, 'm', 1e-3, 1e6, 'Per horizontal axis')
    initial_sigma_height: float = param(5.0, 'm', 1e-3, 1e6, 'Along up')
    initial_sigma_velocity: float = param(0.01, 'm/s', 1e-6, 100.0, 'Per axis')
    initial_sigma_tilt_deg: float = param(0.5 / 60, 'deg', 1e-7, 90.0, 'Per axis')
    initial_sigma_heading_deg: float = param(5.0 / 60, 'deg', 1e-7, 180.0, 'Of heading')

    def plan(self) -> Mission:
        """Mission whose truth is simulated.

        Raises
        ------
        ConfigError
            If the mission does not exist or cannot be simulated.
        """
        numbers = {'duration_s': self.duration_s, 'imu_rate_hz': self.imu_rate_hz}
        if self.mission:
            return load_mission(self.mission).with_overrides(numbers)
        document: dict[str, Any] = {
            **numbers,
            'path': {
                'kind': 'straight',
                'latitude_deg': self.latitude_deg,
                'longitude_deg': self.longitude_deg,
                'course_deg': self.course_deg,
                'course_north': self.course_north,
                'speed_mps': self.speed_mps,
            },
            'vehicles': {'leader': {'role': 'leader'}, VEHICLE: {'depth_m': self.depth_m}},
        }
        if not self.oscillating:
            document['oscillation'] = {
                axis: {'amplitude_deg': 0.0} for axis in ('pitch', 'roll', 'yaw')
            }
        return mission_from(document, Path('experiment'))

    def imu_errors(self) -> ImuErrors:
        """Error model of the IMU without its constants, which :class:`Constants` holds."""
        if self.imu not in IMU or not self.noisy:
            return ImuErrors(
                gyro_bias_dph=(0.0,) * 3,
                accel_bias_ug=(0.0,) * 3,
                gyro_noise_density=(0.0,) * 3,
                accel_noise_density=(0.0,) * 3,
            )
        zero = (0.0, 0.0, 0.0)
        errors = IMU[self.imu].errors
        if not self.imu_vices:
            errors = ImuErrors(
                gyro_noise_density=errors.gyro_noise_density,
                gyro_range=errors.gyro_range,
                accel_noise_density=errors.accel_noise_density,
                accel_range=errors.accel_range,
            )
        if self.imu_rested:
            errors = replace(errors, gyro_turn_on_sigma_dph=0.0, gyro_g_sigma_dph=0.0)
        return replace(errors, gyro_bias_dph=zero, accel_bias_ug=zero)
